"""Simpler monitors with the interface of :class:`~rcbht_jax.introspection.nominal.NominalMonitor`, to compare with."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.neighbours import of_one_length
from rcbht_jax.introspection.nominal import Described, Monitor, NominalMonitor, Scores, Times

with needs_extra("learn"):
    from sklearn.ensemble import IsolationForest
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, WhiteKernel

LEAST_WIDTH = 0.1  # of the mean width of a channel's band


@dataclass(frozen=True)
class Band:
    """Usual range of each channel at each moment."""

    middle: Float[np.ndarray, "moment channel"]
    half: Float[np.ndarray, "moment channel"]  # half of the width


class _BandMonitor(Monitor):
    """Scores by the distance from the middle of a band."""

    def _score(self, model: Band, described: Described, time: Times) -> Scores:
        at = np.minimum(time, len(model.middle) - 1)
        return (np.abs(described[..., 0] - model.middle[at]) / model.half[at]).max(1)


@dataclass(kw_only=True, eq=False, repr=False)
class QuantileBand(_BandMonitor):
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
        held = of_one_length(parts)
        if self.normal:
            middle, half = held.mean(0), held.std(0)
        else:
            low, high = np.quantile(held, [(1 - self.share) / 2, (1 + self.share) / 2], axis=0)
            middle, half = (low + high) / 2, (high - low) / 2
        least = LEAST_WIDTH * half.mean(0)
        return Band(middle, np.maximum(half, np.where(least > 0, least, 1.0)))


@dataclass(kw_only=True, eq=False, repr=False)
class GaussianProcessBand(_BandMonitor):
    """Band of a Gaussian process over time, channel by channel; the score is how far a channel is from its mean.

    The score is the distance from the mean in standard deviations of a new value, largest over the channels. Kernel: a
    squared exponential and noise, whose scales maximise the marginal likelihood (scikit-learn's
    ``GaussianProcessRegressor``). It learns from moments that are drawn at random from the nominal recordings, since
    its effort grows with the cube of their number. After the longest nominal recording the band stays as it ended.

    Args:
        points: moments to learn from.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> band = GaussianProcessBand(rate=20, points=60).fit(rng.normal(size=(10, 60, 1)))
        >>> jump = np.repeat([0, 9], 30)[:, None] + rng.normal(size=(60, 1))
        >>> bool(band.scores(jump).argmax() >= 30)
        True
    """

    memory: Any = 0.05
    points: Any = 150

    def _learn(self, parts: list[NDArray[np.float64]], groups: NDArray[np.int64]) -> Band:
        if self.points < 2:
            raise InputError(f"points is {self.points}; expected two or more.")
        values = np.concatenate(parts)
        time = np.concatenate([np.arange(len(part)) for part in parts])
        rng = np.random.default_rng(self.random_state)
        drawn = rng.choice(len(time), min(int(self.points), len(time)), replace=False)
        moments = np.arange(time.max() + 1)[:, None]
        half = moments[-1, 0] / 2 + 0.5  # time between -1 and 1, so that one range of scales fits all skills
        found = []
        for channel in values.T:
            process = GaussianProcessRegressor(
                RBF(0.3, (0.01, 10.0)) + WhiteKernel(0.1, (1e-4, 10.0)), normalize_y=True
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)  # a scale at the end of its range
                process.fit(time[drawn, None] / half - 1, channel[drawn])
            found.append(process.predict(moments / half - 1, return_std=True))
        middle, width = (np.stack(part, 1) for part in zip(*found, strict=True))
        return Band(middle, np.where(width > 0, width, 1.0))


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
        rows = [_table(described, np.arange(len(described))) for described in self._described(parts)]
        return IsolationForest(n_estimators=int(self.trees), random_state=self.random_state).fit(np.concatenate(rows))

    def _score(self, model: Any, described: Described, time: Times) -> Scores:
        return -model.score_samples(_table(described, time))


def _table(described: Described, time: Times) -> Float[np.ndarray, "time feature"]:
    """A row per moment: all features, and the elapsed time."""
    return np.concatenate([described.reshape(len(time), -1), time[:, None]], 1)
