"""SVMs without scikit-learn against scikit-learn; selection that cannot see the test side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.model_selection import PredefinedSplit
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from rcbht_jax.errors import InputError
from rcbht_jax.learning import svm
from rcbht_jax.learning.class_groups import some_items
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.learning.svm import COSTS, KERNELS, Grid, SvmSpec, fit, gram, grouped_folds, predictions, select, vote
from rcbht_jax.learning.validation import cross_validate, forest, holdout_score, majority, nested_svm, repeated_folds

NAMES = ("a", "b", "c", "d", "e")


def blobs(seed: int, classes: int, items: int = 60, features: int = 7, spread: float = 1.5):
    rng = np.random.default_rng(seed)
    y = np.arange(items) % classes
    x = rng.normal(size=(classes, features))[y] + rng.normal(size=(items, features)) * spread
    return x * 3 + 1, y


@settings(max_examples=30)
@given(
    st.integers(0, 1000),
    st.integers(2, 5),
    st.sampled_from(KERNELS),
    st.sampled_from((0.01, 1.0, 100.0)),
    st.booleans(),
    st.sampled_from(("auto", "scale")),
    st.booleans(),
)
def test_decision_and_prediction_equal_scikit_learn(seed, classes, kernel, cost, scaling, gamma, balanced):
    x, y = blobs(seed, classes)
    new = blobs(seed + 1, classes)[0]
    model = fit(x, y, NAMES[:classes], SvmSpec(kernel, cost, scaling, gamma, balanced))
    scaler = StandardScaler().fit(x)
    a, b = (scaler.transform(x), scaler.transform(new)) if scaling else (x, new)
    weight = "balanced" if balanced else None
    oracle = SVC(C=cost, kernel=kernel, gamma=gamma, class_weight=weight, decision_function_shape="ovo").fit(a, y)
    expected = oracle.decision_function(b)
    if classes == 2:  # scikit-learn turns the sign of two-class machines around
        expected = -expected[:, None]
    # Values of a cubic kernel reach 1e5; the error is relative to them.
    np.testing.assert_allclose(model.decision(new), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(model.predict_index(new), oracle.predict(b))
    np.testing.assert_array_equal(model.predict(new), np.array(NAMES)[oracle.predict(b)])


@pytest.mark.parametrize("kernel", ["poly", "rbf"])
def test_decisions_of_many_items_need_no_kernel_of_them_all(kernel, monkeypatch):
    x, y = blobs(0, 3)
    model, asked = fit(x, y, NAMES[:3], SvmSpec(kernel)), []
    whole = model.decision(x)
    monkeypatch.setattr(svm, "_VALUES", 7 * len(model.support))
    monkeypatch.setattr(svm, "gram", lambda a, *rest: asked.append(len(a)) or gram(a, *rest))
    np.testing.assert_allclose(model.decision(x), whole, rtol=1e-12)
    assert asked == [8] * 7 + [4]
    assert model.decision(x[:0]).shape == (0, 3)


def test_gamma_auto_is_one_over_the_number_of_features():
    x, y = blobs(0, 3)
    assert fit(x, y, NAMES[:3], SvmSpec(gamma="auto")).gamma == 1 / 7
    assert fit(x, y, NAMES[:3], SvmSpec(gamma="scale")).gamma == pytest.approx(1 / (7 * x.var()))


def test_a_tie_of_votes_goes_to_the_earlier_class():
    # Pairs (0,1), (0,2), (1,2): 0 beats 1, 2 beats 0, 1 beats 2: one vote each.
    assert vote(np.array([[1.0, -1.0, 1.0]]), 3).tolist() == [0]
    # A decision of exactly zero is a vote for the second class, as in libsvm.
    assert vote(np.array([[0.0]]), 2).tolist() == [1]


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernels_by_plain_sums(kernel):
    a, b = np.random.default_rng(0).normal(size=(2, 4, 3))
    for i in range(4):
        for j in range(4):
            dot = float(sum(a[i] * b[j]))
            far = float(sum((a[i] - b[j]) ** 2))
            expected = {"linear": dot, "poly": (0.5 * dot) ** 3, "rbf": np.exp(-0.5 * far)}[kernel]
            assert gram(a, b, kernel, 0.5)[i, j] == pytest.approx(expected)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("balanced", [False, True])
def test_the_cost_path_that_ends_early_equals_separate_fits(kernel, balanced):
    for spread in (0.3, 2.0):  # separable: the path ends; overlapping: it does not (except for rbf)
        x, y = blobs(4, 3, spread=spread)
        y = np.where(np.arange(len(y)) < 12, 0, y)  # uneven classes
        train, test = np.arange(40), np.arange(40, 60)
        costs = COSTS[2:6]
        path = predictions(x, y, train, test, SvmSpec(kernel, balanced=balanced), costs)
        assert len(path) == len(costs)
        for cost, said in zip(costs, path, strict=True):
            weight = "balanced" if balanced else None
            alone = SVC(C=cost, kernel=kernel, gamma="auto", class_weight=weight).fit(x[train], y[train])
            np.testing.assert_array_equal(said, alone.predict(x[test]))


def test_costs_that_cannot_be_solved_repeat_the_last_answer():
    x, y = blobs(0, 2, items=80, spread=5)
    train, test = np.arange(60), np.arange(60, 80)
    path = predictions(x, y, train, test, SvmSpec("linear"), (1e-3, 1e4, 1e5))
    np.testing.assert_array_equal(path[0], SVC(C=1e-3, kernel="linear").fit(x[train], y[train]).predict(x[test]))
    np.testing.assert_array_equal(path[1], path[0])
    np.testing.assert_array_equal(path[2], path[0])


@settings(max_examples=25)
@given(st.integers(0, 500), st.integers(5, 20), st.integers(2, 5))
def test_folds_keep_trials_together_and_cover_everything_once(seed, trials, folds):
    y = np.tile(np.arange(4), trials)
    groups = np.repeat(np.arange(trials), 4)
    splits = grouped_folds(y, groups, folds, seed)
    for train, test in splits:
        assert not set(groups[train]) & set(groups[test])
        np.testing.assert_array_equal(np.sort(np.concatenate([train, test])), np.arange(len(y)))
    np.testing.assert_array_equal(np.sort(np.concatenate([t for _, t in splits])), np.arange(len(y)))
    again = grouped_folds(y, groups, folds, seed)
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(splits, again, strict=True))


def test_folds_are_stratified_and_depend_on_the_seed():
    y = np.repeat([0, 1, 2], [50, 20, 10])
    splits = [grouped_folds(y, np.arange(80), 5, seed) for seed in (0, 1)]
    for _, test in splits[0] + splits[1]:
        assert np.bincount(y[test]).tolist() == [10, 4, 2]
    assert any(not np.array_equal(a[1], b[1]) for a, b in zip(*splits, strict=True))


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_that_scikit_learn_does_not_take_is_refused(seed: int):
    y, groups = np.arange(8) % 2, np.arange(8)
    for made in (lambda: grouped_folds(y, groups, 2, seed), lambda: some_items(y, groups, groups, seed, most=4)):
        with pytest.raises(InputError, match=f"The seed is {seed}; expected 0 to 4294967295."):
            made()


def test_a_class_with_fewer_trials_than_folds_is_refused():
    y, groups = np.array([0, 0, 0, 0, 1, 1, 1, 1]), np.array([0, 1, 2, 3, 4, 4, 5, 5])
    with pytest.raises(InputError, match="the rarest class has 2 trials, so choose 2 folds"):
        grouped_folds(y, groups, 3, 0)


@pytest.mark.filterwarnings("ignore:The groups parameter is ignored")
@pytest.mark.parametrize("missing", [np.nan, 5.0])
def test_a_splitter_that_divides_a_group_is_refused(missing: float):
    groups = np.array([1, 2, 3, 4, *[missing] * 4])
    assert len(grouped_folds(np.arange(8) % 2, groups, PredefinedSplit([0, 1, 0, 1, 1, 1, 1, 1]), 0)) == 2
    with pytest.raises(InputError, match="puts items of one trial on both sides"):
        grouped_folds(np.arange(8) % 2, groups, PredefinedSplit([0, 1, 0, 1, 0, 0, 1, 1]), 0)


@pytest.mark.filterwarnings("ignore:The groups parameter is ignored")
@pytest.mark.parametrize("fold", [0, -1])
def test_a_splitter_that_leaves_a_side_empty_is_refused(fold: int):
    """The error was about the choice of kernel and cost, even where there was nothing to choose."""
    with pytest.raises(InputError, match="gives no split, or one with nothing to train on or to test"):
        grouped_folds(np.arange(8) % 2, np.arange(8), PredefinedSplit([fold] * 8), 0)


def test_kernels_of_one_scaling_share_its_products(monkeypatch):
    """They are most of the work where items are many; each choice is what it is with products of its own."""
    x, y = blobs(0, 3)
    grid, shared = Grid(costs=(0.1, 1.0), inner=3), []
    chosen = select({"": x}, y, np.arange(len(y)), grid, seed=0)

    def own(a, b, kernel, gamma, dot):
        shared.append(dot)
        np.testing.assert_array_equal(dot, a @ b.T)
        return gram(a, b, kernel, gamma)

    monkeypatch.setattr("rcbht_jax.learning.svm.gram", own)
    assert select({"": x}, y, np.arange(len(y)), grid, seed=0) == chosen
    assert (len(shared), len({id(dot) for dot in shared})) == (3 * 2 * len(KERNELS), 3 * 2)  # folds, scalings


def test_selection_finds_the_matrix_that_knows_the_class():
    x, y = blobs(1, 3, spread=0.5)
    noise = np.random.default_rng(2).normal(size=x.shape)
    chosen = select({"noise": noise, "signal": x}, y, np.arange(len(y)), Grid(), 0)
    assert chosen.features == "signal"
    assert select({"": x}, y, np.arange(len(y)), Grid(("poly",), (1.0,), (False,)), 0) == SvmSpec()


def test_scaling_is_chosen_when_one_feature_drowns_the_others():
    x, y = blobs(1, 2, spread=0.7)
    x = np.concatenate([x, np.random.default_rng(0).normal(size=(len(x), 1)) * 1e4], 1)
    assert select({"": x}, y, np.arange(len(y)), Grid(kernels=("rbf",)), 0).scaling


def test_ties_go_to_the_simplest_choice():
    x = np.repeat([[0.0], [10.0]], 20, 0)
    y = np.repeat([0, 1], 20)
    chosen = select({"": x}, y, np.arange(40), Grid(costs=(1.0, 10.0)), 0)
    assert (chosen.kernel, chosen.cost, chosen.scaling) == ("linear", 1.0, False)


@pytest.mark.parametrize("grid", [Grid(), Grid(kernels=("rbf",), gamma="scale")], ids=["auto", "scale"])
def test_the_learner_never_looks_at_the_test_side(grid):
    x, y = blobs(3, 3, spread=2.5)
    groups = np.arange(len(y)) // 3
    train, test = np.arange(45), np.arange(45, 60)
    said, chosen = nested_svm({"": x}, y, groups, grid)(train, test, 5)
    x2, y2 = x.copy(), y.copy()
    y2[test] = (y[test] + 1) % 3
    other, same = nested_svm({"": x2}, y2, groups, grid)(train, test, 5)
    np.testing.assert_array_equal(said, other)
    assert chosen == same
    x2[test[-1]] += 1e6  # one test item moves neither the scaling of the others nor the width of the kernel
    moved, same = nested_svm({"": x2}, y, groups, grid)(train, test, 5)
    np.testing.assert_array_equal(moved[:-1], said[:-1])
    assert chosen == same


def test_the_baselines_never_look_at_the_test_side():
    rng = np.random.default_rng(0)
    x, y, train, test = rng.normal(size=(60, 1)), rng.integers(0, 2, 60), np.arange(40), np.arange(40, 60)
    other = np.where(np.arange(60) < 40, y, 1 - y)
    for make in (lambda y: forest(x, y), majority):
        np.testing.assert_array_equal(make(y)(train, test, 0)[0], make(other)(train, test, 0)[0])


def test_shuffled_classes_score_at_chance():
    x, y = blobs(3, 2, items=80, spread=0.5)
    y = np.random.default_rng(1).permutation(y)
    splits = repeated_folds(y, np.arange(80), 5, 2, 0)
    score = cross_validate(nested_svm({"": x}, y, np.arange(80), Grid()), y, splits).accuracy.mean()
    assert abs(score - 0.5) < 0.15


def test_cross_validation_counts_by_hand():
    y = np.array([0] * 6 + [1] * 4)
    splits = [[(np.arange(0, 10, 2), np.arange(1, 10, 2)), (np.arange(1, 10, 2), np.arange(0, 10, 2))]]
    made = cross_validate(majority(y), y, splits)
    assert made.accuracy.tolist() == [[0.6, 0.6]]
    assert made.balanced_accuracy.tolist() == [[0.5, 0.5]]
    assert made.confusion.tolist() == [[6, 0], [4, 0]]
    summary = made.summary()
    assert summary["fold_min_mean_max"] == pytest.approx([0.6, 0.6, 0.6])
    assert summary["accuracy"] == pytest.approx({"mean": 0.6, "low": 0.6, "high": 0.6})
    low, high = wilson(6, 10)
    assert made.summary(trials=10)["accuracy"] == pytest.approx({"mean": 0.6, "low": low, "high": high})
    assert made.summary(trials=10)["balanced_accuracy"]["low"] < 0.3


def test_fold_extremes_are_those_of_one_run():
    y = np.array([0, 0, 1, 1])
    right = [(np.array([0, 2, 3]), np.array([0, 1])), (np.array([0, 1, 2]), np.array([0, 1]))]
    wrong = [(np.array([0, 2, 3]), np.array([0, 1])), (np.array([0, 1, 2]), np.array([2, 3]))]
    summary = cross_validate(majority(y), y, [right, wrong]).summary()
    # Runs: (0, 1) and (0, 0).
    assert summary["fold_min_mean_max"] == [0.0, 0.25, 0.5]


def test_the_interval_of_a_transfer_counts_trials_not_items():
    y = np.array([0, 1] + [0, 1] * 20)
    groups = np.array([0, 0] + [1] * 20 + [2] * 20)
    made = holdout_score(majority(y), y, groups, (np.array([0, 1]), np.arange(2, 42)))
    assert made.accuracy == 0.5
    assert (made.low, made.high) == wilson(1, 2)


@pytest.mark.parametrize("alike", [0.3, 0.98], ids=["states of a trial", "trials right or wrong as a whole"])
@pytest.mark.parametrize(("trials", "right"), [(8, 0.8), (16, 0.9), (19, 0.95), (35, 0.95)])
def test_the_interval_of_a_transfer_holds_the_truth_as_often_as_it_says(trials, right, alike):
    rng, groups = np.random.default_rng(0), np.repeat(np.arange(trials), 4)
    split, held = (np.arange(len(groups)), np.arange(len(groups))), []
    for _ in range(400):
        share = rng.beta(right * (1 / alike - 1), (1 - right) * (1 / alike - 1), trials)
        wrong = (rng.random(len(groups)) > share[groups]).astype(np.int64)
        made = holdout_score(lambda train, test, seed: (np.zeros(len(test), np.int64), {}), wrong, groups, split)
        held.append(made.low <= right <= made.high)
    assert np.mean(held) > 0.91  # of percentiles of resampled trials as few as 0.84


def test_the_forest_learns_a_threshold():
    seconds = np.concatenate([np.full(20, 3.0), np.full(20, 9.0)])[:, None]
    y = np.repeat([0, 1], 20)
    splits = repeated_folds(y, np.arange(40), 4, 1, 0)
    assert cross_validate(forest(seconds, y), y, splits).accuracy.min() == 1


def test_bad_input_is_refused():
    x, y = blobs(0, 2)
    with pytest.raises(InputError, match="kernel"):
        SvmSpec("sigmoid")
    with pytest.raises(InputError, match="cost"):
        SvmSpec(cost=0.0)
    with pytest.raises(InputError, match="two classes"):
        fit(x, np.zeros(len(x), int), NAMES[:1], SvmSpec())
    broken = x.copy()
    broken[3, 2] = np.nan
    with pytest.raises(InputError, match="feature 2"):
        fit(broken, y, NAMES[:2], SvmSpec())
    with pytest.raises(InputError, match="finite"):
        nested_svm({"": broken}, y, y, Grid())
    model = fit(x, y, NAMES[:2], replace(SvmSpec(), kernel="linear"))
    with pytest.raises(InputError, match="7 features"):
        model.decision(x[:, :5])


@pytest.mark.parametrize("empty", ["kernels", "costs", "scalings"])
def test_a_grid_without_a_choice_is_refused(empty):
    with pytest.raises(InputError, match=f"no {empty} to choose from"):
        Grid(**{empty: ()})


def test_costs_that_do_not_increase_are_refused() -> None:
    """A path of costs stops at the first that is too hard; smaller ones behind it would get its answers."""
    with pytest.raises(InputError, match="expected increasing ones"):
        Grid(costs=(1e4, 1.0, 1e-5))
