"""Words that fit the signal: runs of windows that one straight line explains, named when they end.

Specified in docs/fit_rule.md. :func:`init`, :func:`step` and :func:`flush` are pure and loop-free, safe under ``jit``,
``vmap`` and ``scan``; lanes (axes, arms, trials) are trailing batch dimensions. Containers and compositions are of
:mod:`rcbht_jax.encoding.encoder`. Streaming and batch results are equal bit for bit; the state has a fixed size.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from rcbht_jax.encoding import composition, division, encoder, pipe
from rcbht_jax.encoding.choices import check_choices, make_plain
from rcbht_jax.encoding.encoder import EncoderState, PackedLabels, pack_segments, unpack, unpack_segments
from rcbht_jax.encoding.fit_line import Line, best_break, join, residuals_after, span_line
from rcbht_jax.encoding.segments import gradient_label, varying_as, whole_windows
from rcbht_jax.encoding.thresholds import by_lane
from rcbht_jax.errors import InputError
from rcbht_jax.labels import MC, Primitive
from rcbht_jax.types import Array, LabelTracks, Segment

_ABOVE = 4  # segments held above the run: composer and accumulator of compositions, the same of behaviours
_RUN_INTS, _RUN_REALS = 3, 2  # t0, t1, samples of the line; its mean and slope, before those that are still kept
_INTS, REALS = _RUN_INTS + 3 * _ABOVE, _RUN_REALS + 4 * _ABOVE
SHORTEST = 2  # samples of a word
LONGEST = 1000  # windows of a lookback: each window is compared with as many, and more take minutes to compile
Rounds = list[list[Segment]]  # the outputs of the five stages in each step of a drain


@dataclass(frozen=True)
class FitConfig:
    """Static choices of the fit rule (hashable: one compilation each).

    Attributes:
        window: samples per straight-line fit, >= 2.
        dt: seconds between samples.
        gate: pair primitives only if amplitudes agree within a factor of 2 and durations within a factor of 5.
        adj_exempt: keep repeated adjustments separate, so that alignments and shifts can be distinguished.
        contact_first: impulses are never the second of a pair that another primitive begins.
        latency_cap: time in s after which a composition or behaviour waits no longer for its successor; None = none.
        impulse_below: a steep run longer than this many seconds is a big gradient, not an impulse.
        noise_below: single compositions shorter than this many seconds become noise.
        lead_below: a primitive longer than this many seconds does not pair with an impulse after it; None = all do.
        evidence: seconds for which a line must be off by one tolerance (or half as long by 1.4 tolerances) to break.
        lookback: seconds back from now within which a break may still be found, 2 to 1000 windows.

    Raises:
        InputError: a value is of another type or out of range.

    Example:
        >>> FitConfig(window=20, dt=0.001).short  # samples in 0.1 s
        100
    """

    window: int = 5
    dt: float = 0.005
    gate: bool = True
    adj_exempt: bool = True
    contact_first: bool = False
    latency_cap: float | None = 0.2
    impulse_below: float = 0.2
    noise_below: float = 0.1
    lead_below: float | None = 0.2
    evidence: float = 0.025
    lookback: float = 0.05

    def __post_init__(self) -> None:
        make_plain(self)
        seconds = "latency_cap", "noise_below", "lead_below", "lookback", "evidence", "impulse_below"
        check_choices(self.window, self.dt, **{name: getattr(self, name) for name in seconds})
        if wrong := [f"{name} is {getattr(self, name)} s" for name in seconds[3:] if not getattr(self, name) > 0]:
            raise InputError(f"{'; '.join(wrong)}; expected a positive time.")
        if self.kept >= LONGEST * self.window:
            raise InputError(
                f"The lookback is {self.lookback} s, which is more than {LONGEST} windows of {self.window} samples; "
                "choose a larger window, or a shorter lookback."
            )

    @property
    def needed(self) -> int:
        """Squared tolerances that two lines in place of one must save."""
        return max(SHORTEST, round(self.evidence / self.dt))

    @property
    def kept(self) -> int:
        """Samples before the present window among which a break may still be found; whole windows."""
        return self.window * (max(2, math.ceil(self.lookback / self.dt / self.window - 1e-6)) - 1)

    @property
    def short(self) -> int:
        """Samples below which a single composition is noise."""
        return round(self.noise_below / self.dt)

    @property
    def lead(self) -> int | None:
        """Samples of the longest primitive that pairs with an impulse after it."""
        return 0 if self.contact_first else None if self.lead_below is None else round(self.lead_below / self.dt)

    @property
    def cap(self) -> int | None:
        """Samples that a word waits for its successor."""
        return None if self.latency_cap is None else round(self.latency_cap / self.dt)


def init(config: FitConfig, lanes: tuple[int, ...] = (6,), dtype: jax.typing.DTypeLike = jnp.float32) -> EncoderState:
    """The empty state for ``lanes``, for example ``(6,)`` or ``(trials, 6)``; dtype float32 or float64."""
    reals = jnp.zeros((REALS + config.kept, *lanes), dtype)
    return EncoderState(jnp.zeros(lanes, jnp.int32), jnp.zeros((_INTS, *lanes), jnp.int32), reals)


def step(
    config: FitConfig,
    limits: Float[Array, "*axes 5"],
    state: EncoderState,
    window: Float[Array, " window *lanes"],
) -> tuple[EncoderState, PackedLabels]:
    """One full window of samples for every lane; results and errors as of :func:`rcbht_jax.encoding.encoder.step`.

    Args:
        config: static configuration.
        limits: gradient limits and tolerance ``[axis, 5]`` or ``[*lanes, 5]``, of
            :meth:`rcbht_jax.encoding.tolerance.FitLimits.stacked`.
        state: of the same lanes, the last of which are the axes.
        window: ``config.window`` samples, N and Nm; they are taken in the precision of the state.

    Example:
        >>> limits = jnp.array([[70.0, 46.0, 23.0, 1.0, 0.1]])
        >>> state, packed = step(FitConfig(), limits, init(FitConfig(), (1,)), jnp.zeros((5, 1)))
        >>> state, packed = step(FitConfig(), limits, state, jnp.arange(5.0)[:, None])  # the constant run ends
        >>> unpack(packed).primitive.label.tolist(), unpack(packed).primitive.t1.tolist()
        ([7], [5])
    """
    return step_partial(config, limits, state, window, jnp.full_like(state.time, config.window))


def step_partial(
    config: FitConfig,
    limits: Float[Array, "*axes 5"],
    state: EncoderState,
    window: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
) -> tuple[EncoderState, PackedLabels]:
    """As :func:`step`, for a window whose first ``count`` samples are there."""
    if window.shape[0] != config.window:
        raise InputError(f"The window has {window.shape[0]} samples; this encoder takes {config.window} at a time.")
    count, samples = count.astype(jnp.int32), jnp.concatenate([state.reals[REALS:], window.astype(state.reals.dtype)])
    after = residuals_after(samples, config.kept + count)
    state, out = advance(config, by_lane(limits, 5, state.time.shape, samples.dtype), state, samples, after, count)
    return state, _published(out, state.time)


def flush(
    config: FitConfig,
    limits: Float[Array, "*axes 5"],
    state: EncoderState,
    rest: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
) -> LabelTracks:
    """End of the stream: the last partial window, then all that is still held.

    The state stays as it is; for a stream that goes on see :mod:`rcbht_jax.encoding.provisional`.

    Args:
        config, limits, state: as of :func:`step`, which also has the errors.
        rest: the samples that did not fill a window, then anything.
        count: how many of them there are, < window.

    Returns:
        labels ``[*lanes, slot]`` with 1 + 5 slots: the window's, then the drained ones.
    """
    state, out = step_partial(config, limits, state, rest, count)
    first = jax.tree.map(lambda leaf: leaf[..., None], unpack(out))
    return encoder.join_tracks(first, drain(config, by_lane(limits, 5, state.time.shape, state.reals.dtype), state))


def scan_lanes(
    config: FitConfig,
    limits: Float[Array, "5 lane"],
    state: EncoderState,
    samples: Float[Array, "time lane"],
    count: Int[Array, " lane"],
) -> tuple[EncoderState, LabelTracks]:
    """As :func:`rcbht_jax.encoding.encoder.scan_lanes`."""
    state, out = _scan(config, limits, state, samples, count, _published)
    return state, unpack(jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), out))


def scan_stages(
    config: FitConfig, limits: Float[Array, "5 lane"], samples: Float[Array, "time lane"], count: Int[Array, " lane"]
) -> tuple[Segment, ...]:
    """Outputs of every stage for whole recordings: primitives, their pairs, compositions, their pairs, behaviours.

    Arguments as of :func:`scan_lanes`; segments ``[slot, lane]`` in order of time, unused ones with the label 0.
    """
    state = varying_as(samples, init(config, (samples.shape[1],), samples.dtype))
    state, out = _scan(config, limits, state, samples, count, lambda stages, _: tuple(stages))
    rest = stacked(drain_stages(config, limits, state), 0)
    return tuple(jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *both) for both in zip(out, rest, strict=True))


def _scan(
    config: FitConfig, limits: Array, state: EncoderState, samples: Array, count: Array, kept_of: Callable[..., Any]
) -> tuple[EncoderState, Any]:
    """A scan over windows; ``kept_of`` chooses what to stack of the outputs of the five stages and of the time."""
    window, kept = config.window, config.kept
    samples, counts = whole_windows(samples, count.astype(jnp.int32), window)
    windows = len(counts)
    # Every window with the samples before it; what follows a break does not depend on the state.
    line = jnp.concatenate([state.reals[REALS:], samples])
    blocks = line.reshape(-1, window, *line.shape[1:])
    seen = jnp.concatenate([blocks[at : at + windows] for at in range(kept // window + 1)], axis=1).swapaxes(0, 1)
    after = residuals_after(seen, kept + counts)

    def seen_by(number: Array | int) -> tuple[Array, Array]:
        here = jax.lax.dynamic_slice_in_dim(line, number * window, kept + window)
        return here, jax.lax.dynamic_index_in_dim(after, number, axis=1, keepdims=False)

    def body(carry: tuple[EncoderState, tuple[Array, Array]], row: tuple[Array, Array]) -> tuple[Any, Any]:
        state, out = advance(config, limits, carry[0], *carry[1], row[1])
        return (state, seen_by(row[0])), kept_of(out, state.time)

    # Carried from the step before: a compiler does not vectorize loops that read from a place that they look up.
    following = jnp.arange(1, windows + 1, dtype=jnp.int32)
    (state, _), out = jax.lax.scan(body, (state, seen_by(0)), (following, counts))
    return state, out


def drain(config: FitConfig, limits: Float[Array, "5 *lanes"], state: EncoderState) -> LabelTracks:
    """The run, then all held words, each layer drained into the next: labels ``[*lanes, 5]``."""
    return tracks_of([stages[::2] for stages in drain_stages(config, limits, state)], state.time)


def tracks_of(rounds: Rounds, now: Array) -> LabelTracks:
    """The three layers of each step of a drain as labels ``[*lanes, step]``."""
    emit = jnp.broadcast_to(now[..., None], (*now.shape, len(rounds)))
    return LabelTracks(*(encoder.track_of(x, emit, division.exact) for x in stacked(rounds, -1)))


def drain_stages(config: FitConfig, limits: Array, state: EncoderState, last: Segment | None = None) -> Rounds:
    """A drain in steps, whose last primitive is that of the run if none is given."""
    t0, t1, line, held = running(config, state)
    arrival = pipe.keep(t1 > t0, primitive_of(config, limits, t0, t1, line) if last is None else last)
    rounds = []
    for number in range(1 + _ABOVE):  # the run, then each of the held segments in turn
        held, out = _above(config, held, arrival, state.time, force=number)
        arrival = pipe.keep(jnp.zeros_like(t0, bool), arrival)
        rounds.append(out)
    return rounds


def stacked(rounds: Rounds, axis: int) -> list[Segment]:
    """The segments of each stage, from those of each step."""
    return [jax.tree.map(lambda *leaves: jnp.stack(leaves, axis), *stage) for stage in zip(*rounds, strict=True)]


def _published(stages: list[Segment], now: Array) -> PackedLabels:
    """The layers among five stages: accumulators publish, composers do not."""
    return PackedLabels(*pack_segments(stages[::2]), now)


def opened(state: EncoderState) -> tuple[Array, Array, Line, list[Segment]]:
    """First sample and end of the run, the line of its samples that are not kept any more, the segments above it."""
    t0, t1, count = state.ints[:_RUN_INTS]
    line = Line(count, *state.reals[:_RUN_REALS])
    return t0, t1, line, unpack_segments(state.ints[_RUN_INTS:], state.reals[_RUN_REALS:REALS])


def running(config: FitConfig, state: EncoderState) -> tuple[Array, Array, Line, list[Segment]]:
    """As :func:`opened`, with the line through all samples of the run."""
    t0, t1, line, held = opened(state)
    end = jnp.full_like(t0, config.kept)
    return t0, t1, join(line, span_line(state.reals[REALS:], end - (t1 - t0 - line.count), end)), held


def advance(
    config: FitConfig, limits: Array, state: EncoderState, samples: Array, after: Array, count: Array
) -> tuple[EncoderState, list[Segment]]:
    """State and each stage's output after ``count`` new samples: the run goes on, or ends at the break that saves most.

    Limits are ``[5, *lanes]``; ``samples`` are those that are kept, then the window, and ``after`` their residuals
    (:func:`residuals_after`), ``[kept + window, *lanes]``. Only at the end of a stream are fewer than a window new.
    """
    kept, window = config.kept, config.window
    t0, t1, line, held = opened(state)
    count = jnp.where(state.time < 0, 0, count)  # never negative, but no compiler knows: no constant
    now, there = state.time + count, count > 0
    start, stop = kept - (t1 - t0 - line.count), kept + count  # the run's own samples among these
    found, saved = best_break(line, samples, after, start, stop, SHORTEST)
    breaks = there & (saved > limits[4] * limits[4] * config.needed)
    word = pipe.once(pipe.packed(there, breaks) + 4 * found, now)
    there, breaks, found = word & 1 > 0, word >> 1 & 1 > 0, word >> 2
    leaves = jnp.where(there, jnp.where(count == window, window, stop), 0)  # samples that are not kept any longer
    joint = join(line, span_line(samples, start, jnp.where(breaks, found, leaves)))
    joint = Line(joint.count, pipe.settled(joint.mean, now), pipe.settled(joint.slope, now))
    fresh = span_line(samples, found, leaves)
    ended = pipe.keep(breaks, primitive_of(config, limits, t0, t0 + joint.count, joint))
    ended = pipe.relabel(ended, pipe.once(ended.label, now))
    held, out = _above(config, held, ended, jnp.where(there, now, 0))  # nothing is late where no time passes
    run: Line = jax.tree.map(lambda new, old: jnp.where(breaks, new, old), fresh, joint)
    ints, reals = pack_segments(held)
    ints = jnp.concatenate([jnp.stack([t0 + jnp.where(breaks, joint.count, 0), now, run.count]), ints])
    recent = jnp.where(there, samples[window:], state.reals[REALS:])
    return EncoderState(now, ints, jnp.concatenate([jnp.stack([run.mean, run.slope]), reals, recent])), out


def primitive_of(config: FitConfig, limits: Array, t0: Array, t1: Array, line: Line) -> Segment:
    """The labelled segment of a run."""
    n = jnp.maximum(line.count, 1).astype(line.mean.dtype)
    slope = division.fenced(line.slope * (1 / config.dt))
    label = gradient_label(slope, limits[:4])
    long = line.count > round(config.impulse_below / config.dt)
    label = jnp.where(long & (label == Primitive.PIMP), jnp.int32(Primitive.BPOS), label)
    label = jnp.where(long & (label == Primitive.NIMP), jnp.int32(Primitive.BNEG), label)
    level = line.slope * line.slope * ((n - 1) * (n + 1)) <= 12 * limits[4] * limits[4]
    label = jnp.where(level, jnp.int32(Primitive.CONS), label)
    half = division.fenced(jnp.abs(line.slope) * (n - 1) * 0.5)
    return Segment(label, t0, t1, line.mean + half, line.mean - half, *map(division.fenced, (line.mean * n, slope * n)))


def _above(
    config: FitConfig, held: list[Segment], x: Segment, now: Array, force: int | None = None
) -> tuple[list[Segment], list[Segment]]:
    """A primitive, or none, through both composers and accumulators: what these hold, and what the five stages give.

    With ``force``, at the end of the stream, nothing is late; number 1 to 4 of the held segments leaves.
    """
    hm, bm, hl, bl = held

    def late(h: Segment, number: int) -> Array:
        if force is not None or config.cap is None:  # without a cap none is late
            return jnp.full_like(h.label, force == number, bool)
        return now - h.t1 > config.cap

    hm, pair = _overdue(now, late(hm, 1), composition.single_composition(hm), x,
                        *composition.push_primitive(hm, x, config.gate, config.lead))  # fmt: skip
    bm, m = _accumulate(now, late(bm, 2), bm, pair, int(MC.A) if config.adj_exempt else None)
    hl, joint = _overdue(now, late(hl, 3), composition.single_behaviour(hl, config.short), m,
                         *composition.push_composition(hl, m, config.short))  # fmt: skip
    bl, l = _accumulate(now, late(bl, 4), bl, joint, None)
    return [hm, bm, hl, bl], [x, pair, m, joint, l]


def _overdue(now: Array, late: Array, alone: Segment, x: Segment, h: Segment, out: Segment) -> tuple[Segment, Segment]:
    """State and output of a composer, in which a late word no longer waits for a partner."""
    leaves = late & (x.label == 0) & (alone.label > 0)
    word = pipe.once(pipe.packed(leaves) + 2 * jnp.where(leaves, alone.label, out.label), now)
    leaves = word & 1 > 0
    return pipe.keep(~leaves, h), pipe.relabel(pipe.select(leaves, alone, out), word >> 1)


def _accumulate(now: Array, late: Array, b: Segment, x: Segment, exempt: int | None) -> tuple[Segment, Segment]:
    """Equal neighbours merge, but for an exempt label; a word leaves when another one arrives, or late."""
    arrived = x.label > 0
    same = arrived & (x.label == b.label) & (True if exempt is None else x.label != exempt)
    leaves = jnp.where(arrived, ~same, late) & (b.label > 0)
    word = pipe.once(pipe.packed(arrived, same, leaves), now)
    arrived, same, leaves = (word >> bit & 1 > 0 for bit in range(3))
    new = pipe.select(arrived, x, pipe.keep(~leaves, b))
    return pipe.select(same, pipe.merge(b, x, b.label), new), pipe.keep(leaves, b)
