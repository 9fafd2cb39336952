"""Whole data sets through the encoder: scheduled from the host with little padding, or at once on the device."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.compiling import jit
from rcbht_jax._util.values import check_usable
from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState, encode
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, rule_of
from rcbht_jax.encoding.thresholds import Thresholds, limits_of, of_lanes
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array, LabelTrack, LabelTracks

_SLOTS = 1, 4, 16, 64, 128  # few, because each number compiles programs of its own
_STEP_LANES = 64  # lanes that take as long as what a piece costs whatever their number
_PIECE_WINDOWS, _PIECE_SAMPLES = 64, 4096  # fewer windows where the data have fewer, but so many samples
_LONG_PIECE = 256  # windows, where recordings are 16 times as long on average: pieces of 64 take up to twice the time


@dataclass(frozen=True)
class Schedule:
    """Which recording each slot works on, piece by piece.

    Attributes:
        recording: int ``[piece, slot]``, -1 = idle.
        offset: int ``[piece, slot]``, first sample of the piece within its recording.
        samples: samples of one piece.
    """

    recording: NDArray[np.int64]
    offset: NDArray[np.int64]
    samples: int


def plan(length: NDArray[np.int32], samples: int, axes: int) -> Schedule:
    """Longest recording first onto the slot that is free first, with the number of slots that takes least time.

    Args:
        length: int ``[recording]``, samples.
        samples: samples of one piece, > 0.
        axes: lanes of a slot.
    """
    pieces = np.maximum(-(-length.astype(np.int64) // samples), 1)

    def cost(slots: int) -> int:
        return max(int(pieces.max()), -(-int(pieces.sum()) // slots)) * (_STEP_LANES + slots * axes)

    slots = min(_SLOTS, key=cost)
    free = [(0, slot) for slot in range(slots)]
    starts = np.empty((len(pieces), 2), np.int64)
    for index in np.argsort(-pieces, kind="stable"):
        time, slot = heapq.heappop(free)
        starts[index] = time, slot
        heapq.heappush(free, (time + int(pieces[index]), slot))
    rows = max(time for time, _ in free)
    recording = np.full((rows, slots), -1, np.int64)
    offset = np.zeros((rows, slots), np.int64)
    for index, (time, slot) in enumerate(starts):
        span = slice(time, time + pieces[index])
        recording[span, slot] = index
        offset[span, slot] = np.arange(pieces[index]) * samples
    return Schedule(recording, offset, samples)


def encode_batch(
    config: AnyConfig,
    thresholds: AnyLimits,
    wrench: NDArray[np.floating],
    length: NDArray[np.int32],
    *,
    progress: Callable[[int], None] | None = None,
) -> LabelTracks:
    """Labels of a whole data set in the compact form, scheduled from the host; see :func:`encode_on_device`.

    Args:
        config: static configuration; its type chooses the rule.
        thresholds: limits ``[axis, 4]``, or ``[recording, axis, 4]``; of the fit rule FitLimits of the same axes.
        wrench: float32 or float64 ``[recording, time, axis]``, N and Nm; the dtype decides the precision.
        length: int ``[recording]``, samples that count.
        progress: called with the number of samples done since the last call.

    Returns:
        host arrays ``[recording, axis, slot]``, unused slots at the end.

    Raises:
        InputError: wrong shapes or dtype, thresholds out of order, a length beyond the array, or values that are not
            finite.
    """
    limits, axes = _checked(config, thresholds, wrench, length), wrench.shape[2]
    rule = rule_of(config)
    whole = 1 << max(-(-int(length.max()) // config.window) - 1, 0).bit_length()  # a power of two: few programs
    most = _LONG_PIECE if length.mean() >= 16 * _LONG_PIECE * config.window else _PIECE_WINDOWS
    schedule = plan(length, min(most, max(whole, _PIECE_SAMPLES // config.window)) * config.window, axes)
    slots = schedule.recording.shape[1]
    state = rule.init(config, (slots * axes,), jax.dtypes.canonicalize_dtype(wrench.dtype))
    rows = _Rows(axes)
    for recording, offset in zip(schedule.recording, schedule.offset, strict=True):
        piece, count, lane_limits = _gather(wrench, length, limits, recording, offset, schedule.samples)
        lane_count = np.repeat(count, axes)
        fresh, lanes = jnp.asarray(np.repeat(offset == 0, axes)), jnp.asarray(lane_limits)
        state, tracks = _piece(config, lanes, state, fresh, jnp.asarray(piece), jnp.asarray(lane_count))
        rows.add(tracks, recording)
        done = (recording >= 0) & (offset + schedule.samples >= length[recording])
        if done.any():
            rows.add(_drained(config, lanes, state), np.where(done, recording, -1))
        if progress is not None:
            progress(int(count.sum()))
    return rows.compact(len(length))


def _checked(
    config: AnyConfig, thresholds: AnyLimits, wrench: NDArray[np.floating], length: NDArray[np.int32]
) -> NDArray[np.floating]:
    if wrench.ndim != 3 or not wrench.shape[2]:
        raise InputError(f"The wrench has shape {wrench.shape}; expected [recording, time, axis].")
    if wrench.dtype not in (np.float32, np.float64):
        raise InputError(f"The wrench is {wrench.dtype}; expected float32 or float64.")
    if length.shape != wrench.shape[:1] or length.size == 0:
        raise InputError(
            f"There are {length.size} lengths for {wrench.shape[0]} recordings; expected as many, at least one."
        )
    check_usable(wrench, length)
    limits, axes = checked_limits(config, thresholds), wrench.shape[2]
    of_lanes(limits[..., :4], 4, (len(length), axes))
    return np.broadcast_to(limits, (len(length), axes, limits.shape[-1])).astype(wrench.dtype)


def _gather(
    wrench: NDArray[np.floating],
    length: NDArray[np.int32],
    limits: NDArray[np.floating],
    recording: NDArray[np.int64],
    offset: NDArray[np.int64],
    samples: int,
) -> tuple[NDArray[np.floating], NDArray[np.int32], NDArray[np.floating]]:
    """One piece of every slot: samples ``[time, lane]``, counts ``[slot]``, limits ``[4 or 5, lane]``."""
    slots, axes = len(recording), wrench.shape[2]
    piece = np.zeros((samples, slots, axes), wrench.dtype)
    count = np.zeros(slots, np.int32)
    for slot in np.flatnonzero(recording >= 0):
        index, start = recording[slot], offset[slot]
        stop = min(start + samples, length[index])
        count[slot] = stop - start
        piece[: stop - start, slot] = wrench[index, start:stop]
    lane_limits = limits[np.maximum(recording, 0)].reshape(slots * axes, -1).T
    return piece.reshape(samples, slots * axes), count, lane_limits


@jit(static_argnums=0)
def _piece(
    config: AnyConfig,
    limits: jax.Array,
    state: EncoderState,
    fresh: jax.Array,
    samples: jax.Array,
    count: jax.Array,
) -> tuple[EncoderState, LabelTracks]:
    def restart(leaf: jax.Array) -> jax.Array:
        wide = jnp.broadcast_to(fresh, leaf.shape) if leaf.ndim == 1 else jnp.broadcast_to(fresh[None], leaf.shape)
        return jnp.where(wide, jnp.zeros_like(leaf), leaf)

    return rule_of(config).scan_lanes(config, limits, jax.tree.map(restart, state), samples, count)


@jit(quick=True, static_argnums=0)
def _drained(config: AnyConfig, limits: jax.Array, state: EncoderState) -> LabelTracks:
    return rule_of(config).drain(config, limits, state)


class _Rows:
    """Published labels as flat columns, gathered piece by piece, then laid out as padded tracks."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        self._parts: tuple[list[tuple[NDArray[np.int64], LabelTrack]], ...] = ([], [], [])  # lanes, their labels

    def add(self, tracks: LabelTracks, recording: NDArray[np.int64]) -> None:
        """Keep the labels of the slots whose recording is not -1."""
        lane = (recording[:, None] * self._axes + np.arange(self._axes)).ravel()  # negative where there is none
        for parts, track in zip(self._parts, (tracks.primitive, tracks.mc, tracks.llb), strict=True):
            track = jax.tree.map(np.asarray, track)
            where = np.nonzero((track.label != 0) & (lane >= 0)[:, None])
            parts.append((lane[where[0]], jax.tree.map(lambda leaf, where=where: leaf[where], track)))

    def compact(self, recordings: int) -> LabelTracks:
        """Tracks ``[recording, axis, slot]``, each as long as its longest sentence."""
        return LabelTracks(*(self._layer(parts, recordings) for parts in self._parts))

    def _layer(self, parts: list[tuple[NDArray[np.int64], LabelTrack]], recordings: int) -> LabelTrack:
        lane, labels = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
        order = np.argsort(lane, kind="stable")  # pieces came in order of time
        counts = np.bincount(lane, minlength=recordings * self._axes)
        slot = np.arange(len(lane)) - np.repeat(np.cumsum(counts) - counts, counts)

        def padded(values: NDArray[np.generic]) -> NDArray[np.generic]:
            rows = np.zeros((recordings * self._axes, max(int(counts.max()), 1)), values.dtype)
            rows[lane[order], slot] = values[order]
            return rows.reshape(recordings, self._axes, -1)

        return jax.tree.map(padded, labels)


# Sizes are rounded up, so that few programs are compiled: slots of a compact track to this, ...
WIDTH = 32
STRETCH = 200  # ... recordings to this many windows, ...
ROWS = 64  # ... and batches to this many recordings
BY_SCAN, BY_KERNELS, MEMORY = 2400, 96, 2**33  # bytes for a window of one axis, and for all that is encoded at once


def encode_on_device(
    config: EncoderConfig,
    thresholds: Thresholds,
    wrench: Float[Array, "recording time axis"],
    length: Int[Array, " recording"],
    *,
    batch: int | None = None,
) -> LabelTracks:
    """Labels of a batch of recordings in the compact form, without a transfer to the host.

    The labels equal those of :func:`encode_batch` bit for bit. That function is better where recordings differ much in
    length or where memory is short: here all are scanned at once to the end of the longest. Several devices work at
    once where each is given recordings of its own by a thread of its own.

    Args:
        config: static configuration.
        thresholds: limits ``[axis, 4]`` or ``[recording, axis, 4]``.
        wrench: float32 on the device, N and Nm, padded with anything finite.
        length: int32, samples that count.
        batch: recordings that are encoded at once, which bounds the memory: a window of one axis takes 2.4 kB by a
            scan, 0.1 kB by the kernels of a GPU; None = as many as take 8 GB.

    Returns:
        device arrays ``[recording, axis, slot]``, where the recordings are; unused slots are at the end and zero.

    Raises:
        InputError: limits of other axes, or of other recordings.
    """
    count, batch = len(wrench), batch or _batch_within(MEMORY, config, wrench)
    if count <= batch:
        return begin_encoding(config, thresholds, wrench, length)()
    spare = -count % batch  # whole batches: one compiled program
    limits = _limits_of_each(of_lanes(limits_of(thresholds), 4, wrench.shape[::2]), count + spare)
    given = limits, *(_padded(spare, 0, wrench, length) if spare else (wrench, length))
    pieces = [begin_encoding(config, *_part(start, batch, given))() for start in range(0, count, batch)]
    return _joined(count, pieces)


def begin_encoding(
    config: EncoderConfig,
    thresholds: Thresholds,
    wrench: Float[Array, "recording time axis"],
    length: Int[Array, " recording"],
) -> Callable[[], LabelTracks]:
    """:func:`encode_on_device` in two halves: this one starts the encoding, the function it returns waits for labels.

    How many slots there are is known only when the device has encoded; meanwhile the caller can give it other work. All
    recordings are scanned at once. It raises the same errors.
    """
    count, samples, axes = wrench.shape
    spare, tail = -count % ROWS, -samples % (config.window * STRETCH)
    limits = of_lanes(limits_of(thresholds), 4, (count, axes))
    if spare and limits.ndim > 2:
        limits = _limits_of_each(limits, count + spare)
    if spare or tail:  # a program of its own: those that encode take long to compile
        wrench, length = _padded(spare, tail, wrench, length)
    encoded, shortened = (_packed, _trimmed) if _by_kernels(config, wrench) else (_dense, _compacted)
    tracks, longest = encoded(config, limits, wrench, length)

    def ended() -> LabelTracks:
        widths = tuple(max(-(-int(n) // WIDTH), 1) * WIDTH for n in np.asarray(longest))
        return shortened(widths, (count, axes), tracks)

    return ended


def _batch_within(memory: int, config: EncoderConfig, wrench: Array) -> int:
    """How many recordings may be encoded at once, a multiple of ROWS."""
    _, samples, axes = wrench.shape
    windows = -(-samples // (config.window * STRETCH)) * STRETCH
    each = (BY_KERNELS if _on_gpu(wrench) else BY_SCAN) * max(windows, 1) * axes
    return max(memory // each // ROWS, 1) * ROWS


def _on_gpu(wrench: Array) -> bool:
    return isinstance(wrench, jax.Array) and {device.platform for device in wrench.devices()} == {"gpu"}


def _by_kernels(config: EncoderConfig, wrench: Array) -> bool:
    """Whether the kernels of :mod:`rcbht_jax.encoding.gpu` encode these recordings, where they are."""
    if not _on_gpu(wrench):
        return False
    from rcbht_jax.encoding import gpu

    return gpu.fits(config, wrench, packed=True)


@partial(jax.jit, static_argnums=1)
def _limits_of_each(limits: Array, count: int) -> Array:
    """Limits of so many recordings: those of all, or of each and then of the last one."""
    if limits.ndim == 2:
        return jnp.broadcast_to(limits, (count, *limits.shape))
    return jnp.pad(limits, ((0, count - len(limits)), (0, 0), (0, 0)), mode="edge")


@partial(jax.jit, static_argnums=(0, 1))
def _padded(spare: int, tail: int, wrench: Array, length: Array) -> tuple[Array, Array]:
    """More recordings, which have no samples, and longer ones."""
    return jnp.pad(wrench, ((0, spare), (0, tail), (0, 0))), jnp.pad(length, (0, spare))


@partial(jax.jit, static_argnums=1)
def _part(start: Array | int, batch: int, arrays: tuple[Array, ...]) -> tuple[Array, ...]:
    """The recordings from one on."""
    return jax.tree.map(lambda array: jax.lax.dynamic_slice_in_dim(array, start, batch), arrays)


@partial(jax.jit, static_argnums=0)
def _joined(count: int, pieces: Sequence[LabelTracks]) -> LabelTracks:
    """Pieces one after the other, each track as wide as the widest."""

    def stacked(*leaves: Array) -> Array:
        width = max(leaf.shape[-1] for leaf in leaves)
        wide = [jnp.pad(leaf, ((0, 0), (0, 0), (0, width - leaf.shape[-1]))) for leaf in leaves]
        return jnp.concatenate(wide)[:count]

    return jax.tree.map(stacked, *pieces)


@partial(jax.jit, static_argnums=0)
def _packed(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> tuple[Any, Array]:
    """Packed labels of each layer and how many each lane has ``[3, lane]``; and the most."""
    from rcbht_jax.encoding import gpu

    limits = _limits_of_each(limits, len(wrench)).astype(wrench.dtype)
    by_lane = jnp.moveaxis(limits, -1, 0).reshape(limits.shape[-1], -1)
    packed, used = gpu.encode_packed(config, by_lane, wrench, length.astype(jnp.int32))
    return (packed, used), used.max(-1)


@partial(jax.jit, static_argnums=(0, 1))
def _trimmed(widths: tuple[int, int, int], shape: tuple[int, int], packed: Any) -> LabelTracks:
    """Tracks ``[recording, axis, slot]`` of packed labels, without slots that no lane uses; the others end in zeros."""
    from rcbht_jax.encoding import gpu

    recordings, axes = shape

    def layer(width: int, words: Array, count: Array) -> LabelTrack:
        words, there = words[: recordings * axes, :width], jnp.arange(width, dtype=jnp.int32)[None] < count[:, None]
        words = jnp.pad(words, ((0, 0), (0, max(width - words.shape[1], 0)), (0, 0)))
        words = jnp.where(there[: recordings * axes, :, None], words, 0)
        return gpu.unpacked(words.reshape(recordings, axes, width, -1))

    return LabelTracks(*(layer(*each) for each in zip(widths, *packed, strict=True)))


@jit(static_argnums=0)
def _dense(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> tuple[LabelTracks, Array]:
    """Dense labels ``[recording, axis, slot]``, and how many a lane has at most in each layer."""
    dense = encode(config, _limits_of_each(limits, len(wrench)), wrench, length)
    return dense, jnp.stack([(track.label != 0).sum(-1).max() for track in (dense.primitive, dense.mc, dense.llb)])


@jit(static_argnums=(0, 1))
def _compacted(widths: tuple[int, int, int], shape: tuple[int, int], dense: LabelTracks) -> LabelTracks:
    """As :func:`_trimmed`, of dense labels."""
    tracks = (jax.tree.map(lambda leaf: leaf[: shape[0]], track) for track in (dense.primitive, dense.mc, dense.llb))
    return LabelTracks(*(_compact(width, track) for width, track in zip(widths, tracks, strict=True)))


def _compact(width: int, track: LabelTrack) -> LabelTrack:
    """The used slots of every lane, in their order."""
    seen = jnp.cumsum(track.label != 0, axis=-1, dtype=jnp.int32)
    wanted = jnp.arange(1, width + 1, dtype=jnp.int32)
    search = partial(jnp.searchsorted, v=wanted, side="left")
    slot = jax.vmap(jax.vmap(search))(seen).astype(jnp.int32)
    there = wanted[None, None] <= seen[..., -1:]
    slot = jnp.where(there, slot, 0)

    def chosen(values: Array) -> Array:
        return jnp.where(there, jnp.take_along_axis(values, slot, axis=-1), jnp.zeros((), values.dtype))

    return jax.tree.map(chosen, track)
