"""Causal description of every sample: what the wrench and its words did in windows that end there.

A window of ``s`` seconds at sample ``t`` holds the samples ``t - n + 1 ... t`` with ``n = s / dt``; before the record
began nothing is known, so that windows are cut off there. No value depends on a later sample.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.types import LabelTrack

WINDOWS = (0.1, 0.3, 1.0, 3.0)  # s


Signal = Float[np.ndarray, "time axis"]
Table = Float[np.ndarray, "time column"]


def trailing_statistics(signal: Signal, dt: float, windows: Sequence[float] = WINDOWS) -> Table:
    """Value now, and per window mean, deviation, slope, lowest and highest value relative to the mean.

    Args:
        signal: any channels, any units.
        dt: seconds between samples.
        windows: s, increasing.

    Example:
        >>> trailing_statistics(np.arange(4.0)[:, None], 1.0, (2.0,)).round(2).tolist()[2]
        [2.0, 1.5, 0.5, 1.0, -0.5, 0.5]
    """
    columns, level = [signal], signal[:1]
    signal = signal - level  # sums of squares of a large level would lose what varies
    for seconds in windows:
        count = max(2, round(seconds / dt))
        first = np.maximum(np.arange(len(signal)) - count + 1, 0)
        n = (np.arange(len(signal)) - first + 1)[:, None]
        mean, square, moment = _means(signal, first, n)
        spread = np.sqrt(np.maximum(square - mean**2, 0))
        width = (n**2 - 1) / 12  # variance of n consecutive sample numbers
        slope = np.where(n > 1, moment / np.maximum(width, 1e-12), 0) / dt
        low, high = _extremes(signal, count)
        columns += [mean + level, spread, slope, low - mean, high - mean]
    return np.concatenate(columns, 1)


def _means(
    signal: Signal, first: Int[np.ndarray, " time"], n: Int[np.ndarray, "time 1"]
) -> tuple[Signal, Signal, Signal]:
    """Of each window the mean, the mean square and the covariance with the sample number."""
    time = np.arange(len(signal))[:, None]
    sums = [np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, 0)]) for x in (signal, signal**2, signal * time)]
    mean, square, product = ((total[1:] - total[first]) / n for total in sums)
    return mean, square, product - mean * (time + first[:, None]) / 2


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


def running_totals(signal: Signal) -> Table:
    """Largest absolute value so far, and length of the path so far; neither ever decreases.

    >>> running_totals(np.array([[1.0], [-2.0], [0.0]])).tolist()
    [[1.0, 0.0], [2.0, 3.0], [2.0, 5.0]]
    """
    steps = np.abs(np.diff(signal, axis=0, prepend=signal[:1]))
    return np.concatenate([np.maximum.accumulate(np.abs(signal)), np.cumsum(steps, 0)], 1)


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
        slot = used[np.maximum(place, 0)] if len(used) else np.zeros(len(times), int)
        known = (place >= 0) & (len(used) > 0)
        start, end = t0[axis, slot], t1[axis, slot]
        facts = np.stack([label[axis, slot], vmax[axis, slot] - vmin[axis, slot], end - start, times - end], 1)
        columns.append(np.where(known[:, None], facts, 0.0))
    return np.concatenate(columns, 1)
