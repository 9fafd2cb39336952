"""Features of the piecewise linear signal that the primitives describe: shape, timing, relations between axes.

A primitive is a line, so the primitives of an interval give back its signal. It is resampled at equally spaced
moments, so that no column depends on the length of the interval. Only ``levels`` changes when a constant is added to
the wrench; ``together`` and ``order`` do not change either when wrench and thresholds are scaled together.

Each family is written once, for NumPy (whole intervals) and for JAX (streams): it takes a signal of either kind and
returns values in the same precision, ``[..., lane, column]``; a lane is an axis or a pair of axes. COLUMNS has the
(suffix, meaning) of each column.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Num

from rcbht_jax._util.compiling import full_precision
from rcbht_jax.features.spans import ClippedSpans, ratio
from rcbht_jax.features.word_families import compressed
from rcbht_jax.labels import PRIMITIVE_GROUP, Group
from rcbht_jax.types import Array

MOMENTS = 120  # samples of the resampled signal
PARTS = (3, 8)  # numbers of equal parts that piecewise statistics describe, coarse and fine
QUANTILES = 11
# Of each label code: 1 rising, -1 falling, 0 constant or no label at all.
SIGNS = 1 * np.isin(PRIMITIVE_GROUP, (Group.P, Group.PIMP)) - np.isin(PRIMITIVE_GROUP, (Group.N, Group.NIMP))
NEAR = 1e-6  # share of the range or the level below which differences are rounding errors

Values = Float[Array, "*interval axis moment"]
Columns = Float[Array, "*interval axis _"]


@dataclass(frozen=True)
class ResampledSignal:
    """The signal at MOMENTS equally spaced moments, NumPy or JAX; zeros where an axis has no label."""

    sign: Num[Array, "*interval axis moment"]  # 1 rising, -1 falling, 0 constant
    level: Values  # N or Nm
    slope: Values  # N/s or Nm/s

    @classmethod
    def of(cls, sign: Num[Array, "*interval axis moment"], level: Values, slope: Values) -> ResampledSignal:
        """A level that changes by no more than rounding errors is made constant."""
        top, bottom = level.max(-1, keepdims=True), level.min(-1, keepdims=True)
        flat = top - bottom <= NEAR * abs(level).max(-1, keepdims=True)
        return cls(sign, level.__array_namespace__().where(flat, level[..., :1], level), slope)

    @property
    def xp(self) -> Any:
        """The module of the arrays, ``numpy`` or ``jax.numpy``."""
        return self.level.__array_namespace__()

    @cached_property
    def relative(self) -> Values:
        """Level minus the mean level of the interval, N or Nm."""
        return _centred(self.level)

    @cached_property
    def range(self) -> Float[Array, "*interval axis 1"]:
        """Highest minus lowest level, N or Nm."""
        return self.level.max(-1, keepdims=True) - self.level.min(-1, keepdims=True)


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
    return ResampledSignal.of(SIGNS[np.take_along_axis(words.code, index, -1)], level, slope)


def _centred(values: Values) -> Values:
    """Values minus their mean over the moments, exactly zero where they are all the same."""
    change = values - values[..., :1]
    return change - change.mean(-1, keepdims=True)


def _split(values: Float[Array, "*lanes moment"], count: int) -> Float[Array, "*lanes {count} _"]:
    """The moments of each part; MOMENTS is a multiple of every number of parts."""
    return values.reshape(*values.shape[:-1], count, MOMENTS // count)


def piecewise_stats(x: ResampledSignal) -> Columns:
    """Level, slope, activity, range and signs in equal parts of the interval."""
    rising, falling = (mask.astype(x.level.dtype) for mask in (x.sign > 0, x.sign < 0))
    signals = x.xp.stack([x.relative, x.slope, abs(x.slope), rising, falling])
    blocks = []
    for count in PARTS:
        level, slope, activity, rising, falling = _split(signals, count).mean(-1)
        ranges = x.xp.ptp(_split(x.level, count), axis=-1)
        logs = map(compressed, (slope, activity, ranges))
        blocks += [compressed(level), ratio(level, x.range), *logs, rising, falling]
    return x.xp.concatenate(blocks, axis=-1)


def quantiles(x: ResampledSignal) -> Columns:
    """Distribution of levels and slopes over the time of the interval."""
    level, slope, deviation = _distribution(x)
    values = [compressed(level), ratio(level, x.range), compressed(slope), compressed(deviation)]
    return x.xp.concatenate(values, axis=-1)


def _distribution(x: ResampledSignal) -> tuple[Columns, Columns, Columns]:
    """Quantiles of relative level and slope, and standard deviations of both.

    NumPy and JAX round these differently, and trained models rest on the digits of each.
    """
    xp, steps = x.xp, np.linspace(0, 1, QUANTILES)
    if xp is np:
        level, slope = (np.moveaxis(np.quantile(v, steps, axis=-1), 0, -1) for v in (x.relative, x.slope))
        return level, slope, np.stack([x.level.std(-1), x.slope.std(-1)], -1)
    place = steps * (MOMENTS - 1)
    below = np.floor(place).astype(np.int32)
    ordered = xp.sort(xp.stack([x.relative, x.slope]), axis=-1)
    low, high = ordered[..., below], ordered[..., np.minimum(below + 1, MOMENTS - 1)]
    level, slope = low + xp.asarray(place - below, low.dtype)[None, None] * (high - low)
    both = xp.stack([x.relative, _centred(x.slope)], axis=1)
    return level, slope, xp.sqrt((both * both).mean(-1))


def cross_axis(x: ResampledSignal) -> Float[Array, "*interval pair column"]:
    """Joint signs and correlations of two axes; a correlation is 0 where one of them does not change."""
    xp, (first, second) = x.xp, np.triu_indices(x.sign.shape[-2], 1)
    signs = xp.stack([x.sign > 0, x.sign < 0, x.sign == 0], axis=-3).astype(x.level.dtype)
    # The root keeps a single snap from deciding the correlation of slopes.
    root = xp.sign(x.slope) * xp.sqrt(abs(x.slope))
    both = xp.stack([x.relative, _centred(root)], axis=-3)
    with full_precision():
        shares = xp.einsum("...aim,...bjm->...ijab", signs, signs)[..., first, second, :, :] / MOMENTS
        product = both @ xp.swapaxes(both, -1, -2)
    size = xp.sqrt(xp.diagonal(product, axis1=-2, axis2=-1))
    correlation = xp.clip(ratio(product[..., first, second], size[..., first] * size[..., second]), -1, 1)
    return xp.concatenate([shares.reshape(*shares.shape[:-2], 9), xp.swapaxes(correlation, -1, -2)], axis=-1)


def timing(x: ResampledSignal) -> Columns:
    """When the signal is highest, steepest, first and last rising or falling, as shares of the interval."""
    xp, dtype = x.xp, x.level.dtype
    extremes = xp.stack([x.level, -x.level, x.slope, -x.slope, abs(x.slope)])
    top = extremes.max(-1, keepdims=True)
    close = extremes >= top - NEAR * (top - extremes.min(-1, keepdims=True))
    number = xp.arange(MOMENTS, dtype=dtype)
    when = xp.where(close, xp.broadcast_to(number, close.shape), MOMENTS).min(-1) / MOMENTS
    mask = xp.stack([x.sign > 0, x.sign < 0])
    moment = xp.broadcast_to((number + 0.5) / MOMENTS, mask.shape)
    mean = ratio(xp.where(mask, moment, 0).sum(-1), mask.sum(-1).astype(dtype))
    mean = xp.where(mask.any(-1), mean, 0.5)
    first, last = xp.where(mask, moment, 1).min(-1), xp.where(mask, moment, 0).max(-1)
    times = xp.stack([mean, first, last], axis=1)
    level, quarter = x.relative, x.range / 4
    rise = x.level > x.level[..., :1] + NEAR * quarter
    shares = xp.stack([level > NEAR * quarter, rise, level > quarter, level < -quarter]).astype(dtype).mean(-1)
    return xp.moveaxis(xp.concatenate([when, times.reshape(6, *mean.shape[1:]), shares]), 0, -1)


def levels(x: ResampledSignal) -> Columns:
    """Absolute level of each third, highest and lowest; a constant sensor bias changes them."""
    ends = [x.level.max(-1, keepdims=True), x.level.min(-1, keepdims=True)]
    return compressed(x.xp.concatenate([_split(x.level, 3).mean(-1), *ends], axis=-1))


FAMILIES = {"parts": piecewise_stats, "spread": quantiles, "together": cross_axis, "order": timing, "levels": levels}

_SIGNS = ("rising", "falling", "constant")
COLUMNS = {
    "parts": [
        (f"{what}.{k}of{count}", f"{meaning}, in part {k + 1} of {count}")
        for count in PARTS
        for what, meaning in (
            ("level", "mean level minus the interval's, signed log"),
            ("share", "mean level minus the interval's, as a share of its range"),
            ("grad", "mean slope, signed log"),
            ("activity", "mean steepness, log"),
            ("range", "highest minus lowest level, log"),
            ("rising", "share of time spent rising"),
            ("falling", "share of time spent falling"),
        )
        for k in range(count)
    ],
    "spread": [
        *(
            (f"{what}.{step:.0%}", f"{step:.0%} quantile of the {meaning}")
            for what, meaning in (
                ("level", "level minus the interval's mean, signed log"),
                ("share", "level minus the interval's mean, as a share of its range"),
                ("grad", "slope, signed log"),
            )
            for step in np.linspace(0, 1, QUANTILES)
        ),
        *((f"deviation.{x}", f"standard deviation of the {x}, log") for x in ("level", "slope")),
    ],
    "together": [
        *(
            (f"{a}.{b}", f"share of time in which the first is {a} while the second is {b}")
            for a, b in itertools.product(_SIGNS, repeat=2)
        ),
        *((f"correlation.{x}", f"correlation of their {x}s over the interval") for x in ("level", "slope")),
    ],
    "order": [
        *(
            (name, f"when the signal is {meaning}, as a share of the interval")
            for name, meaning in (
                ("highest", "highest"),
                ("lowest", "lowest"),
                ("rise", "rising most steeply"),
                ("fall", "falling most steeply"),
                ("steepest", "steepest"),
            )
        ),
        *(
            (f"{what}.{name}", f"{what} moment of {name}, as a share")
            for name in _SIGNS[:2]
            for what in ("mean", "first", "last")
        ),
        ("above.mean", "share of time above the mean level"),
        ("above.first", "share of time above the first level"),
        ("high", "share of time a quarter of the range or more above the mean level"),
        ("low", "share of time a quarter of the range or more below the mean level"),
    ],
    "levels": [
        *((f"mean.{k}of3", f"mean level in part {k + 1} of 3, signed log") for k in range(3)),
        ("highest", "highest level, signed log"),
        ("lowest", "lowest level, signed log"),
    ],
}
