"""Cross-validation of any estimator on the same grouped folds, so that scores can be compared fold by fold.

Protocol: an estimator here is a function ``(train, test, seed) -> (class index per test row, hyper-parameters)`` over
row numbers of a data set that it holds. It selects everything on the training rows. ``nested_svm``, ``forest`` and
``majority`` are factories of estimators; own ones need nothing but that signature. Objects with ``fit`` and ``predict``
are in :mod:`rcbht_jax.learning.estimators`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from rcbht_jax.learning import metrics
from rcbht_jax.learning.class_groups import LARGEST, SEEDS, inner_groups, some_items
from rcbht_jax.learning.svm import Grid, Ints, Matrix, Split, SvmSpec, Weight, fit, grouped_folds, predictions, select

with needs_extra("learn"):
    from sklearn.ensemble import RandomForestClassifier

Rows = NDArray[np.int64]
Prediction = tuple[Rows, dict[str, Any]]
Estimator = Callable[[Rows, Rows, int], Prediction]

_TREES = 50
_SEEDS_APART = 1000


def nested_svm(
    candidates: Mapping[str, Matrix],
    y: Ints,
    groups: NDArray[Any],
    grid: Grid,
    weights: Mapping[str, Weight] | None = None,
    progress: Callable[[int], Any] | None = None,
    trials: NDArray[Any] | None = None,
) -> Estimator:
    """Estimator: an SVM whose kernel, cost, scaling and feature matrix are selected inside the training rows.

    Args:
        candidates, y, groups, grid, weights: as in :func:`rcbht_jax.learning.svm.select`. Of many training rows, the
            selection takes :func:`rcbht_jax.learning.class_groups.some_items`.
        progress: called with 1 after each prediction.
        trials: ``[item]``, of which the groups consist. They take the place of groups in the selection where the
            training rows have too few of these: fewer than two classes with two groups. None = the groups.

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

    def predict(train: Rows, test: Rows, seed: int) -> Prediction:
        units = groups[train] if trials is None else trials[train]
        apart = inner_groups(y[train], groups[train], units)
        some = some_items(y[train], apart, units, seed)
        chosen_on = {name: x[train[some]] for name, x in doubles.items()}
        spec = select(chosen_on, y[train[some]], apart[some], grid, seed, weights)
        weight = (weights or {}).get(spec.features)
        x = doubles[spec.features]
        if len(train) > LARGEST:
            predicted = _of_many(x, y, train, test, spec, weight)
        else:
            predicted = predictions(x, y, train, test, spec, [spec.cost], weight)[0]
        if progress:
            progress(1)
        return predicted, asdict(spec)

    return predict


def _of_many(x: Matrix, y: Ints, train: Rows, test: Rows, spec: SvmSpec, weight: Weight) -> NDArray[np.int64]:
    """As ``predictions``, but for rounding; without the kernel matrix of all items, which would take gigabytes."""
    classes, code = np.unique(y[train], return_inverse=True)
    machine = fit(x[train], code, classes.astype(str).tolist(), spec, weight)
    return classes[machine.predict_index(x[test])].astype(np.int64)


def forest(x: Matrix, y: Ints) -> Estimator:
    """Estimator: a random forest on ``[item, feature]``, the baseline for a few numbers such as durations."""

    def predict(train: Rows, test: Rows, seed: int) -> Prediction:
        trees = RandomForestClassifier(_TREES, random_state=seed).fit(x[train], y[train])
        return trees.predict(x[test]).astype(np.int64), {}

    return predict


def majority(y: Ints) -> Estimator:
    """Estimator: always the most frequent class of the training rows."""

    def predict(train: Rows, test: Rows, seed: int) -> Prediction:
        return np.full(len(test), np.bincount(y[train]).argmax(), np.int64), {}

    return predict


def without_intervals(summary: dict[str, Any]) -> dict[str, Any]:
    """Scores without their intervals: the share of the most frequent class is fixed by construction."""
    return {name: {"mean": part["mean"]} if isinstance(part, dict) and "mean" in part else part
            for name, part in summary.items()}  # fmt: skip


@dataclass(frozen=True)
class CrossValidation:
    """Scores of one estimator."""

    accuracy: Float[np.ndarray, "repeat fold"]
    balanced_accuracy: Float[np.ndarray, "repeat fold"]
    chosen: list[list[dict[str, Any]]]  # [repeat][fold] hyper-parameters
    confusion: Int[np.ndarray, "true predicted"]  # summed over folds and repeats
    test_to_train: float  # ratio of their sizes
    split: Int[np.ndarray, "repeat fold"]  # number of the test set among the different ones
    items: Int[np.ndarray, " class"]  # tested ones, of the classes that are tested

    @property
    def equal_items(self) -> float:
        """Number of items that say as much of mean recall, were their classes of equal size."""
        return metrics.equal_items(self.items)

    def summary(self, trials: int = 0) -> dict[str, Any]:
        """min / mean / max over the folds of a run (averaged over repeats), and corrected 95% intervals.

        Args:
            trials: that were tested; where all folds score the same, the interval is Wilson's for so many, and it is
                nowhere narrower than Wilson's of independent items, as stratified folds of a rare class would make it.
                0 = neither.
        """
        return {
            "accuracy": _interval(self.accuracy, self, trials, float(self.items.sum())),
            "balanced_accuracy": _interval(self.balanced_accuracy, self, trials, self.equal_items),
            "fold_min_mean_max": [float(f(self.accuracy, axis=1).mean()) for f in (np.min, np.mean, np.max)],
        }


def _interval(scores: NDArray[np.float64], run: CrossValidation, trials: int, items: float) -> dict[str, float]:
    mean, low, high = metrics.corrected_interval(scores, run.test_to_train, split=run.split)
    if trials and not metrics.has_width(low, high):
        low, high = metrics.wilson(mean * trials, trials)
    if trials:
        least = metrics.wilson(mean * items, items)
        low, high = min(low, least[0]), max(high, least[1])
    return {"mean": mean, "low": low, "high": high}


def repeated_folds(
    y: Ints, groups: NDArray[Any], folds: int, repeats: int, seed: int, group: str = "trial"
) -> list[list[Split]]:
    """``grouped_folds`` for each of ``repeat_seeds``: ``[repeat][fold]``."""
    return [grouped_folds(y, groups, folds, one, group) for one in repeat_seeds(seed, repeats)]


def repeat_seeds(seed: int, repeats: int) -> range:
    """Seeds of repetitions, of which two different seeds below four million share none.

    Raises:
        InputError: more than 1000 repetitions.

    Example:
        >>> list(repeat_seeds(0, 3)), list(repeat_seeds(1, 3))
        ([0, 1, 2], [1000, 1001, 1002])
    """
    if repeats > _SEEDS_APART:
        raise InputError(f"There are {repeats} repeats; expected at most {_SEEDS_APART}.")
    first = _SEEDS_APART * seed % (SEEDS - _SEEDS_APART)
    return range(first, first + repeats)


def cross_validate(estimator: Estimator, y: Ints, splits: Sequence[Sequence[Split]], seed: int = 0) -> CrossValidation:
    """Score an estimator on ``splits`` (``[repeat][fold]``, the same number of folds in each repeat).

    Args:
        estimator: see the module.
        y: class index ``[item]``.
        splits: training and test rows.
        seed: the estimator gets ``1000 * (seed + repeat) + fold``, modulo 2^32.

    Example:
        >>> y = np.array([0, 0, 0, 1])
        >>> halves = [[(np.array([0, 1]), np.array([2, 3])), (np.array([2, 3]), np.array([0, 1]))]]
        >>> cross_validate(majority(y), y, halves).accuracy.tolist()
        [[0.5, 1.0]]
    """
    classes = int(y.max()) + 1
    plain, balanced = (np.zeros((len(splits), len(splits[0]))) for _ in range(2))
    chosen: list[list[dict[str, Any]]] = [[] for _ in splits]
    table = np.zeros((classes, classes), np.int64)
    for repeat, folds in enumerate(splits):
        for number, (train, test) in enumerate(folds):
            predicted, choice = estimator(train, test, (1000 * (seed + repeat) + number) % SEEDS)
            plain[repeat, number] = metrics.accuracy(y[test], predicted)
            balanced[repeat, number] = metrics.balanced_accuracy(y[test], predicted)
            table += metrics.confusion(y[test], predicted, classes)
            chosen[repeat].append(choice)
    sizes = np.array([(len(train), len(test)) for train, test in splits[0]])
    partition = len(sizes) > 1 and sizes[:, 1].sum() == len(y)
    ratio = 1 / (len(sizes) - 1) if partition else float(np.mean(sizes[:, 1] / sizes[:, 0]))
    known: dict[bytes, int] = {}
    tests = [[known.setdefault(np.sort(test).tobytes(), len(known)) for _, test in folds] for folds in splits]
    counts = np.unique(y[np.unique(np.concatenate([test for _, test in splits[0]]))], return_counts=True)[1]
    return CrossValidation(plain, balanced, chosen, table, ratio, np.array(tests), counts)


@dataclass(frozen=True)
class HoldoutScore:
    """Scores of one estimator trained on some items and tested on others."""

    accuracy: float
    balanced_accuracy: float
    low: float  # 95% interval of the accuracy: Wilson's, each trial counting once, since its items are not independent
    high: float
    chosen: dict[str, Any]
    confusion: Int[np.ndarray, "true predicted"]

    @staticmethod
    def of(run: CrossValidation, trials: int) -> HoldoutScore:
        """The only split of a run, which tests so many trials."""
        score = float(run.accuracy[0, 0])
        low, high = metrics.wilson(score * trials, trials)
        return HoldoutScore(score, float(run.balanced_accuracy[0, 0]), low, high, run.chosen[0][0], run.confusion)

    def summary(self) -> dict[str, Any]:
        """The accuracy with its interval, and the balanced accuracy."""
        return {
            "accuracy": {"mean": self.accuracy, "low": self.low, "high": self.high},
            "balanced_accuracy": {"mean": self.balanced_accuracy},
        }


def holdout_score(estimator: Estimator, y: Ints, groups: NDArray[Any], split: Split, seed: int = 0) -> HoldoutScore:
    """Train on one side of ``split`` and test on the other.

    Args:
        estimator: see the module.
        y: class index ``[item]``.
        groups: trial ``[item]``.
        split: training and test rows.
        seed: of the estimator.
    """
    return HoldoutScore.of(cross_validate(estimator, y, [[split]], seed), len(np.unique(groups[split[1]])))
