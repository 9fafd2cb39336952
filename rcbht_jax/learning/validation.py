"""Cross-validation of any learner on the same grouped folds, so that scores can be compared fold by fold.

A learner is a function (training rows, test rows, seed) -> (class index per test row, what it chose). It must
choose everything on the training rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from rcbht_jax.learning import metrics
from rcbht_jax.learning.svm import Grid, Split, Weight, grouped_folds, predictions, select

with needs_extra("learn"):
    from sklearn.ensemble import RandomForestClassifier

Ints = NDArray[np.integer[Any]]
Matrix = NDArray[np.floating[Any]]
Prediction = tuple[NDArray[np.int64], dict[str, Any]]
Estimator = Callable[[NDArray[np.int64], NDArray[np.int64], int], Prediction]

_TREES = 50
_RESAMPLES = 2000


def nested_svm(
    candidates: Mapping[str, Matrix],
    y: Ints,
    groups: NDArray[Any],
    grid: Grid,
    weights: Mapping[str, Weight] | None = None,
    progress: Callable[[int], Any] | None = None,
) -> Estimator:
    """SVM whose kernel, cost, scaling and feature matrix are selected inside the training rows.

    Args:
        candidates: feature matrices ``[item, feature]`` by name, all of the same items.
        y: class index ``[item]``.
        groups: trial ``[item]``.
        grid: what to choose from.
        weights: of the features ``[feature]``, by name of the matrix, where they do not all weigh the same.
        progress: called with 1 after each prediction.

    Raises:
        InputError: a matrix has another number of items or a value that is not finite.
    """
    doubles = {name: np.asarray(x, np.float64) for name, x in candidates.items()}
    for name, x in doubles.items():
        if x.ndim != 2 or len(x) != len(y) or not np.isfinite(x).all():
            raise InputError(
                f"feature matrix {name!r} of shape {x.shape} needs one row for each of {len(y)} items and "
                "finite values."
            )

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> Prediction:
        inside = {name: x[train] for name, x in doubles.items()}
        spec = select(inside, y[train], groups[train], grid, seed, weights)
        weight = (weights or {}).get(spec.features)
        said = predictions(doubles[spec.features], y, train, test, spec, [spec.cost], weight)[0]
        if progress:
            progress(1)
        return said, asdict(spec)

    return learn


def forest(x: Matrix, y: Ints) -> Estimator:
    """Random forest on ``[item, feature]``: the baseline that shows what a few plain numbers give away."""

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> Prediction:
        trees = RandomForestClassifier(_TREES, random_state=seed).fit(x[train], y[train])
        return trees.predict(x[test]).astype(np.int64), {}

    return learn


def majority(y: Ints) -> Estimator:
    """Always the most frequent class of the training rows."""

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> Prediction:
        return np.full(len(test), np.bincount(y[train]).argmax(), np.int64), {}

    return learn


@dataclass(frozen=True)
class CrossValidation:
    """Scores ``[repeat, fold]`` of one learner."""

    accuracy: NDArray[np.float64]
    balanced_accuracy: NDArray[np.float64]
    chosen: list[list[dict[str, Any]]]  # [repeat][fold]
    confusion: NDArray[np.int64]  # [true, said], summed over folds and repeats

    def summary(self) -> dict[str, Any]:
        """min / mean / max over the folds of a run (averaged over repeats), and corrected 95% intervals."""
        ratio = 1 / (self.accuracy.shape[1] - 1)
        return {
            "accuracy": _interval(self.accuracy, ratio),
            "balanced_accuracy": _interval(self.balanced_accuracy, ratio),
            "fold_min_mean_max": [float(f(self.accuracy, axis=1).mean()) for f in (np.min, np.mean, np.max)],
        }


def _interval(scores: NDArray[np.float64], ratio: float) -> dict[str, float]:
    mean, low, high = metrics.corrected_interval(scores, ratio)
    return {"mean": mean, "low": low, "high": high}


def repeated_folds(y: Ints, groups: NDArray[Any], folds: int, repeats: int, seed: int) -> list[list[Split]]:
    """``grouped_folds`` for the seeds ``seed`` ... ``seed + repeats - 1``: ``[repeat][fold]``."""
    return [grouped_folds(y, groups, folds, seed + repeat) for repeat in range(repeats)]


def cross_validate(learner: Estimator, y: Ints, splits: Sequence[Sequence[Split]], seed: int = 0) -> CrossValidation:
    """Score a learner on ``splits`` (``[repeat][fold]``, the same number of folds in each repeat).

    Args:
        learner: see the module.
        y: class index ``[item]``.
        splits: training and test rows.
        seed: the learner gets ``1000 * (seed + repeat) + fold``.
    """
    classes = int(y.max()) + 1
    plain, balanced = (np.zeros((len(splits), len(splits[0]))) for _ in range(2))
    chosen: list[list[dict[str, Any]]] = [[] for _ in splits]
    table = np.zeros((classes, classes), np.int64)
    for repeat, folds in enumerate(splits):
        for number, (train, test) in enumerate(folds):
            said, choice = learner(train, test, 1000 * (seed + repeat) + number)
            plain[repeat, number] = metrics.accuracy(y[test], said)
            balanced[repeat, number] = metrics.balanced_accuracy(y[test], said)
            table += metrics.confusion(y[test], said, classes)
            chosen[repeat].append(choice)
    return CrossValidation(plain, balanced, chosen, table)


@dataclass(frozen=True)
class HoldoutScore:
    """Scores of one learner trained on some items and tested on others."""

    accuracy: float
    balanced_accuracy: float
    low: float  # 95% interval of the accuracy, by resampling the test trials
    high: float
    chosen: dict[str, Any]
    confusion: NDArray[np.int64]  # [true, said]

    def summary(self) -> dict[str, Any]:
        """The accuracy with its interval, and the balanced accuracy."""
        return {
            "accuracy": {"mean": self.accuracy, "low": self.low, "high": self.high},
            "balanced_accuracy": {"mean": self.balanced_accuracy},
        }


def holdout_score(learner: Estimator, y: Ints, groups: NDArray[Any], split: Split, seed: int = 0) -> HoldoutScore:
    """Train on one side of ``split`` and test on the other.

    Args:
        learner: see the module.
        y: class index ``[item]``.
        groups: trial ``[item]``.
        split: training and test rows.
        seed: of the learner and of the resampling.
    """
    train, test = split
    said, choice = learner(train, test, 1000 * seed)
    low, high = bootstrap(y[test] == said, groups[test], seed)
    truth, classes = y[test], int(y.max()) + 1
    return HoldoutScore(
        accuracy=metrics.accuracy(truth, said),
        balanced_accuracy=metrics.balanced_accuracy(truth, said),
        low=low,
        high=high,
        chosen=choice,
        confusion=metrics.confusion(truth, said, classes),
    )


def bootstrap(correct: NDArray[np.bool_], groups: NDArray[Any], seed: int) -> tuple[float, float]:
    """95% percentile bootstrap over groups of the share of ``correct`` [item]: items of a trial are not independent."""
    number = np.unique(groups, return_inverse=True)[1]
    right, total = np.bincount(number, correct), np.bincount(number)
    draws = np.random.default_rng(seed).integers(0, len(total), (_RESAMPLES, len(total)))
    scores = right[draws].sum(1) / total[draws].sum(1)
    low, high = np.quantile(scores, [0.025, 0.975])
    return float(low), float(high)
