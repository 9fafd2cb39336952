"""Cross-validation of own estimators: ratios and counts by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.metrics import confusion_matrix
from sklearn.model_selection import ShuffleSplit

from rcbht_jax.learning.validation import cross_validate, forest, holdout_score, majority, repeated_folds

Rows = NDArray[np.int64]


def test_the_correction_is_for_the_sizes_of_the_splits() -> None:
    """Nadeau and Bengio: n_test / n_train of splits drawn at random, 1 / (k - 1) of k folds of nearly equal sizes."""
    y = np.arange(40) % 2
    drawn = list(ShuffleSplit(7, test_size=8, train_size=24, random_state=0).split(y))
    assert cross_validate(majority(y), y, [drawn]).test_to_train == pytest.approx(1 / 3)
    folds = [(np.setdiff1d(np.arange(40), test), test) for test in np.array_split(np.arange(40), 3)]
    assert cross_validate(majority(y), y, [folds]).test_to_train == pytest.approx(1 / 2)
    single = [folds[0]]  # 14 are tested after training on 26
    assert cross_validate(majority(y), y, [single]).test_to_train == pytest.approx(14 / 26)


def test_mistakes_of_a_transfer_are_in_the_row_of_the_true_class() -> None:
    y, guess = np.array([0, 1, 2, 0, 0, 1, 2, 2]), np.array([0, 1, 2, 1, 1, 2, 2, 0])

    def estimator(train: Rows, test: Rows, seed: int) -> tuple[Rows, dict[str, Any]]:
        return guess[test], {"seed": seed, "trained": len(train)}

    made = holdout_score(estimator, y, np.arange(8), (np.arange(3), np.arange(3, 8)), seed=4)
    np.testing.assert_array_equal(made.confusion, confusion_matrix(y[3:], guess[3:]))
    assert made.chosen == {"seed": 4000, "trained": 3}
    assert made.balanced_accuracy == pytest.approx((0 + 0 + 1 / 2) / 3)


def test_every_seed_of_the_command_line_is_one_of_scikit_learn() -> None:
    """A date such as 20261130, times 1000, is none."""
    y = np.arange(8) % 2
    for seed in (20261130, 2**32 - 1):
        folds = repeated_folds(y, np.arange(8), folds=2, repeats=2, seed=seed)
        learn = forest(y[:, None].astype(float), y)
        assert cross_validate(learn, y, folds, seed).accuracy.tolist() == [[1.0, 1.0]] * 2
        assert holdout_score(learn, y, np.arange(8), folds[0][0], seed).accuracy == 1.0
