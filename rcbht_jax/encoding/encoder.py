"""The streaming encoder as pure functions: wrench in, three layers of labels out (paper, section III).

:func:`init`, :func:`step`, :func:`flush` and :func:`encode` are safe under ``jit``, ``vmap``, ``grad`` and ``scan``;
the configuration is static. ``step`` has a fixed size and no loop; ``encode`` scans it. Lanes (axes, arms, trials)
are trailing batch dimensions, so a window is ``[window, axis]``, and ``[window, trial, axis]`` works alike.
Streaming and batch results are equal bit for bit: see :class:`rcbht_jax.types.Segment` for why. Their interfaces on
host arrays are ``rcbht_jax.encode`` and :class:`rcbht_jax.encoding.stream.Encoder`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from rcbht_jax.encoding import composition, division, pipe, segments
from rcbht_jax.encoding.choices import check_choices, make_plain
from rcbht_jax.encoding.pipe import PipeRules
from rcbht_jax.encoding.thresholds import Thresholds, by_lane, limits_of
from rcbht_jax.errors import InputError
from rcbht_jax.labels import MC
from rcbht_jax.types import Array, LabelTrack, LabelTracks, Segment

FLUSH_SLOTS = (2, 5, 8)  # most labels that the end of a stream can publish, per layer
_HELD = 8  # P.A P.B H M.A M.B H L.A L.B
_INTS, _REALS = 3, 4  # fields of a segment


@dataclass(frozen=True)
class EncoderConfig:
    """Static choices of the encoder (hashable: one compilation each).

    Attributes:
        window: samples per straight-line fit, >= 2.
        dt: seconds between samples.
        gate: pair primitives only if amplitudes agree within a factor of 2 and durations within a factor of 5.
        adj_exempt: keep repeated adjustments separate, so that alignments and shifts can be distinguished.
        contact_first: impulses are never the second of a pair that another primitive begins.
        pipe: "two-slot", or "one-slot" which compares each arrival with the accumulator.
        rule: time-amplitude rule, "paper" or the reference's older "similar".
        latency_cap: s for which a primitive waits after its successor began, at most two windows more; None = no limit.
            Compositions and behaviours also wait for the next word of the layer below, however long that takes.
        noise_below: single compositions shorter than this many seconds become noise.

    Raises:
        InputError: a value is of another type or out of range.

    Example:
        >>> EncoderConfig(window=20, dt=0.001).dt  # lines of 20 ms at 1 kHz
        0.001
    """

    window: int = 5
    dt: float = 0.005
    gate: bool = True
    adj_exempt: bool = True
    contact_first: bool = False
    pipe: Literal["two-slot", "one-slot"] = "two-slot"
    rule: Literal["paper", "similar"] = "paper"
    latency_cap: float | None = None
    noise_below: float = 0.1

    def __post_init__(self) -> None:
        make_plain(self)
        check_choices(self.window, self.dt, latency_cap=self.latency_cap, noise_below=self.noise_below)

    @property
    def short(self) -> int:
        """Samples below which a single composition is noise."""
        return round(self.noise_below / self.dt)

    @property
    def lead(self) -> int | None:
        """Samples of the longest primitive that pairs with an impulse after it; None: of any length."""
        return 0 if self.contact_first else None

    def rules(self, layer: int) -> PipeRules:
        """Rules of the pipe behind layer 0 (primitives), 1 (compositions) or 2 (behaviours)."""
        contact = (pipe.is_impulse, pipe.is_contact, pipe.is_contact_behaviour)[layer]
        exempt = int(MC.A) if layer == 1 and self.adj_exempt else None
        cap = None if self.latency_cap is None else round(self.latency_cap / self.dt)
        return PipeRules(contact, exempt, self.rule, cap, self.pipe == "one-slot")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EncoderState:
    """Everything the encoder remembers: eight segments per lane, whatever the length of the stream.

    The segments are stacked in two arrays because a loop that carries two arrays runs four times faster
    on a CPU than one that carries fifty-six.
    """

    # Not named dimensions: vmap stacks states, with a dimension in front.
    time: Int[Array, "..."]  # int32 [*lanes], samples consumed
    ints: Int[Array, "..."]  # int32 [24, *lanes], label, t0, t1 of each segment
    reals: Float[Array, "..."]  # [32, *lanes], vmax, vmin, area, rise of each segment


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PackedLabels:
    """What one step publishes, packed for the loop; :func:`unpack` gives the labels. Stacks of steps lead."""

    ints: Int[Array, ...]  # int32 [9, *lanes], label, t0, t1 of each layer's segment
    reals: Float[Array, ...]  # [12, *lanes], vmax, vmin, area, rise of each layer's segment
    emit: Int[Array, ...]  # int32 [*lanes], samples received


def init(lanes: tuple[int, ...] = (6,), dtype: jax.typing.DTypeLike = jnp.float32) -> EncoderState:
    """The empty state for ``lanes``, for example ``(6,)`` or ``(trials, 6)``; dtype float32 or float64."""
    ints, reals = jnp.zeros((_HELD * _INTS, *lanes), jnp.int32), jnp.zeros((_HELD * _REALS, *lanes), dtype)
    return EncoderState(jnp.zeros(lanes, jnp.int32), ints, reals)


def step(
    config: EncoderConfig, thresholds: Thresholds, state: EncoderState, window: Float[Array, " window *lanes"]
) -> tuple[EncoderState, PackedLabels]:
    """One full window of samples for every lane.

    Args:
        config: static configuration.
        thresholds: limits ``[axis, 4]``, or ``[*lanes, 4]``.
        state: of the same lanes, the last of which are the axes.
        window: ``config.window`` samples, N and Nm; they are taken in the precision of the state.

    Returns:
        the new state and at most one label per layer and lane, packed.

    Raises:
        InputError: the window has another number of samples, or limits of other axes.

    Example:
        >>> from rcbht_jax.encoding.thresholds import preset
        >>> config = EncoderConfig(window=5, dt=0.005)
        >>> state, packed = step(config, preset(), init((6,)), jnp.ones((5, 6)))
        >>> unpack(packed).primitive.label.shape, int(state.time[0])
        ((6,), 5)
    """
    return step_partial(config, thresholds, state, window, jnp.full_like(state.time, config.window))


def step_partial(
    config: EncoderConfig,
    thresholds: Thresholds,
    state: EncoderState,
    window: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
) -> tuple[EncoderState, PackedLabels]:
    """As :func:`step`, for a window whose first ``count`` samples are there; a single one is dropped."""
    if window.shape[0] != config.window:
        raise InputError(f"The window has {window.shape[0]} samples; this encoder takes {config.window} at a time.")
    window, count = jnp.asarray(window, state.reals.dtype), count.astype(jnp.int32)
    limits = by_lane(limits_of(thresholds), 4, state.time.shape, window.dtype)
    x = segments.fit(window, count, limits, config.dt, state.time)
    return _advance(config, state, x, jnp.where(x.label > 0, count, 0))


def unpack(published: PackedLabels) -> LabelTracks:
    """Labels of one step, arrays ``[...]`` like the lanes; label 0 where nothing was published.

    Under a scan, apply it to each step by ``jax.vmap`` or leave the packed form as it is.
    """
    return LabelTracks(*(track_of(x, published.emit) for x in unpack_segments(published.ints, published.reals)))


def flush(
    config: EncoderConfig,
    thresholds: Thresholds,
    state: EncoderState,
    rest: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
) -> LabelTracks:
    """End of the stream: the last partial window, then all that is still held.

    The state stays as it is, so that these are also the provisional labels of a stream that goes on.

    Args:
        config: static configuration.
        thresholds: limits ``[axis, 4]``, or ``[*lanes, 4]``.
        state: of the same lanes.
        rest: the samples that did not fill a window, then anything.
        count: how many of them there are, < window; a single one is dropped.

    Returns:
        labels ``[*lanes, slot]`` with 1 + 2, 1 + 5 and 1 + 8 slots: the window's, then the drained ones.

    Raises:
        InputError: as :func:`step`.
    """
    state, out = step_partial(config, thresholds, state, rest, count)
    return join_tracks(jax.tree.map(lambda leaf: leaf[..., None], unpack(out)), drain(config, state))


def encode(
    config: EncoderConfig,
    thresholds: Thresholds,
    wrench: Float[Array, "trial time axis"],
    length: Int[Array, " trial"],
) -> LabelTracks:
    """All labels of whole recordings: a scan of the same step, then the flush.

    Under ``shard_map`` the kernels of a GPU need ``check_vma=False``.

    Args:
        config: static configuration.
        thresholds: limits ``[axis, 4]`` or ``[trial, axis, 4]``.
        wrench: N and Nm, padded with anything finite; float64 is encoded in double precision, all else in single.
        length: samples that count.

    Returns:
        labels ``[trial, axis, slot]`` in the dense form: one slot per window, partial ones included,
        then 2, 5 and 8 slots for what the end of the stream publishes.

    Raises:
        InputError: other shapes, or limits of other axes.
    """
    if wrench.ndim != 3 or length.shape != wrench.shape[:1]:
        raise InputError(f"Wrench {wrench.shape}, length {length.shape}; expected [trial, time, axis] and [trial].")
    (trials, _, axes), wrench = wrench.shape, segments.as_floating(wrench)
    lane_limits = by_lane(limits_of(thresholds), 4, (trials, axes), wrench.dtype).reshape(4, trials * axes)
    length, run = length.astype(jnp.int32), partial(_scan_whole, config)
    if jax.default_backend() == "gpu":
        from rcbht_jax.encoding import gpu  # which is made of this module's functions

        if gpu.fits(config, wrench):
            run = partial(gpu.encode_where_gpu, config, _scan_whole)
    return run(lane_limits, wrench, length)


def _scan_whole(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> LabelTracks:
    """As :func:`encode`, by a scan; limits ``[4, lane]``."""
    trials, total, axes = wrench.shape
    lanes = jnp.swapaxes(wrench, 0, 1).reshape(total, trials * axes)
    empty = segments.varying_as(lanes, init((trials * axes,), wrench.dtype))
    state, tracks = scan_lanes(config, limits, empty, lanes, jnp.repeat(length, axes))
    joined = join_tracks(tracks, drain(config, state))
    return jax.tree.map(lambda leaf: leaf.reshape(trials, axes, leaf.shape[-1]), joined)


def scan_lanes(
    config: EncoderConfig,
    limits: Float[Array, "4 lane"],
    state: EncoderState,
    samples: Float[Array, "time lane"],
    count: Int[Array, " lane"],
) -> tuple[EncoderState, LabelTracks]:
    """Scan one piece of a recording per lane; pieces but the last must be multiples of the window.

    Args:
        config: static configuration.
        limits: of every lane, in the dtype of the samples.
        state: of the lanes.
        samples: N or Nm.
        count: samples that count; the last count % window of them are the partial window.

    Returns:
        the new state, and labels ``[lane, slot]`` with one slot per window.
    """
    window, lanes, count = config.window, samples.shape[1], count.astype(jnp.int32)
    samples, size = segments.whole_windows(samples, count, window)
    windows = len(size)
    full = jnp.swapaxes(samples.reshape(windows, window, lanes), 0, 1)
    x = segments.fit(full, size, limits[:, None], config.dt, jnp.zeros_like(size))  # the loop knows the time

    def body(state: EncoderState, row: tuple[Array, ...]) -> tuple[EncoderState, PackedLabels]:
        label, *values = row
        size = jnp.where(label > 0, jnp.minimum(end - state.time, window), 0)
        return _advance(config, state, Segment(label, state.time, state.time + size, *values), size)

    end = state.time + count
    state, out = jax.lax.scan(body, state, (x.label, x.vmax, x.vmin, x.area, x.rise))
    return state, unpack(jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), out))


def join_tracks(a: LabelTracks, b: LabelTracks) -> LabelTracks:
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y], axis=-1), a, b)


def _advance(config: EncoderConfig, state: EncoderState, x: Segment, count: Array) -> tuple[EncoderState, PackedLabels]:
    held, out = chain(config, unpack_segments(state.ints, state.reals), x)
    state = EncoderState(state.time + count, *pack_segments(held))
    return state, PackedLabels(*pack_segments(out), state.time)


def chain(config: EncoderConfig, held: Sequence[Segment], x: Segment) -> tuple[list[Segment], list[Segment]]:
    """A window's segment through pipe, composer, pipe, composer, pipe.

    Args:
        config: static configuration.
        held: the eight segments of the state, in its order.
        x: the window; an empty one changes nothing.

    Returns:
        the eight segments held afterwards and one published segment per layer.
    """
    pa, pb, hm, ma, mb, hl, la, lb = held
    pa, pb, p = pipe.push(pa, pb, x, config.rules(0))
    hm, m = composition.push_primitive(hm, p, config.gate, config.lead)
    ma, mb, m = pipe.push(ma, mb, m, config.rules(1))
    hl, l = composition.push_composition(hl, m, config.short)
    la, lb, l = pipe.push(la, lb, l, config.rules(2))
    return [pa, pb, hm, ma, mb, hl, la, lb], [p, m, l]


def drain(config: EncoderConfig, state: EncoderState) -> LabelTracks:
    """All held segments in order, each layer drained into the next: labels ``[*lanes, slot]``, 2, 5 and 8 slots."""

    def track(layer: Sequence[Segment]) -> LabelTrack:
        held = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), stack(layer))
        return track_of(held, jnp.broadcast_to(state.time[..., None], held.label.shape))

    return LabelTracks(*map(track, drain_segments(config, unpack_segments(state.ints, state.reals))))


Push = Callable[[Any, Segment], tuple[Any, Segment]]  # (held, arrival) -> (held, what leaves)
Pushes = Callable[[Push, Any, Sequence[Segment]], tuple[Any, list[Segment]]]  # the same for arrivals in order


def pushed_in_scan(push: Push, held: Any, arrivals: Sequence[Segment]) -> tuple[Any, list[Segment]]:
    """Arrivals one after the other, in a loop that is compiled once."""
    held, out = jax.lax.scan(push, held, stack(arrivals))
    return held, [jax.tree.map(lambda leaf, at=at: leaf[at], out) for at in range(len(arrivals))]


def drain_segments(
    config: EncoderConfig, held: Sequence[Segment], pushed: Pushes = pushed_in_scan
) -> tuple[list[Segment], list[Segment], list[Segment]]:
    """What the eight held segments still publish, per layer: 2, 5 and 8 segments in order of time, maybe empty."""
    pa, pb, hm, ma, mb, hl, la, lb = held
    push_primitive = partial(composition.push_primitive, gate=config.gate, lead=config.lead)
    push_composition = partial(composition.push_composition, short=config.short)

    def through_pipe(layer: int, a: Segment, b: Segment, arrivals: list[Segment]) -> list[Segment]:
        rules = config.rules(layer)

        def push(held: tuple[Segment, Segment], x: Segment) -> tuple[tuple[Segment, Segment], Segment]:
            a, b, out = pipe.push(*held, x, rules)
            return (a, b), out

        (a, b), out = pushed(push, (a, b), arrivals)
        return [*out, *pipe.drain(a, b, rules)]

    prims = list(pipe.drain(pa, pb, config.rules(0)))
    hm, out = pushed(push_primitive, hm, prims)
    mcs = through_pipe(1, ma, mb, [*out, composition.single_composition(hm)])
    hl, out = pushed(push_composition, hl, mcs)
    llbs = through_pipe(2, la, lb, [*out, composition.single_behaviour(hl, config.short)])
    return prims, mcs, llbs


def stack(parts: Sequence[Segment]) -> Segment:
    """Segments of the same lanes as one, along a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


def pack_segments(held: Sequence[Segment]) -> tuple[Array, Array]:
    ints = jnp.stack([leaf for x in held for leaf in (x.label, x.t0, x.t1)])
    reals = jnp.stack([leaf for x in held for leaf in (x.vmax, x.vmin, x.area, x.rise)])
    return ints, reals


def unpack_segments(ints: Array, reals: Array) -> list[Segment]:
    return [
        Segment(*(ints[_INTS * k + i] for i in range(_INTS)), *(reals[_REALS * k + i] for i in range(_REALS)))
        for k in range(ints.shape[0] // _INTS)
    ]


def track_of(x: Segment, emit: Array, divide: segments.Divide = division.quotient) -> LabelTrack:
    """Published form of segments: means instead of sums, zeros where empty.

    A mean beyond the extremes, as rounding makes of a very long word (:func:`rcbht_jax.encoding.pipe.merge`), becomes
    the nearer of them; the slope has no such bound.
    """
    samples = jnp.maximum(x.t1 - x.t0, 1).astype(x.area.dtype)
    avg, grad = divide(x.area, samples), divide(x.rise, samples)
    # Not by minima and maxima: where they are equal, those halve derivatives.
    avg = jnp.where(avg > x.vmax, x.vmax, jnp.where(avg < x.vmin, x.vmin, avg))
    track = LabelTrack(x.label.astype(jnp.int8), x.t0, x.t1, emit, x.vmax, x.vmin, avg, grad)
    return jax.tree.map(lambda leaf: jnp.where(x.label > 0, leaf, jnp.zeros_like(leaf)), track)
