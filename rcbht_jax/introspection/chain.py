"""Features of a stream as they stood at each sample, without the future.

A *snapshot* is what a stream knows after a number of samples: the samples of the current window, all of them or only
the first few, go through the encoder. A complete window changes the state for good, an incomplete one only the answer.
:class:`rcbht_jax.introspection.introspector.Introspector` takes the same steps one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax._util.compiling import host_device, jit
from rcbht_jax.encoding.encoder import EncoderState, PackedLabels, unpack
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, rule_of
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
)
from rcbht_jax.labels import AXES
from rcbht_jax.types import Array

_STEPS = 512  # per compiled scan, whatever the length of the recording

Ints = Int[np.ndarray, " snapshot"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StreamState:
    """State of a stream; its size does not depend on the stream's length."""

    encoder: EncoderState
    stats: tuple[RunningStats, ...]  # one per view: of the present sub-task, of the whole trial


@dataclass(frozen=True)
class FeatureView:
    """The features of an interval that a classifier reads."""

    spec: FeatureSpec
    provisional: bool = True  # with the labels that are not published yet, see ``encoder.flush``


def begin_stream(config: AnyConfig, views: tuple[FeatureView, ...], axes: int = len(AXES)) -> StreamState:
    """The state before the first sample, for ``axes`` axes."""
    return StreamState(
        rule_of(config).init(config, (axes,)), tuple(empty(view.spec, jnp.int32(0), axes) for view in views)
    )


def step(
    config: AnyConfig,
    views: tuple[FeatureView, ...],
    limits: Float[Array, "axis limit"],
    state: StreamState,
    window: Float[Array, "window axis"],
    count: Int[Array, ""],
    begins: Int[Array, " view"],
) -> tuple[StreamState, tuple[Float[Array, " _feature"], ...], PackedLabels]:
    """Take one snapshot; pure, with the static arguments first.

    Args:
        config: of the encoder; its type chooses the rule.
        views: features to make, each of its own interval.
        limits: of :func:`rcbht_jax.encoding.rules.checked_limits`.
        state: at the end of the last complete window.
        window: samples since then, N and Nm; those from ``count`` on are ignored.
        count: samples in ``window``.
        begins: first sample of the present interval of each view.

    Returns:
        the new state (the same unless the window is complete), the features of each view, and the labels that the
        window published (none unless it is complete).
    """
    counts = jnp.broadcast_to(count, state.encoder.time.shape)
    rule = rule_of(config)
    after, out = rule.step_partial(config, limits, state.encoder, window, counts)
    published, pending = unpack(out), rule.drain(config, jnp.moveaxis(limits, -1, 0), after)
    complete = count == config.window
    now = state.encoder.time[0] + count
    slot = jax.tree.map(lambda leaf: leaf[:, None], published)
    next_stats, features = [], []
    for view, old, begin in zip(views, state.stats, begins, strict=True):
        stats = grow(config.dt, restart(view.spec, old, begin), now, config.window)
        new = add(view.spec, config.dt, stats, slot)
        following = jax.tree.map(lambda a, b: jnp.where(complete, a, b), new, stats)
        seen = add(view.spec, config.dt, new, pending) if view.provisional else following
        features.append(describe_interval(view.spec, config.dt, seen, now))
        next_stats.append(following)
    encoder = jax.tree.map(lambda a, b: jnp.where(complete, a, b), after, state.encoder)
    labels = jax.tree.map(lambda leaf: jnp.where(complete, leaf, jnp.zeros_like(leaf)), out)
    return StreamState(encoder, tuple(next_stats)), tuple(features), labels


@jit(host=True, static_argnums=(0, 1))  # the steps of one recording: bit for bit those of a stream
def _scan(
    config: AnyConfig, view: FeatureView, limits: Array, state: StreamState, rows: tuple[Array, ...]
) -> tuple[StreamState, Array]:
    def body(state: StreamState, row: tuple[Array, ...]) -> tuple[StreamState, Array]:
        state, features, _ = step(config, (view,), limits, state, *row)
        return state, features[0]

    return jax.lax.scan(body, state, rows)


def online_features(
    config: AnyConfig,
    thresholds: AnyLimits,
    view: FeatureView,
    wrench: Float[np.ndarray, "time axis"],
    begin: Ints,
    now: Ints,
) -> Float[np.ndarray, "snapshot feature"]:
    """Features of intervals of one recording, as a stream would have had them at some samples.

    Args:
        config: of the encoder; its type chooses the rule.
        thresholds: limits ``[axis, 4]``; of the fit rule FitLimits.
        view: which features.
        wrench: N and Nm.
        begin: first sample of each snapshot's interval, increasing.
        now: samples received when the snapshot is taken, increasing, > begin.

    Raises:
        InputError: the snapshots are not in order or not in the recording, or limits that do not fit.

    >>> from rcbht_jax.encoding.encoder import EncoderConfig
    >>> from rcbht_jax.encoding.thresholds import preset
    >>> view = FeatureView(FeatureSpec(("elapsed",)))
    >>> wrench = np.zeros((100, 6), np.float32)
    >>> begin, now = np.array([0, 40]), np.array([16, 88])
    >>> online_features(EncoderConfig(dt=1 / 64), preset(), view, wrench, begin, now).tolist()
    [[0.25], [0.75]]
    """
    check_online(view.spec)
    _check(wrench, begin, now)
    rows, wanted = _schedule(config.window, wrench, begin, now)
    limits, state = jax.device_put(
        (np.asarray(checked_limits(config, thresholds), np.float32), begin_stream(config, (view,), wrench.shape[1])),
        host_device(),
    )
    out = np.empty((len(now), len(names(view.spec, wrench.shape[-1]))), np.float32)
    for start in range(0, len(rows[1]), _STEPS):
        state, features = _scan(config, view, limits, state, tuple(row[start : start + _STEPS] for row in rows))
        inside = (wanted >= start) & (wanted < start + _STEPS)
        out[inside] = np.asarray(features)[wanted[inside] - start]
    return out


def _check(wrench: Float[np.ndarray, "time axis"], begin: Ints, now: Ints) -> None:
    inside = len(begin) == len(now) > 0 and begin[0] >= 0 and now[-1] <= len(wrench)
    same = np.diff(begin) == 0  # a new interval begins at the earliest at the last snapshot of the one before
    ordered = (np.diff(now) > 0).all() and (now > begin).all() and (same | (begin[1:] >= now[:-1])).all()
    if not (inside and ordered):
        raise InputError(
            "the snapshots must be in order, each after the beginning of its interval and within "
            f"{len(wrench)} samples."
        )


def _schedule(
    window: int, wrench: Float[np.ndarray, "time axis"], begin: Ints, now: Ints
) -> tuple[tuple[Float[np.ndarray, "step w axis"], Int[np.ndarray, " step"], Int[np.ndarray, "step 1"]], Ints]:
    """Rows of a scan (window, count, begins), padded with empty steps, and the row of every snapshot."""
    last = int(now[-1])
    ends = np.arange(window, last + 1, window)
    at = np.union1d(ends, now)
    first = (at - 1) // window * window
    # The interval of a step is that of the snapshot at or after it, once that interval has begun.
    begins = begin[np.searchsorted(now, at)]
    rows = -(-len(at) // _STEPS) * _STEPS
    padded = np.concatenate([wrench[:last], np.zeros((window, wrench.shape[1]), np.float32)])
    windows = np.zeros((rows, window, wrench.shape[1]), np.float32)
    windows[: len(at)] = padded[first[:, None] + np.arange(window)]
    count, starts = np.zeros(rows, np.int32), np.full((rows, 1), begins[-1], np.int32)
    count[: len(at)], starts[: len(at), 0] = at - first, begins
    return (windows, count, starts), np.searchsorted(at, now)


def online_features_batch(
    config: AnyConfig,
    thresholds: AnyLimits,
    view: FeatureView,
    wrench: Float[np.ndarray, "recording time axis"],
    recording: Ints,
    begin: Ints,
    now: Ints,
    progress: Callable[[int], object] | None = None,
) -> Float[np.ndarray, "snapshot feature"]:
    """As :func:`online_features`, for snapshots of several recordings in any order.

    ``progress`` is called with the number of snapshots since the last call.
    """
    out = np.empty((len(now), len(names(view.spec, wrench.shape[-1]))), np.float32)
    for row in np.unique(recording):
        mine = np.flatnonzero(recording == row)
        mine = mine[np.lexsort((now[mine], begin[mine]))]
        out[mine] = online_features(config, thresholds, view, wrench[row], begin[mine], now[mine])
        if progress is not None:
            progress(len(mine))
    return out
