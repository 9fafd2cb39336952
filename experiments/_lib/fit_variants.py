"""The fit rule's breaks in plain NumPy, and two changes: breaks that axes share, a tolerance that tracks noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from experiments._lib.arrays import Floats, Ints
from experiments._lib.word_stability import Words, named
from rcbht_jax.encoding.fit import FitConfig

Track = Literal["none", "at rest", "median"]
MEMORY = 1.0  # s, over which noise is averaged
_SECOND_DIFFERENCE = 6.0  # variance of a second difference of white noise of variance 1
_NORMAL_MAD = 0.6745  # median of |x| of a standard normal variable
_REST = 3  # samples of a run whose slope decides whether it rests


class SumsOfAxes:
    """As :class:`piecewise.Sums`, of several axes: sums of which the line through any span of any axis follows."""

    def __init__(self, y: Float[np.ndarray, "time axis"]) -> None:
        y = y - y.mean(axis=0)
        time = np.arange(len(y))[:, None]
        self._sums = [np.concatenate([np.zeros((1, y.shape[1])), part.cumsum(0)]) for part in (y, y * y, time * y)]

    def line(self, start: Ints, stop: Ints, axis: Ints) -> tuple[Floats, Floats]:
        """Slope per sample, and squared residual, of the line through each span; a single sample has neither."""
        total, square, moment = (part[stop, axis] - part[start, axis] for part in self._sums)
        n = stop - start
        moment = moment - (start + stop - 1) / 2 * total
        spread = np.where(n > 1, n * (n * n - 1.0) / 12, np.inf)
        return moment / spread, np.maximum(square - total * total / np.maximum(n, 1) - moment * moment / spread, 0)


@dataclass(frozen=True)
class Variant:
    """A change to the fit rule."""

    shared: float = 0.0  # one decision for all axes, at so many thresholds of one axis; 0 = none
    track: Track = "none"  # where noise is measured while the stream runs
    wider: float = 1.0  # factor on the given tolerance
    factor: float = 2.0  # on its deviation: the default's, 20 variances by 5 samples of evidence


def breaks(
    y: Float[np.ndarray, "time axis"], config: FitConfig, tolerance: Floats, small: Floats, variant: Variant
) -> tuple[list[list[int]], Floats]:
    """First samples of the runs of every axis, and the tolerances at the end.

    ``tolerance`` is the least one where noise is tracked; a run rests below the ``small`` gradient limit of its axis.
    """
    sums, axes = SumsOfAxes(y), np.arange(y.shape[1])
    start, found = np.zeros(len(axes), np.int64), [[0] for _ in axes]
    tolerance = variant.wider * tolerance
    noise, now = Noise(y, config, variant), tolerance
    for begin in range(0, len(y), config.window):
        end = min(begin + config.window, len(y))
        places = np.arange(max(begin - config.kept, 0), end - 1)[:, None]
        if len(places):
            saved = _saved(sums, start, places, end, axes) / now**2
            if variant.shared:
                saved = np.broadcast_to(np.where((saved < 0).any(1), -1, saved.sum(1))[:, None], saved.shape)
            best = saved.argmax(0)
            for axis in np.flatnonzero(saved[best, axes] > config.needed * (variant.shared or 1)).tolist():
                start[axis] = places[best[axis], 0]
                found[axis].append(int(start[axis]))
        if variant.track != "none":
            slope = np.abs(sums.line(start, np.full_like(start, end), axes)[0])
            n = end - start
            rests = (slope / config.dt < small) | (slope**2 * (n * n - 1.0) / 12 <= now**2)
            now = np.maximum(tolerance, variant.factor * noise.after(begin, end, rests & (n >= _REST)))
    return found, now


def _saved(sums: SumsOfAxes, start: Ints, places: Ints, end: int, axes: Ints) -> Floats:
    """Squared residual that a break at each place saves ``[place, axis]``, -1 where none is allowed."""
    allowed = (places >= start + 2) & (places <= end - 2)
    first = np.minimum(start, places)
    middle, last = np.broadcast_to(places, first.shape), np.full(first.shape, end)
    apart = sums.line(first, middle, axes)[1] + sums.line(middle, last, axes)[1]
    return np.where(allowed, sums.line(first, last, axes)[1] - apart, -1)


class Noise:
    """Deviation of the noise of every axis, from second differences: of the time at rest, or of the last second."""

    def __init__(self, y: Float[np.ndarray, "time axis"], config: FitConfig, variant: Variant) -> None:
        self._bends = np.zeros_like(y)
        self._bends[2:] = np.diff(y, n=2, axis=0)
        self._dt, self._track = config.dt, variant.track
        self._mean, self._weight = np.zeros(y.shape[1]), np.zeros(y.shape[1])

    def after(self, begin: int, end: int, rests: NDArray[np.bool_]) -> Floats:
        """The deviation known at ``end``, after a window in which some axes rested; 0 where nothing is known."""
        if self._track == "median":
            latest = self._bends[max(end - round(MEMORY / self._dt), 2) : end]
            return np.median(np.abs(latest), axis=0) / (_NORMAL_MAD * _SECOND_DIFFERENCE**0.5) if len(latest) else 0
        share = 1 - np.exp(-(end - begin) * self._dt / MEMORY)
        new = (self._bends[max(begin, 2) : end] ** 2).sum(0) / _SECOND_DIFFERENCE / (end - begin)
        self._mean = self._mean + np.where(rests, share * (new - self._mean), 0)
        self._weight = self._weight + np.where(rests, share * (1 - self._weight), 0)
        return np.sqrt(self._mean / np.maximum(self._weight, 1e-12))


def words_of(
    y: Float[np.ndarray, "time axis"], found: list[list[int]], dt: float, limits: Floats, tolerance: Floats
) -> list[Words]:
    """Words of every axis, named as the fit rule names its runs (impulses apart)."""
    sums, out = SumsOfAxes(y), []
    for axis, starts in enumerate(found):
        start = np.array(starts)
        stop = np.append(start[1:], len(y))
        slope, _ = sums.line(start, stop, np.full_like(start, axis))
        out.append(named(slope, start, stop, dt, limits[axis], tolerance[axis] ** 2))
    return out
