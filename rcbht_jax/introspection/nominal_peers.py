"""Simpler monitors with the interface of :class:`~rcbht_jax.introspection.nominal.NominalMonitor`, to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.nominal import Monitor, NominalMonitor

with needs_extra("learn"):
    from sklearn.ensemble import IsolationForest

LEAST_WIDTH = 0.1  # of the mean width of a channel's band


@dataclass(frozen=True)
class Band:
    """What is usual at each moment."""

    middle: Float[np.ndarray, "moment channel"]
    half: Float[np.ndarray, "moment channel"]  # half of the width


@dataclass(kw_only=True, eq=False, repr=False)
class QuantileBand(Monitor):
    """Band between two quantiles of the nominal values at each moment; the score is how far a channel is outside.

    The score is the distance from the middle of the band in halves of its width, largest over the channels: 1 is on
    the edge. After the longest nominal recording the band stays as it ended.

    Args:
        share: of nominal values inside the band.
        normal: width from mean and standard deviation in place of quantiles: the largest z-score; ``share`` is not
            used, and 1 is one standard deviation.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> band = QuantileBand(rate=20).fit(rng.normal(size=(40, 60, 2)))
        >>> band.detect(rng.normal(size=(60, 2))), band.detect(rng.normal(size=(60, 2)) + 9)
        (inf, 0.05)
    """

    memory: Any = 0.05
    share: Any = 0.9
    normal: Any = False

    def _learn(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> Band:
        if not 0 < self.share <= 1:
            raise InputError(f"share is {self.share}; expected a number above 0 and at most 1.")
        time = max(len(part) for part in parts)
        held = np.stack([part[np.minimum(np.arange(time), len(part) - 1)] for part in parts])
        if self.normal:
            middle, half = held.mean(0), held.std(0)
        else:
            low, high = np.quantile(held, [(1 - self.share) / 2, (1 + self.share) / 2], axis=0)
            middle, half = (low + high) / 2, (high - low) / 2
        least = LEAST_WIDTH * half.mean(0)
        return Band(middle, np.maximum(half, np.where(least > 0, least, 1.0)))

    def _score(
        self, model: Band, described: Float[np.ndarray, "time channel kind"], time: Int[np.ndarray, " time"]
    ) -> Float[np.ndarray, " time"]:
        at = np.minimum(time, len(model.middle) - 1)
        return (np.abs(described[..., 0] - model.middle[at]) / model.half[at]).max(1)


@dataclass(kw_only=True, eq=False, repr=False)
class IsolationForestMonitor(NominalMonitor):
    """scikit-learn's isolation forest on the features of the nominal monitor and the elapsed time.

    The parameters ``slack``, ``drift`` and ``neighbours`` are not used.

    Args:
        trees: of the forest.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> forest = IsolationForestMonitor(rate=20, trees=20).fit(rng.normal(size=(20, 40, 2)))
        >>> jump = np.repeat([0, 8], 20)[:, None] + rng.normal(size=(40, 2))
        >>> bool(forest.scores(jump).argmax() > 20)
        True
    """

    trees: Any = 100

    def _learn(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> Any:
        first = self._count(self.baseline)
        rows = []
        for part in parts:
            time = np.arange(len(part))
            rows.append(_table(self._describe(part, part[:first], part[:0], time), time))
        return IsolationForest(n_estimators=int(self.trees), random_state=self.random_state).fit(np.concatenate(rows))

    def _score(
        self, model: Any, described: Float[np.ndarray, "time channel kind"], time: Int[np.ndarray, " time"]
    ) -> Float[np.ndarray, " time"]:
        return -model.score_samples(_table(described, time)) if len(time) else np.zeros(0)


def _table(
    described: Float[np.ndarray, "time channel kind"], time: Int[np.ndarray, " time"]
) -> Float[np.ndarray, "time feature"]:
    """A row per moment: all features, and the elapsed time."""
    return np.concatenate([described.reshape(len(time), -1), time[:, None]], 1)
