"""Provisional labels of the fit rule: what words that still run are called before anybody knows how they end.

A run that has just begun is short, so that a level nearly always explains it, and most compositions of it would be
noise if it ended now. It does not end now. :func:`labels` therefore names what the run will be when it has gone on, as
its newest samples do, for as long as evidence for a break is missing: ``FitConfig.evidence``, less what there is.
The primitive of a young run looks further ahead, to the age of ``LASTS``, unless a break already gathers evidence.
Labels and pairs look ahead; spans and values end with the samples received. Published labels do not depend on this.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from rcbht_jax.encoding import fit, pipe
from rcbht_jax.encoding.division import fenced, quotient
from rcbht_jax.encoding.encoder import EncoderState, join_tracks, unpack
from rcbht_jax.encoding.fit import FitConfig, primitive_of
from rcbht_jax.encoding.fit_line import Line, best_break, join, residuals_after, span_line
from rcbht_jax.encoding.thresholds import by_lane
from rcbht_jax.types import Array, LabelTracks, Segment

LASTS = 0.11  # seconds that a run is expected to last; this and the next chosen on the even trials of session A
DOUBTED = 0.25  # share of the evidence for a break from which on a run is not expected to last


def labels(
    config: FitConfig,
    limits: Float[Array, "*axes 5"],
    state: EncoderState,
    rest: Float[Array, " window *lanes"],
    count: Int[Array, "*lanes"],
) -> LabelTracks:
    """Provisional labels of a stream that goes on, with arguments and shapes of :func:`rcbht_jax.encoding.fit.flush`.

    Example:
        >>> config, limits = FitConfig(), jnp.array([[70.0, 46.0, 23.0, 1.0, 0.1]])
        >>> state, _ = fit.step(config, limits, fit.init(config, (1,)), 0.05 * jnp.arange(5.0)[:, None])
        >>> none = jnp.zeros((5, 1)), jnp.array([0])  # 10 N/s for 25 ms: still level within the tolerance
        >>> [int(f(config, limits, state, *none).primitive.label[0, 1]) for f in (fit.flush, labels)]
        [7, 3]
    """
    samples = jnp.concatenate([state.reals[fit.REALS :], jnp.asarray(rest, state.reals.dtype)])
    lanes, count = by_lane(limits, 5, state.time.shape, samples.dtype), count.astype(jnp.int32)
    saved = _saved(lanes[4], state, samples, config.kept, count)
    state, out = fit.step_partial(config, limits, state, rest, count)
    first = jax.tree.map(lambda leaf: leaf[..., None], unpack(out))
    t0, t1, line, held = fit.running(config, state)
    saved = jnp.where(first.primitive.label[..., 0] > 0, 0.0, saved)  # the rest began a new run

    def later(more: Array) -> Segment:
        missing = jnp.round(more).astype(jnp.int32)
        ahead = _ahead(config, line, samples, config.kept + count, missing)
        return primitive_of(config, lanes, t0, t1 + missing, join(line, ahead))

    missing, lasts = jnp.maximum(config.needed - saved, 0), round(LASTS / config.dt)
    trust = jnp.maximum(1 - fenced(saved * (1 / (DOUBTED * config.needed))), 0)
    young = (lasts - line.count).astype(trust.dtype) * trust
    rounds = [stages[::2] for stages in fit.drain_stages(config, lanes, state, later(missing))]
    rounds[0][0] = pipe.keep(t1 > t0, later(jnp.where(line.count < lasts, young, missing)))
    parts = [*held, primitive_of(config, lanes, t0, t1, line)]
    rounds = [[_so_far(word, parts, state.time) for word in layers] for layers in rounds]
    return join_tracks(first, fit.tracks_of(rounds, state.time))


def _saved(tolerance: Array, state: EncoderState, samples: Array, kept: int, count: Array) -> Array:
    """What the best break of the run would save, in squared tolerances."""
    t0, t1, line, _ = fit.opened(state)
    start, stop = kept - (t1 - t0 - line.count), kept + count
    _, saved = best_break(line, samples, residuals_after(samples, stop), start, stop, fit.SHORTEST)
    return quotient(saved, tolerance * tolerance)


def _ahead(config: FitConfig, line: Line, samples: Array, stop: Array, count: Array) -> Line:
    """The line of the next samples, if they go on as the newest of the run do, of as many as the evidence takes."""
    recent = min(config.needed, config.kept)
    new = span_line(samples, stop - jnp.minimum(recent, line.count), stop)
    half = (new.count + count).astype(new.mean.dtype) / 2
    return Line(count, new.mean + fenced(new.slope * half), new.slope)


def _so_far(word: Segment, parts: list[Segment], now: Array) -> Segment:
    """A word of the run with the values of its samples up to now, from the held segments and the run, in order."""
    *held, whole = parts
    for part in held:  # from the newest to the oldest
        whole = pipe.select((part.label > 0) & (part.t0 >= word.t0), pipe.merge(part, whole, whole.label), whole)
    return pipe.select(word.t1 > now, pipe.relabel(whole, word.label), word)
