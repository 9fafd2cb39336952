"""95 % intervals that are never of zero width: a score without a mistake says only how rare mistakes are."""

from __future__ import annotations

from typing import Any

import numpy as np

Z = 1.96


def wilson(good: float, trials: int, z: float = Z) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927); ``good`` may be a fraction: a trial some of whose items are right.

    >>> [round(end, 3) for end in wilson(35, 35)]
    [0.901, 1.0]
    """
    share, spread = good / trials, z * z / trials
    middle = (share + spread / 2) / (1 + spread)
    half = z / (1 + spread) * np.sqrt(share * (1 - share) / trials + spread / (4 * trials))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def rule_of_three(trials: int) -> float:
    """Largest share of trials with a mistake that is compatible, at 95 %, with none seen in so many.

    >>> round(rule_of_three(35), 3)
    0.086
    """
    return min(1.0, 3 / trials)


def with_width(score: dict[str, float], trials: int) -> dict[str, Any]:
    """A score with ``mean``, ``low`` and ``high``; where the ends coincide they are Wilson's, by trial.

    Args:
        score: of repeated folds, or of one split.
        trials: that were tested.
    """
    if score["high"] > score["low"]:
        return {**score, "interval by": "corrected resampled t"}
    return by_trial(score["mean"], trials)


def by_trial(mean: float, trials: int) -> dict[str, Any]:
    """A share of items right with Wilson's interval, each trial counting once: items of a trial are not independent."""
    low, high = wilson(mean * trials, trials)
    return {"mean": mean, "low": low, "high": high, "interval by": "Wilson, by trial"}
