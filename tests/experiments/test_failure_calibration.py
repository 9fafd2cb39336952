"""Calibration by progress: it mends what it says, and never reads the trials that it is applied to."""

from __future__ import annotations

import numpy as np
import pytest

from experiments._lib.results_io import committed
from experiments.online.failure_calibration import by_progress, error, errors, interval
from rcbht_jax.learning.progress import PARTS, mixed, part_of

STEPS, CLASSES, FOLDS = 4000, 5, 5
PLANNED = np.full(FOLDS, 8.0)  # s
TRIAL = np.arange(STEPS).astype(str)  # a step each


@pytest.fixture
def beliefs() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Beliefs that say too much early and too little late, classes, folds, and seconds."""
    rng = np.random.default_rng(0)
    seconds = rng.uniform(0, 8, STEPS)
    late = seconds > 4
    y = rng.integers(0, CLASSES, STEPS)
    known = rng.random(STEPS) < np.where(late, 0.9, 0.0)
    said = np.where(known, y, rng.integers(0, CLASSES, STEPS))
    p = np.full((STEPS, CLASSES), 0.1)
    p[np.arange(STEPS), said] = 0.6
    return p, y, rng.integers(0, FOLDS, STEPS), seconds


def test_beliefs_are_calibrated_in_each_quarter(beliefs: tuple[np.ndarray, ...]) -> None:
    p, y, fold, seconds = beliefs
    quarter, names = part_of(seconds / 8), tuple("abcde")
    before = errors(p, y, quarter, names, TRIAL)
    after = errors(by_progress(p, y, fold, seconds, TRIAL, PLANNED), y, quarter, names, TRIAL)
    for part in range(1, PARTS + 1):
        assert before[f"quarter {part}"]["likeliest"] > 0.25
        assert after[f"quarter {part}"]["likeliest"] < 0.08
        assert after[f"quarter {part}"]["worst class"] < 0.05
    assert before["pooled"] < before["quarter 1"]["likeliest"]  # what a pooled error hides


def test_calibration_does_not_read_the_trials_that_it_serves(beliefs: tuple[np.ndarray, ...]) -> None:
    p, y, fold, seconds = beliefs
    other = np.where(fold == 2, (y + 1) % CLASSES, y)
    first, second = (by_progress(p, known, fold, seconds, TRIAL, PLANNED) for known in (y, other))
    np.testing.assert_array_equal(first[fold == 2], second[fold == 2])
    assert not np.array_equal(first, second)


def test_the_error_of_one_class_is_that_of_its_bins() -> None:
    p, true = np.array([0.05, 0.05, 0.95, 0.95]), np.array([False, True, True, True])
    assert error(p, true) == pytest.approx((abs(0.1 - 1) + abs(1.9 - 2)) / 4)
    prior = np.array([0.5, 0.5])
    np.testing.assert_allclose(mixed(np.array([[0.9, 0.1]]), 1.0, 0.5, prior), [[0.7, 0.3]])
    assert part_of(np.array([0.0, 0.26, 1.0, 7.0])).tolist() == [0, 1, 3, 3]


def test_the_committed_errors_are_whole() -> None:
    result = committed("failure_calibration")
    assert result["complete"]
    for row in result["rows"].values():
        assert all(len(row["by progress"][f"quarter {part}"]["classes"]) == 13 for part in range(1, PARTS + 1))


def test_intervals_of_calibration_errors_hold_the_truth() -> None:
    """Beliefs of 0.8 that are right in 0.6 of the steps, more often in some trials than in others."""
    trial, held = np.repeat(np.arange(30), 10), 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        y = (rng.random(300) > np.repeat(rng.beta(6, 4, 30), 10)).astype(int)
        low, high = interval(np.full(300, 0.8), y == 0, trial)
        held += low <= 0.2 <= high
    assert held >= 90
