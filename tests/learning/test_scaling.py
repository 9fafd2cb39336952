"""Features on a common scale, by deviation and by ranks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning import model_io
from rcbht_jax.learning.model_io import TrainedModel
from rcbht_jax.learning.scaling import KNOTS, SPREAD, fit_scale
from rcbht_jax.learning.svm import Grid, SvmSpec, fit, predictions, select
from rcbht_jax.learning.validation import nested_svm


def test_by_deviation_and_not_at_all():
    x = np.array([[0.0, 5, 1], [2, 5, 1.1]])
    np.testing.assert_allclose(fit_scale(x, True)(x), [[-1, 0, -1], [1, 0, 1]])
    np.testing.assert_allclose(fit_scale(x, True, floor=0.5)(x), [[-1, 0, -0.1], [1, 0, 0.1]])
    np.testing.assert_array_equal(fit_scale(x, False)(x), x)


def test_an_item_of_weight_two_counts_twice() -> None:
    rng = np.random.default_rng(0)
    x, count = rng.normal(size=(9, 3)), np.array([2, 1, 3, 0, 1, 1, 4, 1, 2])
    weighted = fit_scale(x, True, sample_weight=count.astype(float))
    repeated = fit_scale(np.repeat(x, count, axis=0), True)
    np.testing.assert_allclose(weighted(x), repeated(x))


def test_a_feature_that_does_not_vary_is_not_blown_up() -> None:
    rounded = np.full((30, 1), 0.1)
    assert rounded.std(0)[0] > 0  # by rounding, else the case shows nothing
    np.testing.assert_allclose(fit_scale(rounded, True)(rounded + 1), 1)
    one = fit_scale(np.array([[0.0], [5.0]]), True, sample_weight=np.array([1.0, 0.0]))
    np.testing.assert_array_equal(one(np.array([[0.0], [5.0]])), [[0], [5]])


@given(st.integers(0, 2**32 - 1), st.integers(KNOTS, 60))
def test_ranks_follow_the_empirical_distribution(seed, items):
    rng = np.random.default_rng(seed)
    x = np.stack([rng.normal(size=items), rng.standard_cauchy(items), rng.integers(0, 3, items).astype(float)], 1)
    made = fit_scale(x, True, ranked=True)(x) / SPREAD + 0.5
    assert made.min() >= 0
    assert made.max() <= 1
    share = np.stack(
        [((column < column[:, None]).mean(1) + (column <= column[:, None]).mean(1)) / 2 for column in x.T], 1
    )
    np.testing.assert_allclose(made, share, atol=1.5 / (KNOTS - 1))
    for a, b in zip(x.T, made.T, strict=True):
        assert (np.diff(b[np.argsort(a, kind="stable")]) >= -1e-12).all()


def test_ranks_do_not_follow_an_outlier_and_stay_in_range():
    x = np.arange(100.0)[:, None]
    wild = np.where(x == 99, 1e9, x)
    a, b = (fit_scale(part, True, ranked=True) for part in (x, wild))
    np.testing.assert_allclose(a(x[:90]), b(x[:90]), atol=1e-9)
    np.testing.assert_allclose(a(np.array([[-1e9], [1e9]])), [[-SPREAD / 2], [SPREAD / 2]])
    assert a(x).std() == pytest.approx(1, abs=0.05)


def test_a_constant_feature_stands_in_the_middle():
    scale = fit_scale(np.full((30, 1), 3.0), True, ranked=True)
    np.testing.assert_allclose(scale(np.array([[2.0], [3.0], [4.0]])), [[-SPREAD / 2], [0], [SPREAD / 2]])


def tailed(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three classes on one logarithmic feature among long-tailed noise."""
    rng, items = np.random.default_rng(seed), 90
    y = np.arange(items) % 3
    signal = 10.0 ** (2 * y + rng.normal(size=items) * 0.3)
    return np.column_stack([signal, rng.standard_cauchy((items, 4))]), y


def test_ranks_tell_what_deviations_do_not():
    x, y = tailed(0)
    train, test = np.arange(60), np.arange(60, 90)
    said = [predictions(x, y, train, test, SvmSpec("linear", 1.0, True, ranks=r), [1.0])[0] for r in (False, True)]
    plain, ranked = ((part == y[test]).mean() for part in said)
    assert ranked > 0.9 > plain


def test_the_grid_hands_ranks_on_and_test_items_move_nothing():
    x, y = tailed(1)
    chosen = select({"": x}, y, np.arange(len(y)), Grid(kernels=("linear",), scalings=(True,), ranks=True), 0)
    assert chosen.ranks
    train, test = np.arange(60), np.arange(60, 90)
    moved = x.copy()
    moved[test[1:]] *= 1e6
    first = [predictions(part, y, train, test, chosen, [1.0])[0][0] for part in (x, moved)]
    assert first[0] == first[1]
    unscaled = Grid(kernels=("linear",), costs=(1.0,), scalings=(False, True), ranks=True).paths([""])
    assert [(path.scaling, path.ranks) for path in unscaled] == [(False, False), (True, True)]


def test_a_model_with_ranks_survives_its_file(tmp_path):
    x, y = tailed(2)
    svm = fit(x, y, "abc", SvmSpec("rbf", 1.0, True, ranks=True))
    names = tuple("vwxyz")
    model_io.save(tmp_path / "m", TrainedModel(svm, FeatureSpec(), names, {}, {}, "", axes=("Fz",), units=("N",)))
    back = model_io.load(tmp_path / "m").svm
    assert back.knots.shape == (KNOTS, 5)
    np.testing.assert_array_equal(back.decision(x), svm.decision(x))
    train = np.arange(len(y))
    said = predictions(x, y, train, train, svm.spec, [1.0])[0]
    np.testing.assert_array_equal(back.predict_index(x), said)


def test_a_file_from_before_there_were_ranks_is_read():
    x, y = tailed(3)
    svm = fit(x, y, "abc", SvmSpec("linear", 1.0, True))
    arrays, described = model_io.svm_members(svm)
    arrays.pop("knots")
    described["spec"].pop("ranks")
    back = model_io.read_svm(described, arrays, 5)
    np.testing.assert_array_equal(back.decision(x), svm.decision(x))
    with pytest.raises(InputError, match="knots"):
        model_io.read_svm(described | {"spec": described["spec"] | {"ranks": True}}, arrays, 5)


@pytest.mark.parametrize(
    "spec", [SvmSpec("rbf", 1.0), SvmSpec("rbf", 1.0, True), SvmSpec("rbf", 1.0, True, ranks=True)]
)
def test_weights_are_those_of_scaled_features(spec, tmp_path):
    x, y = tailed(4)
    weight = np.array([2.0, 0.5, 0.01, 1, 0.1])
    train, test = np.arange(60), np.arange(60, 90)
    said = predictions(x, y, train, test, spec, [1.0], weight)[0]
    scaled = fit_scale(x[train], spec.scaling, 0.0, spec.ranks)(x) * weight
    np.testing.assert_array_equal(said, predictions(scaled, y, train, test, SvmSpec("rbf", 1.0), [1.0])[0])
    model = fit(x[train], y[train], "abc", spec, weight)
    np.testing.assert_array_equal(model.predict_index(x[test]), said)


def test_selection_and_nested_learning_use_the_weights_of_the_chosen_matrix():
    x, y = tailed(5)
    noise = np.random.default_rng(0).normal(size=(90, 200))
    both = np.column_stack([np.log(x[:, :1]), noise])
    heavy = np.r_[10.0, np.full(200, 0.1)]
    grid = Grid(kernels=("rbf",), costs=(1.0,), scalings=(True,))
    chosen = select({"even": both, "heavy": both}, y, np.arange(90), grid, 0, {"heavy": heavy})
    assert chosen.features == "heavy"
    train, test = np.arange(60), np.arange(60, 90)
    known = {"even": both, "heavy": both}
    said, choice = nested_svm(known, y, np.arange(90), grid, {"heavy": heavy})(train, test, 0)
    assert choice["features"] == "heavy"
    np.testing.assert_array_equal(said, predictions(both, y, train, test, chosen, [1.0], heavy)[0])
    assert (said == y[test]).mean() > 0.9


def test_ranks_without_scaling_are_refused():
    with pytest.raises(InputError, match="choose scaling"):
        SvmSpec(ranks=True)
