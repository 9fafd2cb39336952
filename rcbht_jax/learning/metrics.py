"""Scores: of classifications, of repeated cross-validation, and of beliefs that arrive step by step.

Pure functions on host arrays. Class indices are integers 0, 1, ...; probabilities are ``[step, class]``.
Definitions of the streaming numbers: the paper's section on online results.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax.errors import InputError

Ints = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]

CERTAINTY_LEVELS = (0.70, 0.75, 0.80, 0.85, 0.90, 0.95)  # the paper's k
Z = 1.96  # quantile of the normal distribution, for 95 %
INADMISSIBLE = 0.5  # a belief below this is inadmissible
NARROWEST = 1e-9  # a narrower interval has no width but that of rounding


def accuracy(y_true: Ints, y_pred: Ints) -> float:
    """Share of ``[n]`` items whose class is predicted correctly.

    Raises:
        InputError: no items, or different numbers of them.
    """
    _same(y_true, y_pred)
    return float(np.mean(y_true == y_pred))


def recall(y_true: Ints, y_pred: Ints, classes: int) -> NDArray[np.float64]:
    """Share of each class's items predicted correctly, ``[class]``; NaN where the class does not occur."""
    table = confusion(y_true, y_pred, classes).astype(np.float64)
    total = table.sum(1)
    return np.divide(table.diagonal(), total, out=np.full(classes, np.nan), where=total > 0)


def balanced_accuracy(y_true: Ints, y_pred: Ints) -> float:
    """Mean recall over the classes that occur in ``y_true``."""
    _same(y_true, y_pred)
    return float(np.nanmean(recall(y_true, y_pred, int(max(y_true.max(), y_pred.max())) + 1)))


def confusion(y_true: Ints, y_pred: Ints, classes: int) -> NDArray[np.int64]:
    """Counts ``[true class, predicted class]``."""
    _same(y_true, y_pred)
    pairs = y_true.astype(np.int64) * classes + y_pred.astype(np.int64)  # which eight bits need not hold
    return np.bincount(pairs, minlength=classes * classes).reshape(classes, classes)


def _same(y_true: Ints, y_pred: Ints) -> None:
    if y_true.shape != y_pred.shape or y_true.size == 0:
        raise InputError(f"{y_true.size} true classes and {y_pred.size} predicted ones cannot be compared.")


def corrected_interval(scores: Floats, test_to_train: float, split: Ints | None = None) -> tuple[float, float, float]:
    """Mean and 95 % confidence limits of scores from repeated train/test splits, corrected for their overlap.

    Nadeau and Bengio (2003): the variance of the mean of J scores is (1/J + n_test/n_train) s^2, with
    J - 1 degrees of freedom. Limits are cut to [0, 1], the range of scores. A split that is repeated, as folds of a few
    groups are, adds no information: J counts different splits, and s^2 is the variance of their means.

    Args:
        scores: one per split, any shape, in [0, 1].
        test_to_train: n_test / n_train, which is 1 / (k - 1) for k folds.
        split: number of each score's split, of the shape of the scores; None = all are different.

    Raises:
        InputError: scores of fewer than two splits.
    """
    mean = float(scores.mean())
    if split is not None and split.max(initial=0) + 1 < scores.size:
        scores = np.bincount(split.ravel(), scores.ravel()) / np.bincount(split.ravel())
    if scores.size < 2:
        raise InputError(f"an interval needs at least two scores; there are {scores.size}.")
    from scipy.special import stdtrit  # a fifth of the time that "rcbht info" takes to start

    error = np.sqrt((1 / scores.size + test_to_train) * scores.var(ddof=1))
    half = float(stdtrit(scores.size - 1, 0.975) * error)
    return mean, max(0.0, mean - half), min(1.0, mean + half)


def wilson(good: float, trials: float) -> tuple[float, float]:
    """95 % interval of a share, never of zero width (Wilson 1927).

    Args:
        good: how many of them; may be a fraction, for a trial some of whose items are right.
        trials: how many, > 0; a fraction, if they count for so many.

    >>> [round(end, 3) for end in wilson(35, 35)]
    [0.901, 1.0]
    """
    share, spread = good / trials, Z * Z / trials
    middle = (share + spread / 2) / (1 + spread)
    half = Z / (1 + spread) * np.sqrt(share * (1 - share) / trials + spread / (4 * trials))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def equal_items(sizes: ArrayLike) -> float:
    """Number of items that say as much of mean recall, were the classes of these ``sizes`` ``[class]`` equally large.

    >>> equal_items([50, 50]), round(equal_items([98, 2]), 1)
    (100.0, 7.8)
    """
    counts = np.asarray(sizes, np.float64)
    return float(len(counts) ** 2 / (1 / counts).sum())


def percentile_interval(scores: ArrayLike, groups: int) -> tuple[float, float]:
    """95 % interval from scores of groups that were drawn with replacement: expanded percentiles (Hesterberg 2015).

    The percentiles are those of the normal distribution at the quantile of Student's t, times sqrt(n / (n - 1)) for n
    groups: plain ones leave out that the spread of few groups is estimated, and estimated too small.

    Args:
        scores: one for each draw.
        groups: how many there are, two or more.

    Example:
        >>> scores = np.linspace(0, 1, 1001)
        >>> [[round(end, 3) for end in percentile_interval(scores, n)] for n in (8, 30, 1000)]
        [[0.006, 0.994], [0.019, 0.981], [0.025, 0.975]]
    """
    from scipy.special import ndtr, stdtrit

    level = ndtr(-np.sqrt(groups / (groups - 1)) * stdtrit(groups - 1, 0.975))
    low, high = np.quantile(np.asarray(scores, np.float64), [level, 1 - level])
    return float(low), float(high)


def has_width(low: float, high: float) -> bool:
    """False for an interval whose ends differ by rounding alone, as where all scores are the same.

    >>> has_width(0.7, 0.7000000000000002), has_width(0.7, 0.701)
    (False, True)
    """
    return bool(high - low > NARROWEST)


def rule_of_three(trials: int) -> float:
    """Largest share of trials with a mistake that is compatible, at 95 %, with none seen in so many.

    >>> round(rule_of_three(35), 3)
    0.086
    """
    return min(1.0, 3 / trials)


def overall_pr(probability: Floats, y_true: Ints) -> float:
    """The paper's OverallPr: mean over steps of (largest probability x correct)."""
    return float(np.mean(_credit(probability, y_true)))


def class_pr(probability: Floats, y_true: Ints) -> NDArray[np.float64]:
    """The paper's ClassPr: as OverallPr over the steps of each class, ``[class]``; NaN where it has none."""
    classes = probability.shape[1]
    steps = np.bincount(y_true, minlength=classes)
    credit = np.bincount(y_true, _credit(probability, y_true), minlength=classes)
    return np.divide(credit, steps, out=np.full(classes, np.nan), where=steps > 0)


def macro_step_accuracy(probability: Floats, y_true: Ints) -> float:
    """Mean over the classes present of the share of their steps predicted correctly while streaming."""
    _check(probability, y_true)
    return float(np.nanmean(recall(y_true, probability.argmax(1), probability.shape[1])))


def _check(probability: Floats, y_true: Ints) -> None:
    if probability.ndim != 2 or probability.shape[0] != y_true.shape[0] or y_true.size == 0:
        raise InputError(
            f"probabilities of shape {probability.shape} do not fit {y_true.size} true classes; "
            "expected one row per step."
        )


def _credit(probability: Floats, y_true: Ints) -> NDArray[np.float64]:
    _check(probability, y_true)
    return np.where(probability.argmax(1) == y_true, probability.max(1), 0.0)


def reliability(probability: Floats, y_true: Ints, bins: int = 10) -> NDArray[np.float64]:
    """Reliability diagram of the predicted class: ``[bin, 3]`` share of steps, mean probability, share correct.

    Bins are equal parts of [0, 1]; empty ones hold 0, NaN, NaN.
    """
    _check(probability, y_true)
    top = probability.max(1)
    index = np.minimum((top * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    sums = np.stack([np.bincount(index, w, bins) for w in (top, probability.argmax(1) == y_true)], 1)
    mean = np.divide(sums, count[:, None], out=np.full((bins, 2), np.nan), where=count[:, None] > 0)
    return np.concatenate([(count / len(y_true))[:, None], mean], 1)


def calibration_error(probability: Floats, y_true: Ints, bins: int = 10) -> float:
    """Expected calibration error of the predicted class: mean distance of probability and accuracy, by step."""
    share, y_pred, right = reliability(probability, y_true, bins).T
    return float(np.nansum(share * np.abs(y_pred - right)))


def window_start(steps: int) -> int:
    """First step of the paper's last third: int(2n/3) + 1, counted from 0."""
    return 2 * steps // 3 + 1


@dataclass(frozen=True)
class Certainty:
    """The paper's counts of certain steps, which are those in the last third of a trial, correct and above k.

    Every array is ``[class]``, NaN where a class has no trial.
    """

    k: float
    count_min: NDArray[np.float64]  # steps, smallest over the trials of the class
    count_mean: NDArray[np.float64]
    count_max: NDArray[np.float64]
    avg_len: NDArray[np.float64]  # mean number of steps of the class
    m_paper: NDArray[np.float64]  # count_mean / (avg_len / 3): can exceed 1 for trials longer than average
    m_own: NDArray[np.float64]  # mean over trials of count / length of the trial's own window, in [0, 1]


def certainties(probabilities: Sequence[Floats], y_true: Sequence[int], k: float = CERTAINTY_LEVELS[0]) -> Certainty:
    """Counts, AvgLen and m of a set of trials, each ``[step, class]`` with one true class.

    Trials too short to have a last third (three steps or fewer) count in the paper's m, as in the paper,
    and are left out of ``m_own``.

    Raises:
        InputError: no trials, or different numbers of trials and classes.
    """
    if not probabilities or len(probabilities) != len(y_true):
        raise InputError(f"{len(probabilities)} trials and {len(y_true)} true classes cannot be compared.")
    classes = probabilities[0].shape[1]
    of_class = np.asarray(y_true)
    last = [p[window_start(len(p)) :] for p in probabilities]
    certain = [(p.argmax(1) == c) & (p.max(1) > k) for p, c in zip(last, y_true, strict=True)]
    counts, window = (np.array([f(part) for part in certain], np.float64) for f in (np.sum, len))
    steps = np.array([len(p) for p in probabilities], np.float64)
    own = np.divide(counts, window, out=np.full(len(counts), np.nan), where=window > 0)

    def per_class(value: NDArray[np.float64], reduce: Any) -> NDArray[np.float64]:
        chosen = [value[(of_class == c) & ~np.isnan(value)] for c in range(classes)]
        return np.array([reduce(v) if v.size else np.nan for v in chosen])

    low, mean, high = (per_class(counts, f) for f in (np.min, np.mean, np.max))
    avg_len = per_class(steps, np.mean)
    return Certainty(k, low, mean, high, avg_len, mean / (avg_len / 3), per_class(own, np.mean))
