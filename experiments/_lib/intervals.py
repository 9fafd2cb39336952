"""95 % intervals that are never of zero width: a score without a mistake only bounds how frequent mistakes are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from rcbht_jax.learning.metrics import corrected_interval, has_width, percentile_interval, wilson
from rcbht_jax.learning.validation import CrossValidation

RESAMPLES = 2000


def with_width(score: dict[str, Any], trials: float) -> dict[str, Any]:
    """A score with ``mean``, ``low`` and ``high``; where the ends coincide they are Wilson's, by trial.

    Args:
        score: of repeated folds, or of one split.
        trials: that were tested; 0 = what is measured cannot vary, and has no interval where the ends coincide.
    """
    wilsons = by_trial(score["mean"], trials) if trials else {"mean": score["mean"]}
    if has_width(score["low"], score["high"]):
        same = trials and np.allclose([score[end] for end in ("low", "high")], [wilsons["low"], wilsons["high"]])
        by = wilsons["interval by"] if same else "corrected resampled t"  # one split has Wilson's already
        return {**score, "interval by": score.get("interval by", by)}
    return wilsons


def at_least(score: dict[str, Any], items: float) -> dict[str, Any]:
    """A score whose interval is nowhere narrower than Wilson's of so many independent ``items``, each right or wrong.

    Folds are stratified, so their scores can differ by less than those of new trials would.

    >>> made = at_least({"mean": 0.9, "low": 0.89, "high": 0.91, "interval by": "corrected resampled t"}, 100)
    >>> made["interval by"], round(made["low"], 3), round(made["high"], 3)
    ("corrected resampled t, no narrower than Wilson's by item", 0.826, 0.945)
    """
    if "low" not in score:
        return score
    low, high = wilson(score["mean"] * items, items)
    if score["low"] <= low and high <= score["high"]:
        return score
    ends = {"low": min(low, score["low"]), "high": max(high, score["high"])}
    return {**score, **ends, "interval by": f"{score['interval by']}, no narrower than Wilson's by item"}


def of_folds(run: CrossValidation, trials: int) -> dict[str, Any]:
    """What ``CrossValidation.summary`` gives, each score ``with_width`` and ``at_least`` as wide as its items allow.

    Mean recall counts as many items as classes of equal size would have.
    """
    items = {"accuracy": float(run.items.sum()), "balanced_accuracy": run.equal_items}
    return {
        name: at_least(with_width(part, min(trials, items[name])), items[name]) if isinstance(part, dict) else part
        for name, part in run.summary().items()
    }


def of_splits(scores: ArrayLike, test_to_train: float, trials: float, items: float = 0) -> dict[str, Any]:
    """Mean of the scores of repeated splits with its corrected interval, ``with_width``; of one split, Wilson's.

    Args:
        scores: of any shape, one per split.
        test_to_train: ratio of the sizes of their sides.
        trials: as of :func:`with_width`.
        items: for :func:`at_least`; 0 = what is scored is not right or wrong.
    """
    found = np.asarray(scores, float)
    ends = corrected_interval(found, test_to_train) if found.size > 1 else (float(found.mean()),) * 3
    score = with_width(dict(zip(("mean", "low", "high"), ends, strict=True)), trials)
    return at_least(score, items) if items else score


def by_trial(mean: float, trials: float) -> dict[str, Any]:
    """A share of items right with Wilson's interval, each trial counting once: items of a trial are not independent."""
    low, high = wilson(mean * trials, trials)
    return {"mean": mean, "low": low, "high": high, "interval by": "Wilson, by trial"}


def seated_share(seated: Bool[np.ndarray, " trial"]) -> dict[str, Any]:
    """How many simulated trials seat, and their share with Wilson's interval."""
    good, count = int(seated.sum()), seated.size
    ends = np.round(wilson(good, count), 4).tolist()
    return {"seated": good, "trials": count, "share": good / count, "share_95_percent": ends}


def of_auc(area: float, kinds: Sequence[int]) -> tuple[float, float]:
    """Wilson's interval of an area under the ROC curve, of as many trials as the fewer of the two kinds has."""
    fewer = min(kinds)
    return wilson(area * fewer, fewer)


def drawn(groups: int, seed: int) -> Int[np.ndarray, "draw group"]:
    """How often each group counts, where as many are drawn with replacement."""
    return np.random.default_rng(seed).multinomial(groups, np.full(groups, 1 / groups), RESAMPLES)


def sums(values: Shaped[np.ndarray, "item ..."], groups: NDArray[Any]) -> Float[np.ndarray, "group ..."]:
    """Sums over the items of each group."""
    number = np.unique(groups, return_inverse=True)[1]
    out = np.zeros((number.max() + 1, *values.shape[1:]))
    np.add.at(out, number, values)
    return out


def of_sums(part: Float[np.ndarray, " group"], whole: Float[np.ndarray, " group"]) -> dict[str, Any]:
    """A share of sums over groups, such as trials, with its interval from groups drawn with replacement.

    >>> of_sums(np.array([1.0, 2.0, 3.0]), np.array([4.0, 4.0, 4.0]))["mean"]
    0.5
    """
    many = drawn(len(whole), 0)
    wholes = many @ whole
    used = wholes > 0
    low, high = percentile_interval((many @ part)[used] / wholes[used], len(whole))
    mean = float(part.sum() / whole.sum())
    return with_width({"mean": mean, "low": low, "high": high, "interval by": "groups drawn"}, int((whole > 0).sum()))


def jackknife(
    measure: Callable[[NDArray[Any], NDArray[Any]], Float[np.ndarray, " value"]], one: NDArray[Any], other: NDArray[Any]
) -> Float[np.ndarray, "2 value"]:
    """Low and high end of measures of two sets of trials ``[trial, ...]``, each trial left out once.

    Trials drawn with replacement would repeat some, so that a set resembles itself less than it does.

    >>> def difference(a, b):
    ...     return np.array([a.mean() - b.mean()])
    >>> jackknife(difference, np.arange(4.0), np.arange(4.0)).round(2).tolist()
    [[-2.91], [2.91]]
    """
    without = (
        [measure(np.delete(one, row, 0), other) for row in range(len(one))],
        [measure(one, np.delete(other, row, 0)) for row in range(len(other))],
    )
    variance = sum(np.var(np.array(found), 0) * (len(found) - 1) for found in without)
    half = stats.t.ppf(0.975, min(len(one), len(other)) - 1) * np.sqrt(variance)
    value = measure(one, other)
    return np.stack([value - half, value + half])


def bootstrap(correct: Bool[np.ndarray, " item"], groups: NDArray[Any], seed: int) -> tuple[float, float]:
    """95 % bootstrap of the share of ``correct``, over groups: items of one trial are not independent.

    Where it has no width, as without a mistake, the interval is Wilson's, each group counting once. It draws by a seed
    of its own, :func:`of_sums` always the same: results were made with either.
    """
    number = np.unique(groups, return_inverse=True)[1]
    right, total = np.bincount(number, correct), np.bincount(number)
    draws = np.random.default_rng(seed).integers(0, len(total), (RESAMPLES, len(total)))
    scores = right[draws].sum(1) / total[draws].sum(1)
    low, high = percentile_interval(scores, len(total))
    return (low, high) if has_width(low, high) else wilson(float(np.mean(correct)) * len(total), len(total))
