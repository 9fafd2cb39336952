"""The streaming chain over recordings: what would have been known at each sample, without the future.

One *tick* is what a stream does when it is asked: the samples of the current window, all or only the first few of
them, go through the encoder; a complete window changes the state for good, an incomplete one only for this answer.
:class:`rcbht_jax.introspection.introspector.Introspector` makes the same ticks one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState, PackedLabels, drain, init, step_partial, unpack
from rcbht_jax.encoding.thresholds import GradientThresholds
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import (
    RunningStats,
    add,
    check_online,
    describe_interval,
    empty,
    grow,
    names,
    restart,
    stack_words,
)
from rcbht_jax.types import Array

_TICKS = 512  # per compiled scan, whatever the length of the recording


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StreamState:
    """What a stream remembers, whatever its length."""

    encoder: EncoderState
    tallies: tuple[RunningStats, ...]  # one per kind of sentence, for example the sub-task and the whole trial


@dataclass(frozen=True)
class FeatureView:
    """What may be looked at."""

    spec: FeatureSpec
    provisional: bool = True  # also words not yet published, as ``peek`` would say them


def begin_stream(sights: tuple[FeatureView, ...]) -> StreamState:
    """The state before the first sample."""
    return StreamState(init((6,)), tuple(empty(sight.spec, jnp.int32(0)) for sight in sights))


def step(
    config: EncoderConfig,
    sights: tuple[FeatureView, ...],
    limits: Array,
    progress: StreamState,
    window: Array,
    count: Array,
    begins: Array,
) -> tuple[StreamState, tuple[Array, ...], PackedLabels]:
    """One look at the stream.

    Args:
        config: of the encoder.
        sights: kinds of sentences and how each is described.
        limits: float32 ``[6, 4]``.
        progress: so far, at the end of the last complete window.
        window: float32 ``[config.window, 6]``, the samples since then, then anything.
        count: int32 ``[]``, how many of them there are.
        begins: int32 ``[sight]``, sample at which the present sentence of each kind begins.

    Returns:
        the new state (the same unless the window is complete), the features ``[feature]`` of each sentence, and
        the labels that the window published, packed, none unless it is complete.
    """
    counts = jnp.broadcast_to(count, progress.encoder.time.shape)
    after, out = step_partial(config, limits, progress.encoder, window, counts)
    said, held = unpack(out), drain(config, after)
    complete = count == config.window
    now = progress.encoder.time[0] + count
    slot = jax.tree.map(lambda leaf: leaf[:, None], said)
    tallies, described = [], []
    for sight, old, begin in zip(sights, progress.tallies, begins, strict=True):
        tally = grow(config.dt, restart(sight.spec, old, begin), now, config.window)
        new = add(sight.spec, config.dt, tally, stack_words(sight.spec, slot))
        kept = jax.tree.map(lambda a, b: jnp.where(complete, a, b), new, tally)
        seen = add(sight.spec, config.dt, new, stack_words(sight.spec, held)) if sight.provisional else kept
        described.append(describe_interval(sight.spec, config.dt, seen, now))
        tallies.append(kept)
    encoder = jax.tree.map(lambda a, b: jnp.where(complete, a, b), after, progress.encoder)
    published = jax.tree.map(lambda leaf: jnp.where(complete, leaf, jnp.zeros_like(leaf)), out)
    return StreamState(encoder, tuple(tallies)), tuple(described), published


@partial(jax.jit, static_argnums=(0, 1))
def _scan(
    config: EncoderConfig, sight: FeatureView, limits: Array, progress: StreamState, rows: tuple[Array, ...]
) -> tuple[StreamState, Array]:
    def body(progress: StreamState, row: tuple[Array, ...]) -> tuple[StreamState, Array]:
        progress, described, _ = step(config, (sight,), limits, progress, *row)
        return progress, described[0]

    return jax.lax.scan(body, progress, rows)


def online_features(
    config: EncoderConfig,
    thresholds: GradientThresholds,
    sight: FeatureView,
    wrench: NDArray[np.float32],
    begin: NDArray[np.int64],
    now: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Features of one recording's sentences as they stood at some samples.

    Args:
        config: of the encoder.
        thresholds: limits ``[6, 4]``.
        sight: how a sentence is described.
        wrench: ``[time, 6]``.
        begin: ``[look]`` first sample of the sentence, increasing.
        now: ``[look]`` samples received when the look is taken, increasing, > begin.

    Returns:
        ``[look, feature]``.

    Raises:
        InputError: the samples asked for are not in order or not in the recording.
    """
    check_online(sight.spec)
    _check(wrench, begin, now)
    rows, wanted = _schedule(config.window, wrench, begin, now)
    limits = jnp.asarray(np.asarray(thresholds.limits), jnp.float32)
    progress = begin_stream((sight,))
    out = np.empty((len(now), len(names(sight.spec))), np.float32)
    for start in range(0, len(rows[1]), _TICKS):
        piece = tuple(row[start : start + _TICKS] for row in rows)
        progress, described = _scan(config, sight, limits, progress, piece)
        inside = (wanted >= start) & (wanted < start + _TICKS)
        out[inside] = np.asarray(described)[wanted[inside] - start]
    return out


def _check(wrench: NDArray[np.float32], begin: NDArray[np.int64], now: NDArray[np.int64]) -> None:
    whole = len(begin) == len(now) > 0 and begin[0] >= 0 and now[-1] <= len(wrench)
    same = np.diff(begin) == 0  # a new sentence begins at the earliest at the last look at the one before
    ordered = (np.diff(now) > 0).all() and (now > begin).all() and (same | (begin[1:] >= now[:-1])).all()
    if not (whole and ordered):
        raise InputError(
            f"the looks must be in order, each after the beginning of its sentence and within {len(wrench)} samples."
        )


def _schedule(
    window: int, wrench: NDArray[np.float32], begin: NDArray[np.int64], now: NDArray[np.int64]
) -> tuple[tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]], NDArray[np.int64]]:
    """Rows of a scan (window, count, begins), padded with empty ticks, and the row of every look."""
    last = int(now[-1])
    ends = np.arange(window, last + 1, window)
    at = np.union1d(ends, now)
    first = (at - 1) // window * window
    # The sentence of a tick is that of the look at or after it, once that sentence has begun.
    owner = np.searchsorted(now, at)
    begins = begin[owner]
    rows = -(-len(at) // _TICKS) * _TICKS
    padded = np.concatenate([wrench[:last], np.zeros((window, 6), np.float32)])
    windows = np.zeros((rows, window, 6), np.float32)
    windows[: len(at)] = padded[first[:, None] + np.arange(window)]
    count, starts = np.zeros(rows, np.int32), np.full((rows, 1), begins[-1], np.int32)
    count[: len(at)], starts[: len(at), 0] = at - first, begins
    return (windows, count, starts), np.searchsorted(at, now)


def online_features_batch(
    config: EncoderConfig,
    thresholds: GradientThresholds,
    sight: FeatureView,
    wrench: NDArray[np.float32],
    recording: NDArray[np.int64],
    begin: NDArray[np.int64],
    now: NDArray[np.int64],
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float32]:
    """As :func:`observe` for looks ``[look]`` at several recordings of ``wrench [recording, time, 6]``, in any order.

    ``progress`` is called with the number of looks done since the last call.
    """
    out = np.empty((len(now), len(names(sight.spec))), np.float32)
    for row in np.unique(recording):
        looks = np.flatnonzero(recording == row)
        looks = looks[np.lexsort((now[looks], begin[looks]))]
        out[looks] = online_features(config, thresholds, sight, wrench[row], begin[looks], now[looks])
        if progress is not None:
            progress(len(looks))
    return out
