"""Pairwise coupling and Platt sigmoids against scikit-learn, SciPy and brute force."""

from __future__ import annotations

import itertools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import expit
from sklearn.model_selection import GroupKFold, KFold, ShuffleSplit
from sklearn.svm import SVC

from rcbht_jax.errors import InputError
from rcbht_jax.learning import probability
from rcbht_jax.learning.svm import KERNELS, SvmSpec, fit, pairs

KINDS = st.sampled_from(KERNELS)


def blobs(classes: int, items: int, seed: int = 0, spread: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    y = np.arange(items) % classes
    return rng.normal(size=(classes, 5))[y] * spread + rng.normal(size=(items, 5)), y


def scikit(x: np.ndarray, y: np.ndarray, kernel: str, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scikit-learn's sigmoids and its probabilities of ``other``, which it has declared deprecated."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        machine = SVC(kernel=kernel, gamma=1 / x.shape[1], probability=True, random_state=0).fit(x, y)
        return np.stack([machine.probA_, machine.probB_], 1), machine.predict_proba(other)


def coupled_step_by_step(pair: np.ndarray, classes: int, stop: float) -> np.ndarray:
    """Algorithm 2 of Wu, Lin and Weng (2004), as libsvm has it, until the residual is below ``stop`` / classes."""
    first, second = pairs(classes)
    r = np.zeros((classes, classes))
    r[first, second], r[second, first] = pair, 1 - pair
    q, p = np.diag((r * r).sum(0)) - r * r.T, np.full(classes, 1 / classes)
    for _ in range(100):
        if np.abs(q @ p - p @ q @ p).max() < stop / classes:
            break
        for t in range(classes):
            p[t] += (p @ q @ p - q[t] @ p) / q[t, t]
            p /= p.sum()
    return p


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("classes", [2, 3, 4, 7])
def test_equals_scikit_learn_given_the_same_sigmoids(kernel, classes):
    x, y = blobs(classes, 40 * classes)
    other = np.random.default_rng(9).normal(size=(200, 5)) * 3
    sigmoid, theirs = scikit(x, y, kernel, other)
    ours = fit(x, y, [str(c) for c in range(classes)], SvmSpec(kernel))
    pair = probability.pair_probability(ours.decision(other), sigmoid)
    np.testing.assert_allclose([coupled_step_by_step(r, classes, 0.005) for r in pair], theirs, atol=1e-6)
    np.testing.assert_allclose(probability.couple(pair, classes), theirs, atol=0.01)  # theirs stops early


def objective(p: np.ndarray, pair: np.ndarray, classes: int) -> float:
    first, second = pairs(classes)
    return float(np.sum(((1 - pair) * p[first] - pair * p[second]) ** 2))


@given(st.integers(2, 13), st.integers(0, 2**32 - 1), st.floats(0.1, 15))
def test_coupling_is_the_minimum(classes, seed, spread):
    rng = np.random.default_rng(seed)
    size = classes * (classes - 1) // 2
    pair = np.clip(expit(rng.normal(size=(1, size)) * spread), probability.CERTAIN, 1 - probability.CERTAIN)
    p = probability.couple(pair, classes)[0]
    assert abs(p.sum() - 1) < 1e-12
    assert p.min() >= 0
    best = objective(p, pair[0], classes)
    for scale in (1e-1, 1e-3, 1e-5):
        near = np.abs(p + rng.normal(size=(100, classes)) * scale)
        near /= near.sum(1, keepdims=True)
        assert min(objective(q, pair[0], classes) for q in near) >= best - 1e-12


@given(st.integers(2, 13), st.integers(0, 2**32 - 1))
def test_early_stop_converges_to_the_minimum(classes, seed):
    pair = np.random.default_rng(seed).uniform(0.1, 0.9, size=(3, classes * (classes - 1) // 2))
    early = [coupled_step_by_step(r, classes, 1e-9) for r in pair]
    np.testing.assert_allclose(early, probability.couple(pair, classes), atol=1e-4)


def test_consistent_pairs_give_back_their_probabilities():
    p = np.array([0.5, 0.3, 0.15, 0.05])
    first, second = pairs(4)
    pair = (p[first] / (p[first] + p[second]))[None]
    np.testing.assert_allclose(probability.couple(pair, 4)[0], p, atol=1e-12)
    np.testing.assert_allclose(probability.couple_jax(jnp.asarray(pair[0], jnp.float32), 4), p, atol=1e-6)


couple_many = jax.jit(jax.vmap(probability.couple_jax, in_axes=(0, None)), static_argnums=1)


@given(st.sampled_from([2, 3, 4, 13]), st.integers(0, 2**32 - 1), st.floats(0.1, 15))
def test_jax_coupling_equals_numpy(classes, seed, spread):
    rng = np.random.default_rng(seed)
    pair = expit(rng.normal(size=(20, classes * (classes - 1) // 2)) * spread).astype(np.float32)
    pair = np.clip(pair, np.float32(probability.CERTAIN), np.float32(1 - probability.CERTAIN))
    ours = couple_many(pair, classes)
    np.testing.assert_allclose(ours, probability.couple(pair.astype(np.float64), classes), atol=2e-4)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("scaling", "ranks"), [(False, False), (True, False), (True, True)])
def test_jax_probabilities_equal_numpy(kernel, scaling, ranks):
    x, y = blobs(4, 200)
    spec = SvmSpec(kernel, 1.0, scaling, ranks=ranks)
    model = probability.fit_probabilistic(x, y, np.arange(200) // 4, list("abcd"), spec)
    other = np.random.default_rng(1).normal(size=(100, 5)) * 2
    arrays = probability.to_arrays(model)
    said = jax.jit(jax.vmap(lambda row: probability.probability_jax(arrays, kernel, model.svm.gamma, 4, row)))(
        other.astype(np.float32)
    )
    np.testing.assert_allclose(said, model.probability(other), atol=1e-4)
    assert said.dtype == jnp.float32


@pytest.mark.parametrize("kernel", KERNELS)
def test_repeated_items_steps_and_weights(kernel):
    """Items that count several times are one support vector; knots that are one make a step, with its middle on it."""
    x, y = blobs(3, 60)
    x[:, 0] = np.round(x[:, 0])  # most quantiles are the same few numbers
    rows, weight = np.repeat(np.arange(60), 1 + np.arange(60) % 3), np.array([3.0, 1, 0.2, 1, 1])
    spec = SvmSpec(kernel, 1.0, True, ranks=True)
    model = probability.fit_probabilistic(x[rows], y[rows], rows // 2, list("abc"), spec, weight=weight)
    arrays = probability.to_arrays(model)
    assert len(arrays.support) < len(model.svm.support)
    other = x[:30].copy()
    other[::2, 0] += 0.3
    said = [probability.probability_jax(arrays, kernel, model.svm.gamma, 3, row) for row in other.astype(np.float32)]
    np.testing.assert_allclose(said, model.probability(other.astype(np.float32)), atol=1e-4)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 5), st.integers(5, 60), st.integers(5, 60))
def test_sigmoid_is_the_maximum_likelihood_fit(seed, gap, ups, downs):
    rng = np.random.default_rng(seed)
    positive = np.arange(ups + downs) < ups
    f = rng.normal(size=ups + downs) + np.where(positive, gap, -gap)
    target = np.where(positive, (ups + 1) / (ups + 2), 1 / (downs + 2))

    def loss(point):
        z = point[0] * f + point[1]
        return np.sum(np.logaddexp(0, z) - (1 - target) * z)

    found = probability.fit_sigmoid(f, positive)
    best = minimize(loss, np.zeros(2), method="BFGS")
    assert loss(found) <= best.fun + 1e-6


@pytest.mark.parametrize("seed", [84, 106, 159, 216, 287])
def test_the_fit_does_not_stop_where_a_whole_step_of_newton_overshoots(seed):
    """Decision values with outliers, for which steps have to be halved."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 20))
    positive = np.arange(count) < max(1, int(count * rng.uniform(0.05, 0.6)))
    f = rng.standard_cauchy(count) * rng.choice([1, 10, 100]) + np.where(positive, 1, -1)
    ups, downs = positive.sum(), (~positive).sum()
    target = np.where(positive, (ups + 1) / (ups + 2), 1 / (downs + 2))
    a, b = probability.fit_sigmoid(f, positive)
    rest = expit(-(a * f + b)) - target  # the gradient of the likelihood is zero at its maximum, which is unique
    assert abs(rest.sum()) < 1e-4
    assert abs((rest * f).sum()) < 1e-4 * np.abs(f).max()


def test_sigmoid_of_separable_and_of_useless_values():
    positive = np.arange(20) < 10
    a, b = probability.fit_sigmoid(np.where(positive, 1e6, -1e6), positive)
    assert np.isfinite([a, b]).all()
    p = expit(-(a * 1e6 + b))
    assert p == pytest.approx(11 / 12, abs=1e-3)
    a, b = probability.fit_sigmoid(np.zeros(20), np.arange(20) < 5)
    assert expit(-b) == pytest.approx((5 * 6 / 7 + 15 / 17) / 20, abs=1e-6)
    with pytest.raises(InputError, match="both classes"):
        probability.fit_sigmoid(np.zeros(3), np.zeros(3, bool))


def test_held_out_decisions_never_saw_their_trial():
    x, y = blobs(2, 40, spread=0.0)
    trial = np.arange(40) // 2
    x = np.concatenate([x, np.eye(20)[trial] * 50], axis=1)  # each trial can be learnt by heart
    y = np.repeat(np.random.default_rng(0).integers(0, 2, 20), 2)
    spec = SvmSpec("linear", 1.0)
    seen = fit(x, y, ["a", "b"], spec).decision(x)[:, 0]
    unseen = probability.held_out_decisions(x, y, trial, ["a", "b"], spec, 0)[:, 0]
    assert ((seen > 0) == (y == 0)).all()
    assert ((unseen > 0) == (y == 0)).mean() < 0.8


@pytest.mark.parametrize("cv", [5, GroupKFold(5)])
def test_sigmoids_are_fitted_on_held_out_trials(cv):
    """Classes are almost random but can be memorised: sigmoids of the training items would be certain of them."""
    rng, trial = np.random.default_rng(0), np.arange(80) // 2
    y = np.repeat(rng.permutation(np.arange(40) % 2), 2)
    x = rng.normal(size=(80, 100)) + np.eye(100)[0] * y[:, None] / 2
    model = probability.fit_probabilistic(x, y, trial, ["a", "b"], SvmSpec("linear"), folds=cv)
    assert (model.svm.predict_index(x) == y).all()
    assert model.probability(x).max(1).mean() < 0.7


@pytest.mark.filterwarnings("ignore:The groups parameter is ignored")
def test_splitters_that_divide_trials_or_skip_items_are_refused():
    x, y = blobs(2, 40)
    with pytest.raises(InputError, match="both sides"):
        probability.held_out_decisions(x, y, np.arange(40) // 2, ["a", "b"], SvmSpec(), 0, KFold(5, shuffle=True))
    with pytest.raises(InputError, match="exactly once"):
        probability.held_out_decisions(x, y, np.arange(40), ["a", "b"], SvmSpec(), 0, ShuffleSplit(5))


def test_probabilities_are_calibrated_on_new_items():
    x, y = blobs(3, 6000, spread=1.0)
    model = probability.fit_probabilistic(x[:1500], y[:1500], np.arange(1500), list("abc"), SvmSpec("rbf"))
    p = model.probability(x[1500:])
    confidence, right = p.max(1), p.argmax(1) == y[1500:]
    edges = np.quantile(confidence, np.linspace(0, 1, 6))
    for low, high in itertools.pairwise(edges):
        inside = (confidence >= low) & (confidence <= high)
        assert abs(confidence[inside].mean() - right[inside].mean()) < 0.06
