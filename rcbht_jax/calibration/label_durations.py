"""Time per label in every sentence, for many candidate limits at once.

The encoder's own chain runs over the shared windows with lanes = recordings x axes x candidates; by the fit rule, whose
lines depend on the tolerance, over the shared samples. Nothing is stored per
window: the time of each published label is added at once to the sentences it overlaps. Times are whole samples, so the
result does not depend on how candidates or recordings are grouped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.values import check_usable
from rcbht_jax.encoding import encoder, fit, segments
from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.fit_line import residuals_after
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, limit_values
from rcbht_jax.encoding.segments import gradient_label
from rcbht_jax.encoding.thresholds import of_lanes
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYER_SIZES
from rcbht_jax.types import Array, Segment

LABELS = sum(LAYER_SIZES)
_ITEMS, _INTS, _REALS = 8, 3, 2  # held items; label, t0, t1; vmax, vmin

_BLOCK = 32  # windows between two sums
_UNROLLED = 8  # of them in a row
_NEVER = 2**31 - 1  # samples

_Held = tuple[Array, Array]  # int32 [24, lane], float [16, lane]


# Not of _util.compiling: the program compiles in 3 s in place of 5 there, but a search takes an eighth longer.
@partial(jax.jit, static_argnums=0, static_argnames="group")
def label_durations(
    config: AnyConfig,
    thresholds: AnyLimits | Float[Array, "candidate axis 5"],
    signal: Windows | Samples,
    edges: Int[Array, "recording edge"],
    *,
    group: int = 1,
) -> Int[Array, "candidate recording sentence 6 25"]:
    """Samples that each label occupies in each sentence.

    Args:
        config: static configuration; its window must be the one of the signal.
        thresholds: candidates ``[candidate, 6, 4]``, N/s and Nm/s; of the fit rule FitLimits, or ``[candidate, 6, 5]``.
        signal: fitted lines of all recordings, from :func:`fit_windows`; of the fit rule the samples.
        edges: samples at which the sentences of a recording begin and end, increasing.
        group: recordings encoded at once; larger groups suit a device with many cores.

    Returns:
        int32; primitives, compositions, behaviours in the order of their codes.

    Raises:
        InputError: limits of other axes.
    """
    limits = limit_values(thresholds)
    of_lanes(limits[0], 5 if isinstance(config, FitConfig) else 4, (AXES,))
    recordings = signal.length.shape[0]
    order = jnp.argsort(signal.length)  # a group is encoded for as long as its longest recording
    padded = jnp.concatenate([order, jnp.full(-recordings % group, order[-1])]).reshape(-1, group)
    lane_limits = jnp.moveaxis(limits, (2, 1, 0), (0, 1, 2))

    def one_group(rows: Array) -> Array:
        return _group_times(config, lane_limits, jax.tree.map(lambda leaf: leaf[rows], signal), edges[rows])

    times = jax.lax.map(one_group, padded)  # [group, sentence, label, row, axis, candidate]
    times = jnp.moveaxis(times, (0, 3, 1, 4, 2, 5), (1, 2, 3, 4, 5, 0))
    flat = times.reshape(times.shape[0], -1, *times.shape[3:])[:, :recordings]
    return jnp.zeros_like(flat).at[:, order].set(flat)


def _group_times(config: AnyConfig, limits: Array, signal: Windows | Samples, edges: Array) -> Array:
    """int32 ``[sentence, label, recording, axis, candidate]``; limits ``[4 or 5, axis, candidate]``."""
    shape = (signal.length.shape[0], AXES, limits.shape[2])
    lanes = shape[0] * shape[1] * shape[2]
    lane_limits = jnp.broadcast_to(limits[:, None], (limits.shape[0], *shape)).reshape(-1, lanes)
    lane_edges = jnp.broadcast_to(edges.T[:, :, None, None], (edges.shape[1], *shape)).reshape(-1, lanes)

    def wide(leaf: Array) -> Array:
        """Values ``[..., recording, axis]`` for every lane."""
        every = jnp.broadcast_to(leaf[..., None], (*leaf.shape, limits.shape[2]))
        return every.reshape(*leaf.shape[:-2], lanes)

    length = wide(jnp.broadcast_to(signal.length[:, None], shape[:2]))
    if isinstance(config, FitConfig):
        assert isinstance(signal, Samples)
        chain = _fit_chain(config, lane_limits, signal, length, wide)
    else:
        assert isinstance(signal, Windows)
        chain = _paper_chain(config, lane_limits, signal, length, wide)

    def block(index: Array, carry: tuple[Any, Array]) -> tuple[Any, Array]:
        held, times = carry
        held, published = jax.lax.scan(chain.step, held, index * _BLOCK + jnp.arange(_BLOCK, dtype=jnp.int32))
        return held, _spend(times, published, lane_edges)

    times = jnp.zeros((edges.shape[1] - 1, LABELS, lanes), jnp.int32)
    blocks = -(-jnp.max(signal.length) // (config.window * _BLOCK))
    held, times = jax.lax.fori_loop(jnp.int32(0), blocks, block, (chain.held, times))
    times = _spend(times, _rest(chain.rest(held)), lane_edges)
    return times.reshape(*times.shape[:2], *shape)


class _Chain(NamedTuple):
    """A rule as the loop over windows runs it, over lanes."""

    held: Any  # before the first window
    step: Callable[[Any, Array], tuple[Any, Array]]  # (held, number of the window) -> (held, published [9, lane])
    rest: Callable[[Any], Sequence[Segment]]  # held -> what the end of a recording publishes, [slot, lane] per layer


def _paper_chain(
    config: EncoderConfig, limits: Array, windows: Windows, length: Array, wide: Callable[[Array], Array]
) -> _Chain:
    rows = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), (windows.slope, windows.vmax, windows.vmin))
    lanes, dtype = length.shape[0], windows.slope.dtype

    def step(held: _Held, index: Array) -> tuple[_Held, Array]:
        slope, vmax, vmin = (wide(jax.lax.dynamic_index_in_dim(row, index, keepdims=False)) for row in rows)
        start = jnp.full(lanes, index * config.window)
        size = jnp.clip(length - start, 0, config.window)
        label = jnp.where(size >= 2, gradient_label(slope, limits), 0)
        none = jnp.zeros_like(slope)
        x = Segment(label, start, start + size, vmax, vmin, none, none)
        items, published = encoder.chain(config, _unpack(held), x)
        return _pack(items), _labels(published)

    held = jnp.zeros((_ITEMS * _INTS, lanes), jnp.int32), jnp.zeros((_ITEMS * _REALS, lanes), dtype)
    return _Chain(held, step, lambda held: [encoder.stack(x) for x in encoder.drain_segments(config, _unpack(held))])


def _fit_chain(
    config: FitConfig, limits: Array, samples: Samples, length: Array, wide: Callable[[Array], Array]
) -> _Chain:
    window, kept = config.window, config.kept
    short = -samples.wrench.shape[1] % window
    line = jnp.pad(jnp.swapaxes(samples.wrench, 0, 1), ((kept, short), (0, 0), (0, 0)))  # [time, recording, axis]

    def step(state: EncoderState, index: Array) -> tuple[EncoderState, Array]:
        recent = jax.lax.dynamic_slice_in_dim(line, index * window, kept + window)
        counts = jnp.clip(samples.length - index * window, 0, window)
        after = residuals_after(recent, jnp.broadcast_to(kept + counts[:, None], recent.shape[1:]))
        count = jnp.clip(length - index * window, 0, window)
        state, stages = fit.advance(config, limits, state, wide(recent), wide(after), count)
        return state, _labels(stages[::2])

    def rest(state: EncoderState) -> Sequence[Segment]:
        return fit.stacked([stages[::2] for stages in fit.drain_stages(config, limits, state)], 0)

    return _Chain(fit.init(config, length.shape, line.dtype), step, rest)


def _rest(layers: Sequence[Segment]) -> Array:
    """What the end of a recording publishes, int32 ``[slot, 9, lane]`` like a block."""
    slots = -(-max(items.label.shape[0] for items in layers) // _UNROLLED) * _UNROLLED
    short = ((0, slots - items.label.shape[0]) for items in layers)
    padded = [jax.tree.map(lambda leaf, s=s: jnp.pad(leaf, (s, (0, 0))), x) for x, s in zip(layers, short, strict=True)]
    return jnp.swapaxes(_labels(padded), 0, 1)


def _spend(times: Array, published: Array, edges: Array) -> Array:
    """Add published spans ``[step, 9, lane]`` to ``times [sentence, label, lane]``.

    Most blocks publish spans of one or two sentences only, so the sentences are a loop with few rounds.
    """
    label, t0, t1 = (published[:, field::_INTS] for field in range(_INTS))  # [step, layer, lane]
    first = jnp.min(jnp.where(label > 0, t0, _NEVER), axis=(0, 1))
    final = jnp.max(jnp.where(label > 0, t1, 0), axis=(0, 1))
    low = jnp.min(jnp.sum(edges[1:] <= first[None], axis=0, dtype=jnp.int32))
    high = jnp.max(jnp.sum(edges[:-1] < final[None], axis=0, dtype=jnp.int32))

    def one(sentence: Array, times: Array) -> Array:
        start, end = (jax.lax.dynamic_index_in_dim(edges, sentence + k, keepdims=False) for k in (0, 1))
        inside = jnp.maximum(jnp.minimum(t1, end[None, None]) - jnp.maximum(t0, start[None, None]), 0)
        spent = [_per_label(label[:, k], inside[:, k], size) for k, size in enumerate(LAYER_SIZES)]
        return times.at[sentence].add(jnp.concatenate(spent))

    return jax.lax.fori_loop(low, high, one, times)


def _per_label(label: Array, duration: Array, size: int) -> Array:
    """Sum of durations ``[step, lane]`` by label, ``[size, lane]``.

    Steps in the outer loop and lanes in the inner one: a reduction would walk through memory the other way.
    """
    code = jnp.arange(1, size + 1, dtype=jnp.int32)[:, None]

    def some(index: Array, total: Array) -> Array:
        for step in range(_UNROLLED):
            row = index * _UNROLLED + step
            code_of_step, time = (jax.lax.dynamic_index_in_dim(x, row, keepdims=True) for x in (label, duration))
            total += jnp.where(code_of_step == code, time, 0)
        return total

    return jax.lax.fori_loop(0, label.shape[0] // _UNROLLED, some, jnp.zeros((size, label.shape[1]), jnp.int32))


def _labels(items: Sequence[Segment]) -> Array:
    return jnp.stack([leaf for x in items for leaf in (x.label, x.t0, x.t1)])


def _pack(items: list[Segment]) -> _Held:
    return _labels(items), jnp.stack([leaf for x in items for leaf in (x.vmax, x.vmin)])


def _unpack(held: _Held) -> list[Segment]:
    """Segments without area and rise, on which no label depends."""
    none = jnp.zeros_like(held[1][0])
    ints, reals = (leaf.reshape(_ITEMS, -1, none.shape[0]) for leaf in held)
    return [
        Segment(label=i[0], t0=i[1], t1=i[2], vmax=r[0], vmin=r[1], area=none, rise=none)
        for i, r in zip(ints, reals, strict=True)
    ]


AXES = 6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Windows:
    """Fitted lines; windows beyond a recording have length 0."""

    slope: Float[Array, "recording window 6"]  # N/s or Nm/s
    vmax: Float[Array, "recording window 6"]  # larger end of the line, N or Nm
    vmin: Float[Array, "recording window 6"]  # smaller end of the line, N or Nm
    length: Int[Array, " recording"]  # int32, samples

    def take(self, rows: NDArray[np.integer[Any]]) -> Windows:
        """The chosen recordings."""
        chosen: Windows = jax.tree.map(lambda leaf: leaf[rows], self)
        return chosen


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Samples:
    """The signal itself, as the fit rule reads it."""

    wrench: Float[Array, "recording time 6"]  # N and Nm, finite, in the precision of the labels
    length: Int[Array, " recording"]  # int32, samples


def fit_windows(config: AnyConfig, wrench: NDArray[np.floating], length: NDArray[np.integer[Any]]) -> Windows:
    """Fit a line to every window, the last partial one of each recording included.

    Args:
        config: window and sampling period.
        wrench: float32 or float64 ``[recording, time, 6]``, N and Nm.
        length: int ``[recording]``, valid samples.

    Returns:
        host arrays in the precision of the wrench.

    Raises:
        InputError: wrong shapes, or valid samples that are not finite.
    """
    if wrench.ndim != 3 or wrench.shape[2] != AXES or length.shape != wrench.shape[:1] or not length.size:
        raise InputError(
            f"The wrench has shape {wrench.shape} with {length.size} lengths; expected [recording, time, 6] and one "
            "length for each recording."
        )
    check_usable(wrench, length)
    count = -(-int(length.max()) // config.window)
    padded = np.zeros((len(length), count * config.window, AXES), wrench.dtype)
    for row, samples in enumerate(length):
        padded[row, :samples] = wrench[row, :samples]
    counts = length.astype(np.int32)
    slope, vmax, vmin = device_lines(config, jnp.asarray(padded), jnp.asarray(counts))
    return Windows(np.asarray(slope), np.asarray(vmax), np.asarray(vmin), counts)


@partial(jax.jit, static_argnums=0)
def device_lines(
    config: AnyConfig, wrench: Float[jax.Array, "recording time 6"], length: Int[jax.Array, " recording"]
) -> tuple[Float[jax.Array, "recording window 6"], ...]:
    """Slopes, larger and smaller ends of the lines; the wrench is made of whole windows."""
    _, slope, x = segments.window_lines(wrench, length, config.window, config.dt)
    return slope, x.vmax, x.vmin
