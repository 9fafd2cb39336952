"""Scores against scikit-learn, hand-counted examples and the properties that define them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn import metrics as sk

from rcbht_jax.errors import InputError
from rcbht_jax.learning import metrics

labels = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=40)


def beliefs(seed: int, steps: int, classes: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).dirichlet(np.ones(classes) * 0.3, steps)


@given(labels)
def test_scores_equal_scikit_learn(pairs):
    truth, said = np.array(pairs).T
    assert metrics.accuracy(truth, said) == pytest.approx(sk.accuracy_score(truth, said))
    present = np.unique(truth)
    expected = np.mean([np.mean(said[truth == c] == c) for c in present])
    assert metrics.balanced_accuracy(truth, said) == pytest.approx(expected)
    table = sk.confusion_matrix(truth, said, labels=range(4))
    np.testing.assert_array_equal(metrics.confusion(truth, said, 4), table)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.uint64])
def test_classes_may_be_of_any_type_of_integer(kind):
    y = np.arange(20, dtype=kind)
    assert metrics.balanced_accuracy(y, y) == 1
    np.testing.assert_array_equal(metrics.confusion(y, y, 20), np.eye(20))


def test_corrected_interval_by_hand():
    # s^2 = 0.02/3, J = 4: error = sqrt((1/4 + 1/4) * s^2), t(3) = 3.18245.
    mean, low, high = metrics.corrected_interval(np.array([0.5, 0.6, 0.6, 0.7]), 0.25)
    assert (mean, low, high) == pytest.approx((0.6, 0.6 - 3.18245 * 0.0577350, 0.6 + 3.18245 * 0.0577350), rel=1e-5)


def test_a_split_that_is_repeated_narrows_no_interval():
    once = metrics.corrected_interval(np.array([0.5, 0.6, 0.6, 0.7]), 0.25)
    scores = np.array([[0.5, 0.6, 0.6, 0.7], [0.6, 0.5, 0.7, 0.6]])
    split = np.array([[0, 1, 2, 3], [1, 0, 3, 2]])
    assert metrics.corrected_interval(scores, 0.25, split=split) == pytest.approx(once)
    assert metrics.corrected_interval(scores, 0.25)[1] > once[1]
    mean, low, high = metrics.corrected_interval(np.array([0.5, 0.6, 0.6, 0.7, 0.7]), 0.25, np.array([0, 1, 2, 3, 3]))
    assert mean == pytest.approx(0.62)
    assert (low, high) == pytest.approx((0.62 - 0.6 + once[1], 0.62 - 0.6 + once[2]))
    with pytest.raises(InputError, match="there are 1"):
        metrics.corrected_interval(scores, 0.25, split=np.zeros_like(split))


@given(st.lists(st.floats(0, 1), min_size=2, max_size=30), st.floats(0.05, 1))
def test_corrected_interval_is_wider_than_the_naive_one_and_inside_the_unit_interval(scores, ratio):
    values = np.array(scores)
    mean, low, high = metrics.corrected_interval(values, ratio)
    _, naive_low, naive_high = metrics.corrected_interval(values, 0.0)
    assert 0 <= low <= naive_low <= mean + 1e-12
    assert mean - 1e-12 <= naive_high <= high <= 1


def test_overall_and_class_probability_by_hand():
    probability = np.array([[0.8, 0.2], [0.4, 0.6], [0.1, 0.9]])
    truth = np.array([0, 0, 1])
    assert metrics.overall_pr(probability, truth) == pytest.approx((0.8 + 0 + 0.9) / 3)
    np.testing.assert_allclose(metrics.class_pr(probability, truth), [0.4, 0.9])
    assert metrics.macro_step_accuracy(probability, truth) == pytest.approx((0.5 + 1) / 2)


@settings(max_examples=50)
@given(st.integers(0, 1000), st.integers(1, 40))
def test_class_probabilities_average_to_the_overall_one(seed, steps):
    probability = beliefs(seed, steps)
    truth = np.random.default_rng(seed).integers(0, 4, steps)
    share = np.bincount(truth, minlength=4) / steps
    mean = np.nansum(metrics.class_pr(probability, truth) * share)
    overall = metrics.overall_pr(probability, truth)
    assert mean == pytest.approx(overall)
    assert overall <= metrics.accuracy(truth, probability.argmax(1)) + 1e-12


@given(st.integers(1, 500))
def test_the_last_third_starts_where_the_paper_says(steps):
    assert metrics.window_start(steps) == int(2 * steps / 3) + 1


def test_counts_and_both_m_by_hand():
    sure, unsure, wrong = [0.9, 0.1], [0.6, 0.4], [0.1, 0.9]
    # Six steps: the window is step 5 alone. Nine steps: steps 7 and 8.
    six = np.array([wrong] * 5 + [sure])
    nine = np.array([sure] * 8 + [unsure])
    other = np.array([sure] * 9)
    made = metrics.certainties([six, nine, other], [0, 0, 1], k=0.7)
    np.testing.assert_array_equal(made.count_min, [1, 0])
    np.testing.assert_array_equal(made.count_mean, [1, 0])
    np.testing.assert_array_equal(made.avg_len, [7.5, 9])
    np.testing.assert_allclose(made.m_paper, [1 / 2.5, 0])
    np.testing.assert_allclose(made.m_own, [(1 / 1 + 1 / 2) / 2, 0])


def test_the_papers_m_exceeds_one_for_a_long_trial_and_the_own_window_does_not():
    certain = np.array([[0.99, 0.01]])
    made = metrics.certainties([np.repeat(certain, n, 0) for n in (2, 2, 60)], [0, 0, 0], k=0.7)
    assert made.count_max[0] / (made.avg_len[0] / 3) > 1
    assert made.count_min[0] == 0  # of a trial without a last third
    assert made.m_own[0] == 1
    assert np.isnan(made.m_own[1])


@settings(max_examples=40)
@given(st.integers(0, 1000), st.lists(st.integers(1, 30), min_size=1, max_size=6))
def test_counts_fall_as_the_threshold_rises(seed, lengths):
    trials = [beliefs(seed + i, n) for i, n in enumerate(lengths)]
    truth = [i % 4 for i in range(len(lengths))]
    made = [metrics.certainties(trials, truth, k) for k in metrics.CERTAINTY_LEVELS]
    for low, high in itertools.pairwise(made):
        assert np.all((low.count_mean >= high.count_mean) | np.isnan(low.count_mean))
        assert np.all((low.m_own >= high.m_own) | np.isnan(low.m_own))
    assert np.nanmax(np.append(made[0].m_own, 0)) <= 1


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="two scores"):
        metrics.corrected_interval(np.array([0.5]), 0.25)
    with pytest.raises(InputError, match="compared"):
        metrics.accuracy(np.array([1]), np.array([1, 2]))
    with pytest.raises(InputError, match="one row per step"):
        metrics.overall_pr(np.ones((3, 2)) / 2, np.array([0]))
    with pytest.raises(InputError, match="compared"):
        metrics.certainties([], [])


def test_calibration_error_by_hand():
    probability = np.array([[0.9, 0.1], [0.9, 0.1], [0.4, 0.6], [0.45, 0.55], [0.35, 0.65]])
    truth = np.array([0, 1, 1, 0, 1])
    table = metrics.reliability(probability, truth)
    np.testing.assert_allclose(table[9], [0.4, 0.9, 0.5])
    np.testing.assert_allclose(table[6], [0.4, 0.625, 1.0])
    np.testing.assert_allclose(table[5], [0.2, 0.55, 0.0])
    assert np.isnan(table[0, 1])
    assert metrics.calibration_error(probability, truth) == pytest.approx(0.4 * 0.4 + 0.4 * 0.375 + 0.2 * 0.55)


def test_true_probabilities_are_calibrated():
    rng = np.random.default_rng(0)
    first = rng.uniform(size=40_000)
    truth = (rng.uniform(size=40_000) > first).astype(np.int64)
    assert metrics.calibration_error(np.stack([first, 1 - first], 1), truth) < 0.01
    assert metrics.calibration_error(np.stack([first**3, 1 - first**3], 1), truth) > 0.05


@pytest.mark.parametrize(("groups", "plain", "expanded"), [(5, 0.83, 0.91), (8, 0.88, 0.93), (14, 0.91, 0.94)])
def test_intervals_from_drawn_groups_hold_the_truth_more_often_than_plain_percentiles(groups, plain, expanded):
    """The shares of docs/evaluation.md, for groups whose own shares are 0.8 in the mean."""
    rng, held = np.random.default_rng(groups), []
    for _ in range(1000):
        share = rng.beta(4, 1, groups)
        draws = rng.multinomial(groups, np.full(groups, 1 / groups), 1000) @ share / groups
        ends = np.quantile(draws, [0.025, 0.975]), metrics.percentile_interval(draws, groups)
        held.append([low <= 0.8 <= high for low, high in ends])
    assert np.mean(held, 0) == pytest.approx([plain, expanded], abs=0.025)
