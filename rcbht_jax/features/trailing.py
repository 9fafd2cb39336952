"""Causal description of every sample: what the wrench, its words and beliefs did in windows that end there.

A window of ``s`` seconds at sample ``t`` holds the samples ``t - n + 1 ... t`` with ``n = s / dt``; before the record
began nothing is known, so that windows are cut off there. No value depends on a later sample.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from rcbht_jax._util.values import Copyable
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks

PERIOD = 0.025  # s between decisions of a segmenter; a label stays until the next one
WINDOWS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)  # s, that a segmenter reads
BELIEF_WINDOWS = (0.1, 0.3, 1.0, 3.0)  # s
_REBASE = 2**16  # samples after which totals begin anew, at least: they lose digits as they grow


Signal = Float[np.ndarray, "time axis"]
Table = Float[np.ndarray, "time column"]


def trailing_statistics(signal: Signal, dt: float, windows: Sequence[float]) -> Table:
    """Value now, and per window mean, deviation, slope, lowest and highest value relative to the mean.

    Args:
        signal: any channels, any units.
        dt: seconds between samples.
        windows: s, increasing.

    Example:
        >>> trailing_statistics(np.arange(4.0)[:, None], 1.0, (2.0,)).round(2).tolist()[2]
        [2.0, 1.5, 0.5, 1.0, -0.5, 0.5]
    """
    return TrailingStatistics(dt, windows).push(signal)


class TrailingStatistics:
    """:func:`trailing_statistics` of a stream: pieces of any size give the rows of the whole, bit for bit.

    Args:
        dt: seconds between samples.
        windows: s, increasing.

    Example:
        >>> stream, signal = TrailingStatistics(1.0, (2.0,)), np.arange(9.0)[:, None] ** 2
        >>> pieces = np.concatenate([stream.push(signal[:4]), stream.push(signal[4:])])
        >>> bool((pieces == trailing_statistics(signal, 1.0, (2.0,))).all())
        True
    """

    def __init__(self, dt: float, windows: Sequence[float]) -> None:
        self._dt = dt
        self._counts = [max(2, round(seconds / dt)) for seconds in windows]
        self._period = max(_REBASE, *self._counts, 1)
        self._received, self._origin = 0, 0  # samples; that from which they are numbered
        self._level: Signal | None = None  # the first sample; sums of squares of a large level lose what varies
        self._past: Signal = np.zeros((0, 0))  # as many samples as the longest window reads
        self._totals: list[Signal] = []  # of values, squares and moments, up to each of them

    def push(self, signal: Signal) -> Table:
        """Rows of new samples."""
        if not len(signal):
            return np.zeros((0, signal.shape[1] * (1 + 5 * len(self._counts))))
        # Totals begin anew at fixed samples, so that rows do not depend on the pieces.
        pieces = np.split(signal, range(self._period - self._received % self._period, len(signal), self._period))
        return np.concatenate([self._rows(piece) for piece in pieces])

    def _rows(self, signal: Signal) -> Table:
        """Rows of new samples, before the next one from which totals begin anew."""
        if self._level is None:
            self._level = signal[:1]
            self._past = signal[:0]
            self._totals = [np.zeros_like(signal[:1], np.float64)] * 3
        elif self._received % self._period == 0:
            self._origin = self._received - len(self._past)
            self._totals = [
                np.concatenate([np.zeros_like(part[:1]), np.cumsum(part, 0)])
                for part in self._parts(self._past, self._origin)
            ]
        new = signal - self._level
        number = self._received + np.arange(len(new))
        parts = self._parts(new, self._received)
        totals = [
            np.concatenate([kept[:-1], np.cumsum(np.concatenate([kept[-1:], part]), 0)])
            for kept, part in zip(self._totals, parts, strict=True)
        ]
        before, joined, columns = self._received - len(self._past), np.concatenate([self._past, new]), [signal]
        for count in self._counts:
            first = np.maximum(number - count + 1, 0)
            n = (number - first + 1)[:, None]
            mean, square, product = ((total[-len(new) :] - total[first - before]) / n for total in totals)
            spread = np.sqrt(np.maximum(square - mean**2, 0))
            width = (n**2 - 1) / 12  # variance of n consecutive sample numbers
            moment = product - mean * (number + first - 2 * self._origin)[:, None] / 2
            slope = np.where(n > 1, moment / np.maximum(width, 1e-12), 0) / self._dt
            low, high = _extremes(joined[max(len(self._past) - count + 1, 0) :], count)
            columns += [mean + self._level, spread, slope, low[-len(new) :] - mean, high[-len(new) :] - mean]
        keep = max(self._counts, default=1)
        self._past, self._totals = joined[-keep:], [total[-keep - 1 :] for total in totals]
        self._received += len(new)
        return np.concatenate(columns, 1)

    def _parts(self, values: Signal, first: int) -> tuple[Signal, Signal, Signal]:
        """Values, squares and moments, whose totals are needed; ``first`` is the number of the first sample."""
        number = first - self._origin + np.arange(len(values))
        return values, values**2, values * number[:, None]


def _extremes(signal: Signal, count: int) -> tuple[Signal, Signal]:
    """Lowest and highest value of the last ``count`` samples, by windows that double in length."""
    low, high, width = signal, signal, 1
    while width < count:
        step = min(width, count - width)
        low, high = np.minimum(low, _delayed(low, step)), np.maximum(high, _delayed(high, step))
        width += step
    return low, high


def _delayed(x: Signal, steps: int) -> Signal:
    """The values some samples before; the first one before the record began."""
    return np.concatenate([np.repeat(x[:1], min(steps, len(x)), 0), x[: max(len(x) - steps, 0)]])


class RunningTotals(Copyable):
    """Largest absolute value so far, and length of the path so far; neither ever decreases.

    Pieces of any size give the rows of the whole, bit for bit.

    >>> RunningTotals().push(np.array([[1.0], [-2.0], [0.0]])).tolist()
    [[1.0, 0.0], [2.0, 3.0], [2.0, 5.0]]
    """

    def __init__(self) -> None:
        self._last: Signal | None = None  # sample
        self._largest, self._path = Accumulated(np.maximum), Accumulated(np.add)

    def push(self, signal: Signal) -> Table:
        """Rows of new samples."""
        steps = np.abs(np.diff(signal, axis=0, prepend=signal[:1] if self._last is None else self._last))
        if len(signal):
            self._last = signal[-1:]
        return np.concatenate([self._largest.push(np.abs(signal)), self._path.push(steps)], 1)


class Accumulated:
    """``ufunc.accumulate`` of a stream over time: pieces of any size give the rows of the whole, bit for bit.

    Args:
        ufunc: of NumPy, such as ``np.add``.

    Example:
        >>> total = Accumulated(np.add)
        >>> [total.push(np.full((2, 1), value))[:, 0].tolist() for value in (1.0, 10.0)]
        [[1.0, 2.0], [12.0, 22.0]]
    """

    def __init__(self, ufunc: np.ufunc) -> None:
        self._ufunc = ufunc
        self._last: Signal | None = None

    def push(self, values: Signal) -> Signal:
        """Rows of new values."""
        joined = values if self._last is None else np.concatenate([self._last, values])
        rows = self._ufunc.accumulate(joined)
        self._last = rows[-1:] if len(rows) else None
        return rows[len(rows) - len(values) :]


def with_norms(wrench: Signal, units: Sequence[str]) -> Table:
    """The axes, and the norm of each set of two or more axes of the same unit.

    >>> with_norms(np.array([[3.0, 4.0, 1.0]]), ("N", "N", "Nm")).tolist()
    [[3.0, 4.0, 1.0, 5.0]]
    """
    sets = [[i for i, other in enumerate(units) if other == unit] for unit in dict.fromkeys(units)]
    norms = [np.linalg.norm(wrench[:, axes], axis=1, keepdims=True) for axes in sets if len(axes) > 1]
    return np.concatenate([wrench, *norms], 1)


def latest_words(track: LabelTrack, times: Int[np.ndarray, " moment"]) -> Float[np.ndarray, "moment column"]:
    """The newest published word of each axis at each moment: label, change of value, length and age.

    A word counts from the sample of its publication, so that nothing is known before its time. Zeros before the first.

    Args:
        track: labels of one layer and recording, every array ``[axis, slot]``.
        times: samples received at the moments.
    """
    label, t0, t1, emit, vmax, vmin = (
        np.asarray(value) for value in (track.label, track.t0, track.t1, track.emit, track.vmax, track.vmin)
    )
    columns = []
    for axis in range(label.shape[0]):
        used = np.flatnonzero(label[axis] > 0)
        place = np.searchsorted(emit[axis, used], times, side="right") - 1
        slot = used[place] if len(used) else place
        start, end = t0[axis, slot], t1[axis, slot]
        facts = np.stack([label[axis, slot], vmax[axis, slot] - vmin[axis, slot], end - start, times - end], 1)
        columns.append(np.where(place[:, None] >= 0, facts, 0.0))
    return np.concatenate(columns, 1)


class LatestWords(Copyable):
    """:func:`latest_words` of a stream, of all layers.

    Args:
        axes: number of them.
    """

    def __init__(self, axes: int) -> None:
        self._newest = np.zeros((len(LAYERS), axes, 4))  # label, change of value, first sample, end

    def take(self, tracks: LabelTracks) -> None:
        """Words that were published, every array ``[axis, slot]``, the newest in the last slot."""
        for layer, newest in zip(LAYERS, self._newest, strict=True):
            track = getattr(tracks, layer)
            for axis, slot in zip(*np.nonzero(np.asarray(track.label) > 0), strict=True):
                change = track.vmax[axis, slot] - track.vmin[axis, slot]
                newest[axis] = track.label[axis, slot], change, track.t0[axis, slot], track.t1[axis, slot]

    def row(self, received: int) -> Float[np.ndarray, "1 column"]:
        """The columns of all layers after so many samples."""
        label, change, start, end = np.moveaxis(self._newest, -1, 0)
        facts = np.stack([label, change, end - start, received - end], -1)
        return np.where(label[..., None] > 0, facts, 0.0).reshape(1, -1)


class Course(Copyable):
    """Beliefs of the first ensemble until each decision, as the second one reads them; in pieces of any size."""

    def __init__(self) -> None:
        self._statistics = TrailingStatistics(PERIOD, BELIEF_WINDOWS)
        self._largest, self._total = Accumulated(np.maximum), Accumulated(np.add)

    def push(self, belief: Float[np.ndarray, "moment class"]) -> Float[np.ndarray, "moment column"]:
        """Columns of new beliefs."""
        largest, total = self._largest.push(belief), self._total.push(belief)
        return np.concatenate([belief, self._statistics.push(belief), largest, total * PERIOD], 1)


def columns_of(units: Sequence[str], classes: int, words: bool) -> tuple[int, int]:
    """Columns that the first and the second ensemble of a causal segmenter read.

    >>> columns_of(("N",), 2, words=False)
    (43, 91)
    """
    channels = len(with_norms(np.zeros((1, len(units))), units)[0])
    first = channels * (1 + 5 * len(WINDOWS) + 2) + words * len(LAYERS) * len(units) * 4
    return first, first + classes * (4 + 5 * len(BELIEF_WINDOWS))


def decision_period(dt: float) -> int:
    """Samples between two decisions."""
    return max(1, round(PERIOD / dt))
