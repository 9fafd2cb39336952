"""The families of :mod:`rcbht_jax.features.signal_families` while the interval grows, in constant time and memory.

The signal is sampled at every ``stride``-th sample since the interval began, at most READINGS times; when the interval
outgrows them every other reading is dropped and the stride doubles. Each reading is of the line that covers its sample,
whenever that line was published, so the readings depend on the samples so far and on nothing else. The equally spaced
moments of the host's families are then taken from the nearest readings, at most 1/256 of the interval away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.features.signal_families import COLUMNS, FAMILIES, MOMENTS, SIGNS, ResampledSignal
from rcbht_jax.types import Array, LabelTrack

READINGS = 256
_DOUBLINGS = 22  # of the stride at most: more than sample numbers can count
_FINE = 1024  # steps per stride to which the length of a long interval is rounded, so that products stay in 32 bits


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DecimatedSignal:
    """The signal at samples ``begin + k stride``, and the latest line, which is continued."""

    stride: Array  # int32 [], samples
    value: Array  # float32 [3, axis, reading]: 1 rising, -1 falling, 0 constant; level; slope
    span: Array  # int32 [2, axis], first sample of the latest line and one past its last; 0 = no line yet
    line: Array  # float32 [5, axis], sign, vmax, vmin, avg and slope of it


def empty(axes: int) -> DecimatedSignal:
    """Nothing read yet."""
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
    signs = jnp.asarray(SIGNS, jnp.float32)[words.label.astype(jnp.int32)]
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


def width(families: tuple[str, ...], axes: int) -> int:
    """Columns that :func:`describe` makes of these families."""
    lanes = {"together": axes * (axes - 1) // 2}
    return sum(lanes.get(family, axes) * len(COLUMNS[family]) for family in FAMILIES if family in families)


def describe(families: tuple[str, ...], readings: DecimatedSignal, samples: Array) -> Array:
    """Columns float32 ``[column]`` of the families, in the order of the host, of an interval of ``samples`` samples."""
    signal = ResampledSignal.of(*readings.value[..., moments(samples, readings.stride)])
    return jnp.concatenate([make(signal).reshape(-1) for family, make in FAMILIES.items() if family in families])
