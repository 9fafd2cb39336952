"""The families of :mod:`rcbht_jax.features.signal_families` while the interval grows, in constant time and memory.

The signal is sampled at every ``stride``-th sample since the interval began, at most READINGS times; when the interval
outgrows them every other reading is dropped and the stride doubles. Each reading is of the line that covers its sample,
whenever that line was published, so the readings depend on the samples so far and on nothing else. The equally spaced
moments of the host's families are then taken from the nearest readings, at most 1/256 of the interval away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.features.signal_families import FAMILIES, MOMENTS, NEAR, PARTS, QUANTILES
from rcbht_jax.features.word_families import UNIT
from rcbht_jax.labels import AXES, PRIMITIVE_GROUP, Group
from rcbht_jax.types import Array, LabelTrack

READINGS = 256
_DOUBLINGS = 22  # of the stride at most: more than sample numbers can count
_FINE = 1024  # steps per stride to which the length of a long interval is rounded, so that products stay in 32 bits
_RISING, _FALLING = (np.isin(PRIMITIVE_GROUP, pair) for pair in ((Group.P, Group.PIMP), (Group.N, Group.NIMP)))
_SIGNS = _RISING.astype(np.float32) - _FALLING  # [label code], the first for no label at all
_FIRST, _SECOND = np.triu_indices(len(AXES), 1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DecimatedSignal:
    """The signal at samples ``begin + k stride``, and the latest line, which is continued."""

    stride: Array  # int32 [], samples
    value: Array  # float32 [3, axis, reading]: 1 rising, -1 falling, 0 constant; level; slope
    span: Array  # int32 [2, axis], first sample of the latest line and one past its last; 0 = no line yet
    line: Array  # float32 [5, axis], sign, vmax, vmin, avg and slope of it


def empty() -> DecimatedSignal:
    """Nothing read yet."""
    axes = len(AXES)
    return DecimatedSignal(
        stride=jnp.int32(1),
        value=jnp.zeros((3, axes, READINGS), jnp.float32),
        span=jnp.zeros((2, axes), jnp.int32),
        line=jnp.zeros((5, axes), jnp.float32),
    )


def stride_of(samples: Array) -> Array:
    """Samples between the readings of an interval of so many samples, int32 ``[]``."""
    full = jnp.asarray(READINGS << np.arange(_DOUBLINGS), jnp.int32)
    return jnp.left_shift(jnp.int32(1), jnp.sum(samples > full, dtype=jnp.int32))


def grow(readings: DecimatedSignal, dt: float, begin: Array, now: Array, window: int) -> DecimatedSignal:
    """Drop every other reading, as often as it takes to reach to sample ``now``; ``window`` = most samples at once.

    Readings that come into reach lie after the beginning of the latest line, which is continued.
    """
    stride, value = stride_of(now - begin), readings.value
    for halving in range(max(1, (2 * window - 1) // READINGS)):
        halved = jnp.concatenate([value[..., ::2], jnp.zeros_like(value[..., ::2])], axis=-1)
        value = jnp.where(stride > readings.stride << halving, halved, value)
    grown = replace(readings, stride=stride)
    latest = _filled(value, dt, _samples(grown, begin), readings.span, readings.line, readings.span[1] > 0, False)
    return replace(grown, value=latest)


def _samples(readings: DecimatedSignal, begin: Array) -> Array:
    """Where the readings are, int32 ``[reading]``."""
    return begin + jnp.arange(READINGS, dtype=jnp.int32) * readings.stride


def extend(readings: DecimatedSignal, dt: float, begin: Array, words: LabelTrack) -> DecimatedSignal:
    """Read primitives ``[axis, slot]``, in time order, of an interval that began at ``begin`` and has grown to them."""
    at, value, span, line = _samples(readings, begin), readings.value, readings.span, readings.line
    spans = jnp.stack([words.t0, words.t1])
    signs = jnp.asarray(_SIGNS)[words.label.astype(jnp.int32)]
    lines = jnp.stack([signs, words.vmax, words.vmin, words.avg, words.grad])
    for slot in range(words.label.shape[-1]):
        new_span, new_line = spans[..., slot], lines[..., slot]
        used = (words.label[:, slot] > 0) & (new_span[1] > begin)
        value = _filled(value, dt, at, new_span, new_line, used, span[1] == 0)
        span, line = jnp.where(used[None], new_span, span), jnp.where(used[None], new_line, line)
    return DecimatedSignal(readings.stride, value, span, line)


def _filled(value: Array, dt: float, at: Array, span: Array, line: Array, used: Array, first: Array | bool) -> Array:
    """Readings with one line per axis added, from its beginning on; the ``first`` line reaches back to the start."""
    sign, vmax, vmin, avg, slope = line[:, :, None]
    # Twice the distance from the middle of the line, which may lie between two samples.
    double = (2 * at[None] - (span[0] + span[1])[:, None]).astype(jnp.float32)
    level = jnp.clip(avg + slope * (double * (dt / 2)), vmin, vmax)
    covers = used[:, None] & ((at[None] >= span[0][:, None]) | jnp.broadcast_to(first, used.shape)[:, None])
    new = jnp.stack([jnp.broadcast_to(x, level.shape) for x in (sign, level, slope)])
    return jnp.where(covers[None], new, value)


def moments(samples: Array, stride: Array) -> Array:
    """The reading nearest to each of the host's moments ``[moment]``, none beyond the last sample."""
    unit = jnp.maximum(stride // _FINE, 1)
    length, step = samples // unit, stride // unit
    halves = jnp.asarray(2 * np.arange(MOMENTS) + 1, jnp.int32)
    nearest = (halves * length + MOMENTS * step) // (2 * MOMENTS * step)
    return jnp.minimum(nearest, jnp.maximum(samples - 1, 0) // stride)


def width(families: tuple[str, ...]) -> int:
    """Columns that :func:`describe` makes of these families."""
    parts, spread = 7 * sum(PARTS), 3 * QUANTILES + 2
    each = {"parts": parts, "spread": spread, "together": 0, "order": 15, "levels": 5}
    chosen = [family for family in FAMILIES if family in families]
    return sum(len(AXES) * each[family] for family in chosen) + 11 * len(_FIRST) * ("together" in chosen)


@dataclass(frozen=True)
class _ResampledSignal:
    """What the families are made of; float32."""

    sign: Array  # [axis, moment]
    level: Array  # [axis, moment]
    slope: Array  # [axis, moment]
    relative: Array  # [axis, moment], level minus its mean
    range: Array  # [axis, 1]


def describe(families: tuple[str, ...], readings: DecimatedSignal, samples: Array) -> Array:
    """Columns float32 ``[column]`` of the families, in the order of the host, of an interval of ``samples`` samples."""
    sign, level, slope = readings.value[..., moments(samples, readings.stride)]
    size = jnp.max(level, axis=-1, keepdims=True) - jnp.min(level, axis=-1, keepdims=True)
    flat = size <= NEAR * jnp.max(jnp.abs(level), axis=-1, keepdims=True)
    level = jnp.where(flat, level[:, :1], level)
    drawing = _ResampledSignal(sign, level, slope, _centred(level), jnp.where(flat, 0, size))
    made: dict[str, Callable[[_ResampledSignal], Array]] = {
        "parts": _parts,
        "spread": _spread,
        "together": _together,
        "order": _order,
        "levels": _levels,
    }
    return jnp.concatenate([made[family](drawing).reshape(-1) for family in FAMILIES if family in families])


def _centred(values: Array) -> Array:
    change = values - values[:, :1]
    return change - jnp.mean(change, axis=-1, keepdims=True)


def _compressed(value: Array) -> Array:
    """Signed logarithm of ``[axis, column]``, as on the host."""
    unit = jnp.asarray(UNIT, jnp.float32)[:, None]
    return jnp.sign(value) * jnp.log1p(jnp.abs(value) / unit)


def _ratio(a: Array, b: Array) -> Array:
    return jnp.where(b != 0, a / jnp.where(b != 0, b, 1), 0)


def _split(values: Array, count: int) -> Array:
    """``[..., moment]`` as ``[..., part, moment of the part]``; MOMENTS is a multiple of every number of parts."""
    return values.reshape(*values.shape[:-1], count, MOMENTS // count)


def _parts(x: _ResampledSignal) -> Array:
    signals = jnp.stack(
        [x.relative, x.slope, jnp.abs(x.slope), (x.sign > 0).astype(jnp.float32), (x.sign < 0).astype(jnp.float32)]
    )
    blocks = []
    for count in PARTS:
        level, slope, activity, rising, falling = jnp.mean(_split(signals, count), axis=-1)
        pieces = _split(x.level, count)
        ranges = jnp.max(pieces, axis=-1) - jnp.min(pieces, axis=-1)
        share = _ratio(level, jnp.broadcast_to(x.range, level.shape))
        blocks += [_compressed(level), share, *map(_compressed, (slope, activity, ranges)), rising, falling]
    return jnp.concatenate(blocks, axis=-1)


def _spread(x: _ResampledSignal) -> Array:
    place = np.linspace(0, 1, QUANTILES) * (MOMENTS - 1)
    below = np.floor(place).astype(np.int32)
    above = np.minimum(below + 1, MOMENTS - 1)
    share = jnp.asarray(place - below, jnp.float32)[None, None]
    ordered = jnp.sort(jnp.stack([x.relative, x.slope]), axis=-1)
    level, slope = ordered[..., below] + share * (ordered[..., above] - ordered[..., below])
    both = jnp.stack([x.relative, _centred(x.slope)], axis=1)
    deviation = jnp.sqrt(jnp.mean(both * both, axis=-1))
    ratio = _ratio(level, jnp.broadcast_to(x.range, level.shape))
    return jnp.concatenate([_compressed(level), ratio, _compressed(slope), _compressed(deviation)], axis=-1)


def _together(x: _ResampledSignal) -> Array:
    signs = jnp.stack([x.sign > 0, x.sign < 0, x.sign == 0]).astype(jnp.float32)
    shares = jnp.einsum("aim,bjm->ijab", signs, signs)[_FIRST, _SECOND].reshape(len(_FIRST), 9) / MOMENTS
    root = jnp.sign(x.slope) * jnp.sqrt(jnp.abs(x.slope))
    both = jnp.stack([x.relative, _centred(root)])
    product = jnp.einsum("sim,sjm->sij", both, both)
    size = jnp.sqrt(jnp.diagonal(product, axis1=1, axis2=2))
    found = _ratio(product[:, _FIRST, _SECOND], size[:, _FIRST] * size[:, _SECOND])
    return jnp.concatenate([shares, jnp.clip(found, -1, 1).T], axis=-1)


def _order(x: _ResampledSignal) -> Array:
    extremes = jnp.stack([x.level, -x.level, x.slope, -x.slope, jnp.abs(x.slope)])
    top = jnp.max(extremes, axis=-1, keepdims=True)
    close = extremes >= top - NEAR * (top - jnp.min(extremes, axis=-1, keepdims=True))
    number = jnp.arange(MOMENTS, dtype=jnp.float32)[None, None]
    when = jnp.min(jnp.where(close, number, MOMENTS), axis=-1) / MOMENTS
    said = jnp.stack([x.sign > 0, x.sign < 0])
    moment = (number + 0.5) / MOMENTS
    count = jnp.sum(said, axis=-1, dtype=jnp.int32).astype(jnp.float32)
    total = jnp.sum(jnp.where(said, moment, 0), axis=-1)
    mean = jnp.where(count > 0, total / jnp.maximum(count, 1), 0.5)
    first, last = jnp.min(jnp.where(said, moment, 1), axis=-1), jnp.max(jnp.where(said, moment, 0), axis=-1)
    quarter = x.range / 4
    above = [
        x.relative > NEAR * quarter,
        x.level > x.level[:, :1] + NEAR * quarter,
        x.relative > quarter,
        x.relative < -quarter,
    ]
    shares = jnp.mean(jnp.stack(above).astype(jnp.float32), axis=-1)
    times = jnp.stack([mean, first, last], axis=1).reshape(6, len(AXES))
    return jnp.concatenate([when, times, shares]).T


def _levels(x: _ResampledSignal) -> Array:
    ends = [f(x.level, axis=-1, keepdims=True) for f in (jnp.max, jnp.min)]
    return _compressed(jnp.concatenate([jnp.mean(_split(x.level, 3), axis=-1), *ends], axis=-1))
