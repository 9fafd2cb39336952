"""Soft labels: the streaming encoder as a differentiable function of its limits.

By the paper's rule the label of every window is soft, by sigmoid boundaries on the logarithm of its slope. A merged
segment has the mean distribution of those of its parts that carry its label: absorbed parts do not count. By the fit
rule the breaks between runs are soft as well (:mod:`rcbht_jax.encoding.soft_runs`); a run of the hard encoder has the
mean distribution of the soft runs over its samples.

Pairs of the tables are soft by both rules: the expected label of two soft partners. What stays hard is which segments
pair or merge, and by the paper's rule which windows form an item: the hard encoder decides that, and its decisions are
held fixed for the derivative.

So the soft labels tend to the hard ones as the temperature, which is positive, tends to 0. They are smooth wherever the
hard decisions do not change, and jump where they do. Gradients reach all limits of every axis; by the paper's rule the
wrench as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from rcbht_jax._util.compiling import full_precision
from rcbht_jax.encoding import composition, encoder, fit, segments, soft_runs
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, limit_values
from rcbht_jax.encoding.segments import gradient_label, soft_windows
from rcbht_jax.labels import LAYER_SIZES, LLB, MC, MC_PAIR, MC_SINGLE, PRIMITIVE_GROUP, Group
from rcbht_jax.types import Array, LabelTrack, Segment


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SoftLabels:
    """Distribution of the published label over time; all zeros beyond a recording.

    A cell of time is a window by the paper's rule and a sample by the fit rule, see :func:`cell`.
    """

    primitive: Float[Array, "trial axis cell 9"]
    mc: Float[Array, "trial axis cell 8"]
    llb: Float[Array, "trial axis cell 8"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Spans:
    """Items of one stage on the grid of windows; every field int32 ``[lane, window]``."""

    label: Array  # hard label of the segment over this window; 0 beyond the recording
    start: Array  # first window of the segment
    end: Array  # last window of the segment


def cell(config: AnyConfig) -> int:
    """Samples for which soft labels have one distribution: a window by the paper's rule, one by the fit rule."""
    return 1 if isinstance(config, FitConfig) else config.window


def soft_encode(
    config: AnyConfig,
    thresholds: AnyLimits | Float[Array, "axis 5"],
    wrench: Float[Array, "trial time axis"],
    length: Int[Array, " trial"],
    temperature: Array | float,
) -> SoftLabels:
    """Soft labels of whole recordings.

    Args:
        config: static configuration; its type chooses the rule.
        thresholds: limits ``[axis, 4]``; by the fit rule FitLimits, or their numbers ``[axis, 5]``, the tolerance last.
        wrench: N and Nm, padded with anything finite; its precision is that of the labels.
        length: samples that count.
        temperature: positive; see :func:`rcbht_jax.encoding.segments.soft_windows` and
            :mod:`rcbht_jax.encoding.soft_runs`.
    """
    trials, samples, axes = wrench.shape
    wrench, limits = segments.as_floating(wrench), limit_values(thresholds)
    temperature = jnp.asarray(temperature, wrench.dtype)
    lane_limits = jnp.broadcast_to(jnp.asarray(limits, wrench.dtype)[None], (trials, *limits.shape))
    lane_limits = lane_limits.reshape(trials * axes, limits.shape[1])
    if isinstance(config, FitConfig):
        lanes, count = jnp.swapaxes(wrench, 0, 1).reshape(samples, trials * axes), jnp.repeat(length, axes)
        hard = fit.scan_stages(config, lane_limits.T, lanes, count.astype(jnp.int32))
        stages = jax.lax.stop_gradient(tuple(_on_grid(stage, samples, 1) for stage in hard))
        p, _ = soft_runs.soft_primitives(config, lane_limits, lanes, count, temperature)
        parts = _vote(p, stages[0].label, stages[0])
    else:
        stages = jax.lax.stop_gradient(_hard_spans(config, limits, wrench, length))
        slope, counts = _slopes(config, wrench, length)
        soft = soft_windows(slope, lane_limits[:, None], temperature) * counts[..., None].astype(slope.dtype)
        voted = jnp.where(counts, gradient_label(slope, jnp.moveaxis(lane_limits[:, None], -1, 0)), 0)
        p = parts = _vote(soft, voted, stages[0])
    primitive, pairs, mc, joints, llb = stages
    with full_precision():
        m = _vote(_composition(parts, pairs, primitive), pairs.label, mc)
        l = _vote(_behaviour(m, joints, mc), joints.label, llb)
    return SoftLabels(*(x.reshape(trials, axes, *x.shape[1:]) for x in (p, m, l)))


def soft_shares(labels: SoftLabels, weights: Array) -> Array:
    """Share of each label in each sentence.

    Args:
        labels: of :func:`soft_encode`.
        weights: float ``[trial, sentence, cell]``, samples of the cell in the sentence (:func:`overlaps`).

    Returns:
        float ``[trial, sentence, axis * 25]``, in the order of :func:`rcbht_jax.calibration.objective.shares`.
    """
    parts = []
    for x in (labels.primitive, labels.mc, labels.llb):
        with full_precision():
            time = jnp.einsum("tsw,tawl->tsal", weights, x)
        parts.append(time / jnp.maximum(time.sum(-1, keepdims=True), 1))
    joined = jnp.concatenate(parts, -1)
    return joined.reshape(*joined.shape[:2], -1)


def overlaps(edges: Array, cells: int, size: int) -> Array:
    """Samples that cell and sentence share, float32 ``[trial, sentence, cell]``; edges int32 ``[trial, edge]``."""
    start = jnp.arange(cells, dtype=jnp.int32) * size
    first = jnp.maximum(edges[:, :-1, None], start[None, None])
    last = jnp.minimum(edges[:, 1:, None], start[None, None] + size)
    return jnp.maximum(last - first, 0).astype(jnp.float32)


def _slopes(config: EncoderConfig, wrench: Array, length: Array) -> tuple[Array, Array]:
    """Slope ``[lane, window]`` and whether the window counts."""
    short = -wrench.shape[1] % config.window
    padded = jnp.pad(wrench, ((0, 0), (0, short), (0, 0)))
    size, slope, _ = segments.window_lines(padded, length, config.window, config.dt)
    lanes = wrench.shape[0] * wrench.shape[2]
    size, slope = (jnp.moveaxis(each, 2, 1).reshape(lanes, -1) for each in (size, slope))
    # A window of fewer than two samples has no line; its value must not reach a derivative.
    return jnp.where(size >= 2, slope, 1), size >= 2


def _hard_spans(config: EncoderConfig, limits: Array, wrench: Array, length: Array) -> tuple[_Spans, ...]:
    """Primitives, pairs of them, compositions, pairs of them, behaviours: items of every stage."""
    trials, samples, axes = wrench.shape
    windows = -(-samples // config.window)
    tracks = encoder.encode(config, limits, wrench, length)

    def lanes(track: LabelTrack) -> Segment:
        flat = jax.tree.map(lambda leaf: leaf.reshape(trials * axes, -1).T, track)
        return Segment(flat.label.astype(jnp.int32), flat.t0, flat.t1, flat.vmax, flat.vmin, flat.avg, flat.grad)

    def append(spans: Segment, last: Segment) -> Segment:
        return jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), spans, last)

    push_primitive = partial(composition.push_primitive, gate=config.gate, lead=config.lead)
    push_composition = partial(composition.push_composition, short=config.short)
    p, m, l = (lanes(track) for track in (tracks.primitive, tracks.mc, tracks.llb))
    empty = jax.tree.map(lambda leaf: jnp.zeros_like(leaf[0]), p)
    held, pairs = jax.lax.scan(push_primitive, empty, p)
    pairs = append(pairs, composition.single_composition(held))
    held, joints = jax.lax.scan(push_composition, empty, m)
    joints = append(joints, composition.single_behaviour(held, config.short))
    return tuple(_on_grid(stage, windows, config.window) for stage in (p, pairs, m, joints, l))


def _on_grid(spans: Segment, windows: int, window: int) -> _Spans:
    """Items ``[slot, lane]`` that follow one another, spread over the windows they cover."""
    lane = jnp.broadcast_to(jnp.arange(spans.label.shape[1], dtype=jnp.int32)[None], spans.label.shape)

    def mark(place: Array, value: Array) -> Array:
        index = jnp.where(spans.label > 0, place, windows)  # beyond the grid: dropped
        return jnp.zeros((spans.label.shape[1], windows), jnp.int32).at[lane, index].set(value, mode="drop")

    first = spans.t0 // window
    last = (spans.t1 - 1) // window
    start = jax.lax.cummax(mark(first, first), axis=1)
    end = windows - 1 - jax.lax.cummax(mark(last, windows - 1 - last), axis=1, reverse=True)
    label = jnp.take_along_axis(mark(first, spans.label), start, axis=1)
    # Beyond the last item the grid would repeat it.
    final = jnp.max(jnp.where(spans.label > 0, last, -1), axis=0)[:, None]
    return _Spans(jnp.where(jnp.arange(windows, dtype=jnp.int32)[None] <= final, label, 0), start, end)


def _vote(soft: Array, voted: Array, spans: _Spans) -> Array:
    """Distribution of each segment: the mean over those of its windows whose part has the item's own label."""
    lanes, windows, _ = soft.shape
    core = ((voted == spans.label) & (spans.label > 0)).astype(soft.dtype)[..., None]
    segment = (jnp.arange(lanes, dtype=jnp.int32)[:, None] * windows + spans.start).reshape(-1)

    def total(x: Array) -> Array:
        sums = jax.ops.segment_sum(x.reshape(lanes * windows, -1), segment, lanes * windows)
        return sums[segment].reshape(lanes, windows, -1)

    on = (spans.label > 0)[..., None]
    return jnp.where(on, total(soft * core) / jnp.maximum(total(core), 1), 0)


def _partners(x: Array, pairs: _Spans, parts: _Spans) -> tuple[Array, Array, Array]:
    """Distributions of the first and the last part of every segment, and whether it has only one part."""
    first = jnp.take_along_axis(x, pairs.start[..., None], axis=1)
    second = jnp.take_along_axis(x, pairs.end[..., None], axis=1)
    alone = jnp.take_along_axis(parts.end, pairs.start, axis=1) >= pairs.end
    return first, second, alone[..., None]


def _composition(p: Array, pairs: _Spans, parts: _Spans) -> Array:
    """Expected composition ``[lane, window, 8]`` of soft partners (pair table of section III-B)."""
    group = jax.nn.one_hot(jnp.asarray(PRIMITIVE_GROUP[1:]), len(Group), dtype=p.dtype)
    table = jax.nn.one_hot(jnp.asarray(MC_PAIR) - 1, LAYER_SIZES[1], dtype=p.dtype)
    single = jax.nn.one_hot(jnp.asarray(MC_SINGLE) - 1, LAYER_SIZES[1], dtype=p.dtype)
    first, second, alone = _partners(p @ group, pairs, parts)
    return jnp.where(alone, first @ single, jnp.einsum("nwi,nwj,ijk->nwk", first, second, table))


def _behaviour(m: Array, joints: _Spans, parts: _Spans) -> Array:
    """Expected behaviour ``[lane, window, 8]``: two partners agree on what they are, or each speaks for itself.

    Whether a single one is noise and whether an adjustment grows depend on durations and amplitudes: hard.
    """
    first, second, alone = _partners(m, joints, parts)
    kinds = [MC.A, MC.I, MC.D, MC.K]

    def plain(a: Array, s: Array, l: Array, k: Array, contact: Array, unstable: Array) -> Array:
        grows = (joints.label == LLB.SH)[..., None]
        none = jnp.zeros_like(a)
        return jnp.concatenate(
            [k, contact, s, l, jnp.where(grows, none, a), jnp.where(grows, a, none), none, unstable], axis=-1
        )

    def alike(x: Array) -> tuple[Array, ...]:
        contact = x[..., MC.PC - 1 : MC.C].sum(-1, keepdims=True)
        return (*(x[..., kind - 1 : kind] for kind in kinds), contact, x[..., MC.U - 1 :])

    both = [a * b for a, b in zip(alike(first), alike(second), strict=True)]
    agreed = plain(*both)
    rest = 1 - agreed.sum(-1, keepdims=True)
    apart = (plain(*alike(first)) + plain(*alike(second))) / 2
    pair = agreed + rest * apart
    noise = jax.nn.one_hot(LLB.N - 1, LAYER_SIZES[2], dtype=m.dtype)
    quiet = (joints.label == LLB.N)[..., None]
    return jnp.where(alone, jnp.where(quiet, noise[None, None], plain(*alike(first))), pair)
