"""Soft primitives of the fit rule: the runs of a rule that breaks by chance, as a function of limits and tolerance.

After each window the hard rule breaks its run where the saving exceeds ``tolerance^2 * needed``. Here it breaks with
the probability ``sigmoid(log(sqrt(saving / needed) / tolerance) / temperature)``, at the same place. A run is known by
its first sample alone, whatever happened before, so what is known of the present run is a distribution over its first
samples: candidates with weights, as many as ``init`` makes. Where a candidate breaks, its weight divides between
the old and the new first sample; equal first samples join; the lightest leave. A run that ends speaks for its samples
with its weight and a soft label.

Where no candidate leaves, this is the exact expectation over all sequences of breaks. Places of breaks and lines depend
on the samples alone, so that the result is smooth in limits and tolerance, but where a candidate leaves: there it jumps
by the weight of that candidate. At temperature 0 one candidate has all weight, and its runs are those of
:mod:`rcbht_jax.encoding.fit`. The samples are constants to the derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.encoding.fit import SHORTEST, FitConfig
from rcbht_jax.encoding.fit_line import Line, best_break, join, residuals_after, span_line
from rcbht_jax.encoding.segments import soft_windows, varying_as, whole_windows
from rcbht_jax.encoding.thresholds import by_lane
from rcbht_jax.errors import InputError
from rcbht_jax.labels import Primitive
from rcbht_jax.types import Array

CANDIDATES = 16


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SoftState:
    """What is known of the present run of every lane: first samples that it may have, and how likely they are."""

    time: Int[Array, "..."]  # int32 [*lanes], samples received
    start: Int[Array, "..."]  # int32 [candidate, *lanes], first sample of the run
    weight: Float[Array, "..."]  # [candidate, *lanes], probability; sums to 1
    line: Line  # [candidate, *lanes], of the run's samples that are not kept any longer
    recent: Float[Array, "..."]  # [kept, *lanes], last samples, among which breaks may still be found
    lost: Float[Array, "..."]  # [*lanes], sum over the windows of the weights of candidates that left


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SoftRuns:
    """Runs that ended, one for each candidate; a run that did not end has weight 0. Stacks of steps lead."""

    weight: Float[Array, "..."]  # [candidate, *lanes]
    t0: Int[Array, "..."]  # int32 [candidate, *lanes], first sample
    t1: Int[Array, "..."]  # int32 [candidate, *lanes], end
    label: Float[Array, "..."]  # [candidate, *lanes, 9], distribution over the primitives


def init(
    config: FitConfig,
    lanes: tuple[int, ...] = (6,),
    candidates: int = CANDIDATES,
    dtype: jax.typing.DTypeLike = jnp.float32,
) -> SoftState:
    """The state before the first sample.

    Raises:
        InputError: fewer than two candidates, which could not separate a run from its successor.
    """
    if candidates < 2:
        raise InputError(f"There are {candidates} candidates for the first sample of a run; at least two are needed.")
    whole, none = jnp.zeros((candidates, *lanes), dtype), jnp.zeros((candidates, *lanes), jnp.int32)
    recent, lost = jnp.zeros((config.kept, *lanes), dtype), jnp.zeros(lanes, dtype)
    return SoftState(jnp.zeros(lanes, jnp.int32), none, whole.at[0].set(1), Line(none, whole, whole), recent, lost)


def step(
    config: FitConfig,
    limits: Float[Array, "*axes 5"],
    state: SoftState,
    window: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
    temperature: Array | float,
) -> tuple[SoftState, SoftRuns]:
    """A window of ``count`` new samples; pure, and safe under ``jit``, ``vmap``, ``scan`` and ``grad``.

    Args:
        config: static configuration.
        limits: gradient limits and tolerance ``[axis, 5]`` or ``[*lanes, 5]``.
        state: of the same lanes.
        window: ``config.window`` samples, N and Nm.
        count: how many of them are there; fewer than a window at the end of the stream only, none after it.
        temperature: width of all decisions in the logarithm of a slope or a tolerance, > 0.

    Returns:
        the new state, of the same size, and the runs that may have ended.

    Raises:
        InputError: limits of other axes.

    Example:
        >>> limits, config = jnp.array([[70.0, 46.0, 23.0, 1.0, 0.1]]), FitConfig()
        >>> five = jnp.array([5])
        >>> state, runs = step(config, limits, init(config, (1,)), jnp.zeros((5, 1)), five, 0.1)
        >>> state, runs = step(config, limits, state, jnp.arange(5.0)[:, None], five, 0.1)
        >>> bool(runs.weight[0, 0] > 0.99), int(runs.t1[0, 0]), int(runs.label[0, 0].argmax()) + 1
        (True, 5, 7)
    """
    dtype, count = state.recent.dtype, count.astype(jnp.int32)
    samples, temperature = jnp.concatenate([state.recent, jnp.asarray(window, dtype)]), jnp.asarray(temperature, dtype)
    there, now, stop = count > 0, state.time + count, config.kept + count
    first = config.kept - (state.time[None] - state.start - state.line.count)  # own samples of each run begin there

    def wide(values: Array) -> Array:
        return jnp.broadcast_to(values[:, None], (values.shape[0], *state.start.shape))

    def each(values: Array) -> Array:
        return jnp.broadcast_to(values[None], state.start.shape)

    every = wide(samples)
    after = wide(residuals_after(samples, stop))
    found, saved = best_break(state.line, every, after, first, each(stop), SHORTEST)
    may = each(there) & (saved > 0)
    size = 0.5 * jnp.log(jnp.where(may, saved, 1) / config.needed)
    lane_limits = jnp.moveaxis(by_lane(limits, 5, state.time.shape, samples.dtype), 0, -1)
    chance = jnp.where(may, jax.nn.sigmoid((size - jnp.log(lane_limits[..., 4])[None]) / temperature), 0)

    leaves = each(jnp.where(there, jnp.where(count == config.window, config.window, stop), 0))
    ended = join(state.line, span_line(every, first, found))
    goes_on = join(state.line, span_line(every, first, leaves))
    begun = span_line(every, found, leaves)
    end = state.start + ended.count
    runs = SoftRuns(state.weight * chance, state.start, end, soft_primitive(config, lane_limits, ended, temperature))
    # Where there is no break, what would follow it is the run itself once more.
    after_break = jax.tree.map(lambda new, old: jnp.where(may, new, old), (end, begun), (state.start, goes_on))
    start, line = jax.tree.map(lambda *both: jnp.concatenate(both), (state.start, goes_on), after_break)
    weight = jnp.concatenate([state.weight * (1 - chance), state.weight * chance])
    start, weight, line, lost = _heaviest(start, weight, line, state.start.shape[0])
    recent = jnp.where(there[None], samples[config.window :], state.recent)
    return SoftState(now, start, weight, line, recent, state.lost + lost), runs


def drain(config: FitConfig, limits: Float[Array, "*axes 5"], state: SoftState, temperature: Array | float) -> SoftRuns:
    """The present run, as it would end with the last sample."""
    recent = jnp.broadcast_to(state.recent[:, None], (config.kept, *state.start.shape))
    temperature = jnp.asarray(temperature, recent.dtype)
    end = jnp.full_like(state.start, config.kept)
    line = join(state.line, span_line(recent, end - (state.time[None] - state.start - state.line.count), end))
    lane_limits = jnp.moveaxis(by_lane(limits, 5, state.time.shape, recent.dtype), 0, -1)
    stop = jnp.broadcast_to(state.time[None], state.start.shape)
    return SoftRuns(state.weight, state.start, stop, soft_primitive(config, lane_limits, line, temperature))


def soft_primitive(
    config: FitConfig, limits: Float[Array, "*lanes 5"], line: Line, temperature: Array | float
) -> Float[Array, "candidate *lanes 9"]:
    """Distribution over the primitives of runs with these lines; see :func:`rcbht_jax.encoding.segments.soft_windows`.

    Which runs are too long for an impulse is hard, because no limit decides it.
    """
    n, limits = line.count.astype(line.slope.dtype), limits[None]
    made = soft_windows(line.slope / config.dt, limits[..., :4], temperature)
    long = (line.count > round(config.impulse_below / config.dt))[..., None]
    impulse, big = (np.array([up, down]) - 1 for up, down in (
        (Primitive.PIMP, Primitive.NIMP), (Primitive.BPOS, Primitive.BNEG)))  # fmt: skip
    made = jnp.where(long, made.at[..., big].add(made[..., impulse]).at[..., impulse].set(0), made)
    # The line is level where its deviation, root mean square, is below the tolerance.
    size = jnp.abs(line.slope) * jnp.sqrt(jnp.maximum((n - 1) * (n + 1), 0)) / math.sqrt(12)
    least = float(np.finfo(size.dtype).tiny)
    distance = jnp.log(limits[..., 4]) - jnp.log(jnp.maximum(size, least))
    level = jax.nn.sigmoid(distance / temperature)[..., None]
    return (made * (1 - level)).at[..., Primitive.CONS - 1].add(level[..., 0])


def soft_primitives(
    config: FitConfig,
    limits: Float[Array, "lane 5"],
    samples: Float[Array, "time lane"],
    length: Int[Array, " lane"],
    temperature: Array | float,
    candidates: int = CANDIDATES,
) -> tuple[Float[Array, "lane time 9"], Float[Array, " lane"]]:
    """Distribution over the primitives at every sample of whole recordings, and the weight that was lost.

    Args:
        config: static configuration.
        limits: gradient limits and tolerance of every lane.
        samples: N or Nm, padded with anything finite.
        length: samples that count; all zeros beyond.
        temperature: see :func:`step`.
        candidates: first samples of the present run that are kept.

    Returns:
        distributions, and the sum of the weights of all candidates that left: where it is far below 1, more candidates
        would change nothing.
    """
    total, lanes = samples.shape
    samples = jax.lax.stop_gradient(samples)
    padded, counts = whole_windows(samples, length.astype(jnp.int32), config.window)

    def body(state: SoftState, row: tuple[Array, Array]) -> tuple[SoftState, SoftRuns]:
        return step(config, limits, state, *row, temperature)

    state = varying_as(samples, init(config, (lanes,), candidates, samples.dtype))
    rows = (padded.reshape(-1, config.window, lanes), counts)
    state, ended = jax.lax.scan(body, state, rows)
    last = drain(config, limits, state, temperature)
    runs: SoftRuns = jax.tree.map(lambda some, one: jnp.concatenate([some, one[None]]), ended, last)
    # A run adds its label at its first sample and takes it back at its end; sums over time give what is in force.
    weighted = runs.weight[..., None] * runs.label
    lane = jnp.broadcast_to(jnp.arange(lanes, dtype=jnp.int32)[None, None], runs.t0.shape)
    change = jnp.zeros((lanes, total + 1, weighted.shape[-1]), weighted.dtype)
    change = change.at[lane, runs.t0].add(weighted).at[lane, runs.t1].add(-weighted)
    here = jnp.maximum(jnp.cumsum(change, axis=1)[:, :total], 0)
    on = (jnp.arange(total, dtype=jnp.int32)[None] < length[:, None])[..., None]
    sums = here.sum(-1, keepdims=True)
    return jnp.where(on, here / jnp.where(on & (sums > 0), sums, 1), 0), state.lost


def _heaviest(start: Array, weight: Array, line: Line, count: int) -> tuple[Array, Array, Line, Array]:
    """The ``count`` heaviest of candidates, of which those with equal first samples have joined; the weight lost."""
    same = start[:, None] == start[None]
    number = jnp.arange(start.shape[0], dtype=jnp.int32)
    earlier = (number[None] < number[:, None]).reshape(start.shape[0], -1, *(1,) * (start.ndim - 1))
    joined = jnp.where((same & earlier).any(1), 0, jnp.where(same, weight[None], 0).sum(1))
    _, chosen = jax.lax.top_k(jnp.moveaxis(jax.lax.stop_gradient(joined), 0, -1), count)
    chosen = jnp.moveaxis(chosen, -1, 0).astype(jnp.int32)

    def pick(values: Array) -> Array:
        return jnp.take_along_axis(values, chosen, axis=0)

    kept = pick(joined)
    total = kept.sum(0)
    stays: Line = jax.tree.map(pick, line)
    return pick(start), kept / total[None], stays, jnp.maximum(1 - total, 0)
