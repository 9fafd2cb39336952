"""Features of the piecewise linear signal that the primitives describe: shape, timing, relations between axes.

A primitive is a line, so the primitives of an interval give back its signal. It is resampled at equally spaced
moments, so that no column depends on the length of the interval. Only ``levels`` changes when a constant is added to
the wrench; ``together`` and ``order`` do not change either when wrench and thresholds are scaled together.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from rcbht_jax.features.spans import ClippedSpans, ratio
from rcbht_jax.features.word_families import Block, compressed
from rcbht_jax.labels import PRIMITIVE_GROUP, Group

MOMENTS = 120  # samples of the resampled signal
PARTS = (3, 8)  # numbers of equal parts that piecewise statistics describe, coarse and fine
QUANTILES = 11
NEAR = 1e-6  # share of the range or the level below which differences are rounding errors

Values = Float[np.ndarray, "interval axis moment"]
Columns = Float[np.ndarray, "interval axis column"]


@dataclass(frozen=True)
class ResampledSignal:
    """The signal of each interval at MOMENTS equally spaced moments; zeros where an axis has no label."""

    sign: Int[np.ndarray, "interval axis moment"]  # 1 rising, -1 falling, 0 constant
    level: Values  # N or Nm
    slope: Values  # N/s or Nm/s

    @property
    def relative(self) -> Values:
        """Level minus the mean level of the interval, N or Nm."""
        return _centred(self.level)

    @property
    def range(self) -> Float[np.ndarray, "interval axis 1"]:
        """Highest minus lowest level, N or Nm."""
        return np.ptp(self.level, axis=-1)[..., None]


def axis_pairs(axes: Sequence[str]) -> list[str]:
    """Names of all pairs of axes in the order of ``together``, for example ``Fx-Fy``.

    >>> axis_pairs(("Fx", "Fy", "Fz"))
    ['Fx-Fy', 'Fx-Fz', 'Fy-Fz']
    """
    return [f"{first}-{second}" for first, second in itertools.combinations(axes, 2)]


def read_back(words: ClippedSpans, dt: float) -> ResampledSignal:
    """The signal at the middles of MOMENTS equal slots; in a gap the label before it goes on.

    Args:
        words: primitives.
        dt: seconds between samples.
    """
    return read_at(words, (np.arange(MOMENTS) + 0.5) / MOMENTS * words.length[:, None], dt)


def read_at(words: ClippedSpans, moment: Float[np.ndarray, "interval moment"], dt: float) -> ResampledSignal:
    """The signal at ``moment``, increasing samples from the start of each interval."""
    intervals, axes, slots = words.code.shape
    # One search for all lanes: each lane's times are shifted behind those of the lane before.
    far = float(words.length.max(initial=0)) + 2
    lane = np.arange(intervals * axes).reshape(intervals, axes, 1)
    starts = np.where(words.code > 0, words.start, far - 1) + lane * far
    position = np.searchsorted(starts.ravel(), (moment[:, None] + lane * far).ravel(), side="right") - 1
    index = np.maximum(position.reshape(intervals, axes, MOMENTS) - lane * slots, 0)
    middle, avg, slope, vmin, vmax = (
        np.take_along_axis(words.value[name], index, -1) for name in ("middle", "avg", "grad", "vmin", "vmax")
    )
    level = np.clip(avg + slope * ((moment[:, None] - middle) * dt), vmin, vmax)
    flat = np.ptp(level, axis=-1) <= NEAR * np.abs(level).max(-1)
    group = PRIMITIVE_GROUP[np.take_along_axis(words.code, index, -1)]
    rising, falling = (np.isin(group, pair) for pair in ((Group.P, Group.PIMP), (Group.N, Group.NIMP)))
    return ResampledSignal(rising.astype(np.int64) - falling, np.where(flat[..., None], level[..., :1], level), slope)


def _centred(values: Values) -> Values:
    """Values minus their mean over the moments, exactly zero where they are all the same."""
    change = values - values[..., :1]
    return change - change.mean(-1, keepdims=True)


def _means(values: Shaped[np.ndarray, "interval axis moment"], parts: int) -> Float[np.ndarray, "interval axis part"]:
    return np.stack([part.mean(-1) for part in np.array_split(values, parts, axis=-1)], -1)


def piecewise_stats(signal: ResampledSignal) -> Block:
    """Level, slope, activity, range and signs in equal parts of the interval."""
    values, columns = [], []
    for count in PARTS:
        level = _means(signal.relative, count)
        ranges = [np.ptp(part, axis=-1) for part in np.array_split(signal.level, count, axis=-1)]
        described = {
            "level": (compressed(level), "mean level minus the interval's, signed log"),
            "share": (ratio(level, signal.range), "mean level minus the interval's, as a share of its range"),
            "grad": (compressed(_means(signal.slope, count)), "mean slope, signed log"),
            "activity": (compressed(_means(np.abs(signal.slope), count)), "mean steepness, log"),
            "range": (compressed(np.stack(ranges, -1)), "highest minus lowest level, log"),
            "rising": (_means(signal.sign > 0, count), "share of time spent rising"),
            "falling": (_means(signal.sign < 0, count), "share of time spent falling"),
        }
        for what, (value, meaning) in described.items():
            values.append(value)
            columns += [(f"{what}.{k}of{count}", f"{meaning}, in part {k + 1} of {count}") for k in range(count)]
    return np.concatenate(values, -1), columns


def quantiles(signal: ResampledSignal) -> Block:
    """Distribution of levels and slopes over the time of the interval."""
    steps = np.linspace(0, 1, QUANTILES)
    level, slope = (np.moveaxis(np.quantile(x, steps, axis=-1), 0, -1) for x in (signal.relative, signal.slope))
    deviations = np.concatenate([x.std(-1, keepdims=True) for x in (signal.level, signal.slope)], -1)
    values = [compressed(level), ratio(level, signal.range), compressed(slope), compressed(deviations)]
    columns = [
        (f"{what}.{step:.0%}", f"{step:.0%} quantile of the {meaning}")
        for what, meaning in (
            ("level", "level minus the interval's mean, signed log"),
            ("share", "level minus the interval's mean, as a share of its range"),
            ("grad", "slope, signed log"),
        )
        for step in steps
    ]
    columns += [(f"deviation.{x}", f"standard deviation of the {x}, log") for x in ("level", "slope")]
    return np.concatenate(values, -1), columns


def cross_axis(signal: ResampledSignal) -> Block:
    """Joint signs and correlations of two axes, ``[interval, pair, column]``."""
    first, second = np.triu_indices(signal.sign.shape[1], 1)
    signs = {"rising": signal.sign > 0, "falling": signal.sign < 0, "constant": signal.sign == 0}
    values = [(a[:, first] & b[:, second]).mean(-1) for a in signs.values() for b in signs.values()]
    columns = [
        (f"{a}.{b}", f"share of time in which the first is {a} while the second is {b}") for a in signs for b in signs
    ]
    # The root keeps a single snap from deciding the correlation of slopes.
    for name, x in (("level", signal.level), ("slope", np.sign(signal.slope) * np.sqrt(np.abs(signal.slope)))):
        values.append(_correlation(x))
        columns.append((f"correlation.{name}", f"correlation of their {name}s over the interval"))
    return np.stack(values, -1), columns


def _correlation(x: Values) -> Float[np.ndarray, "interval pair"]:
    """Correlation of every pair of axes; 0 where one of them does not change."""
    first, second = np.triu_indices(x.shape[1], 1)
    centred = _centred(x)
    product = centred @ np.swapaxes(centred, 1, 2)
    size = np.sqrt(np.einsum("sii->si", product))
    return np.clip(ratio(product[:, first, second], size[:, first] * size[:, second]), -1, 1)


def timing(signal: ResampledSignal) -> Block:
    """When the signal is highest, steepest, first and last rising or falling, as shares of the interval."""
    highest, lowest = _when(signal.level), _when(-signal.level)
    steepest = [_when(signal.slope), _when(-signal.slope), _when(np.abs(signal.slope))]
    columns = [
        (name, f"when the signal is {meaning}, as a share of the interval")
        for name, meaning in (
            ("highest", "highest"),
            ("lowest", "lowest"),
            ("rise", "rising most steeply"),
            ("fall", "falling most steeply"),
            ("steepest", "steepest"),
        )
    ]
    values = [highest, lowest, *steepest]
    for name, sign in (("rising", 1), ("falling", -1)):
        values += _times(signal.sign == sign)
        columns += [(f"{what}.{name}", f"{what} moment of {name}, as a share") for what in ("mean", "first", "last")]
    level, quarter = signal.relative, signal.range / 4
    above = [
        level > NEAR * quarter,
        signal.level > signal.level[..., :1] + NEAR * quarter,
        level > quarter,
        level < -quarter,
    ]
    values += [part.mean(-1) for part in above]
    columns += [
        ("above.mean", "share of time above the mean level"),
        ("above.first", "share of time above the first level"),
        ("high", "share of time a quarter of the range or more above the mean level"),
        ("low", "share of time a quarter of the range or more below the mean level"),
    ]
    return np.stack(values, -1), columns


def _when(values: Values) -> Float[np.ndarray, "interval axis"]:
    """First moment at which the values are (nearly) highest, as a share of the interval."""
    close = values >= values.max(-1, keepdims=True) - NEAR * np.ptp(values, axis=-1)[..., None]
    return close.argmax(-1) / MOMENTS


def _times(mask: Bool[np.ndarray, "interval axis moment"]) -> list[Float[np.ndarray, "interval axis"]]:
    """Mean, first and last moment at which ``mask`` holds, as shares; a half, one and zero if it never does."""
    moment = (np.arange(MOMENTS) + 0.5) / MOMENTS
    count = mask.sum(-1)
    mean = np.where(count > 0, ratio((mask * moment).sum(-1), count.astype(np.float64)), 0.5)
    return [mean, np.where(mask, moment, 1).min(-1), np.where(mask, moment, 0).max(-1)]


def levels(signal: ResampledSignal) -> Block:
    """Absolute level of each third, highest and lowest; a constant sensor bias changes them."""
    ends = [f(signal.level, axis=-1, keepdims=True) for f in (np.max, np.min)]
    named = [(f"mean.{k}of3", f"mean level in part {k + 1} of 3, signed log") for k in range(3)]
    columns = [*named, ("highest", "highest level, signed log"), ("lowest", "lowest level, signed log")]
    return compressed(np.concatenate([_means(signal.level, 3), *ends], -1)), columns


FAMILIES = {"parts": piecewise_stats, "spread": quantiles, "together": cross_axis, "order": timing, "levels": levels}
