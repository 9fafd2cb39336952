"""95 % intervals that are never of zero width: a score without a mistake says only how rare mistakes are."""

from __future__ import annotations

from typing import Any

from rcbht_jax.learning.metrics import wilson


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
