"""Features of the interval so far, in constant time and memory per step, in JAX.

:class:`RunningStats` holds sums over the labels published since the interval began; labels that the encoder has not
published yet (see ``peek``) are added for one snapshot and dropped again. The features at sample n are therefore those
that :func:`rcbht_jax.features.interval_features` makes of the recording cut off after n samples: nothing later is used,
and a test compares the two. ``parts``, ``spread``, ``together``, ``order`` and ``levels`` only come close: a stream
takes the nearest of the readings that it keeps (:mod:`rcbht_jax.features.online_signal`) in place of those at their own
moments, and the test does so too. Sums over labels are kept in two single-precision numbers each, so that rounding
takes no more than 1e-7 of what was added to them, over streams of any length; durations are whole samples. The mean and
slope of a single label of millions of samples are only as good as :func:`rcbht_jax.encoding.pipe.merge` states.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.features import (
    FAMILIES,
    WHOLE,
    Features,
    FeatureSpec,
    Intervals,
    interval_features,
    online_signal,
    online_weights,
)
from rcbht_jax.features.online_weights import WeighedSums, two_sum
from rcbht_jax.features.signal_families import FAMILIES as LINES
from rcbht_jax.features.word_families import compressed
from rcbht_jax.labels import AXES, LAYER_SIZES, LAYERS, PRIMITIVE_GROUP, Group
from rcbht_jax.types import Array, LabelTrack, LabelTracks

CODES = max(LAYER_SIZES)  # alphabets are padded to the same size, so that the layers are one array
_VALUES = 3  # amplitude, slope, level
_VALUED = {"attributes", "offset", "course", "edges"}  # families that need the attributes of labels
_SECONDS = {"duration", "elapsed"}  # families that end with the length of the interval


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Values:
    """Attributes of the labels of one interval; arrays ``[layer, axis, ...]``."""

    total: Array  # float32 [layer, axis, group, 3], samples x (amplitude, slope, level)
    lost: Array  # float32 [layer, axis, group, 3], what rounding took from ``total``
    top: Array  # float32 [layer, axis], highest value of any label; lowest float if none
    bottom: Array  # float32 [layer, axis], lowest value
    first: Array  # float32 [layer, axis], value at which the first label begins; 0 if none
    final: Array  # float32 [layer, axis], value at which the latest label ends


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RunningStats:
    """Sums over the labels of one interval; arrays ``[layer, axis, ...]`` for the layers of the specification."""

    begin: Array  # int32 [], sample at which the interval begins
    count: Array  # int32 [layer, axis, code], labels
    time: Array  # int32 [layer, axis, code], samples
    longest: Array  # int32 [layer, axis, code], samples
    last: Array  # int32 [layer, axis, n - 1], codes of the latest labels, oldest first; 0 = none
    runs: Array  # int32 [layer, axis, code^n], runs of n labels; [layer, axis, 0] where no family needs them
    weighed: dict[str, WeighedSums]  # by weighing; those that ``online_weights.needed`` names
    values: Values | None  # None where no family needs them
    readings: online_signal.DecimatedSignal | None  # of the primitives; None where no signal family needs it


def check_online(spec: FeatureSpec) -> None:
    """Refuse families that cannot be kept up to date in constant time.

    Raises:
        InputError: one of the families needs the whole interval at once.
    """
    whole = [family for family in spec.families if family in WHOLE]
    if whole:
        raise InputError(
            f"the family {whole[0]} needs the whole interval at every step, which a stream does not keep; choose from "
            f"{', '.join(f for f in FAMILIES if f not in WHOLE)}."
        )


def empty(spec: FeatureSpec, begin: Array, axes: int = len(AXES)) -> RunningStats:
    """No label yet; ``begin`` int32 ``[]`` is the first sample of the interval."""
    lanes = (len(spec.layers), axes)
    ints = jnp.zeros((*lanes, CODES), jnp.int32)
    runs = CODES**spec.ngram if "ngram" in spec.families else 0
    last = jnp.zeros((*lanes, spec.ngram - 1), jnp.int32)
    weighed = online_weights.needed(spec.weighing, "ngram" in spec.families)
    return RunningStats(
        begin=begin,
        count=ints,
        time=ints,
        longest=ints,
        last=last,
        runs=jnp.zeros((*lanes, runs), jnp.int32),
        weighed={kind: online_weights.empty(lanes, CODES, runs, spec.ngram) for kind in weighed},
        values=_no_values(lanes) if _VALUED & set(spec.families) else None,
        readings=online_signal.empty(axes) if set(LINES) & set(spec.families) else None,
    )


def _no_values(lanes: tuple[int, int]) -> Values:
    sums = jnp.zeros((*lanes, CODES, _VALUES), jnp.float32)
    lowest, zero = jnp.full(lanes, np.finfo(np.float32).min, jnp.float32), jnp.zeros(lanes, jnp.float32)
    return Values(total=sums, lost=sums, top=lowest, bottom=-lowest, first=zero, final=zero)


def restart(spec: FeatureSpec, stats: RunningStats, begin: Array) -> RunningStats:
    """The same sums, or empty ones if the interval begins at another sample than theirs."""
    fresh = empty(spec, begin, stats.count.shape[1])
    return jax.tree.map(lambda new, old: jnp.where(begin == stats.begin, old, new), fresh, stats)


def _stacked(spec: FeatureSpec, tracks: LabelTracks) -> LabelTrack:
    """Layers of ``[axis, slot]`` as arrays ``[layer, axis, slot]``, with empty slots at the end where one has fewer."""
    layers = [getattr(tracks, name) for name in spec.layers]
    slots = max(layer.label.shape[-1] for layer in layers)

    def padded(leaf: Array) -> Array:
        return jnp.pad(leaf, ((0, 0), (0, slots - leaf.shape[-1])))

    return jax.tree.map(lambda *leaves: jnp.stack([padded(leaf) for leaf in leaves]), *layers)


def grow(dt: float, stats: RunningStats, now: Array, window: int) -> RunningStats:
    """The same sums, ready for labels known at ``now``, at most ``window`` samples later than those they have."""
    if stats.readings is None:
        return stats
    return replace(stats, readings=online_signal.grow(stats.readings, dt, stats.begin, now, window))


def add(spec: FeatureSpec, dt: float, stats: RunningStats, tracks: LabelTracks) -> RunningStats:
    """Add labels ``[axis, slot]`` of each layer; what lies before the beginning of the interval is cut off."""
    words = _stacked(spec, tracks)
    label = words.label.astype(jnp.int32)
    span = jnp.maximum(words.t1 - jnp.maximum(words.t0, stats.begin), 0)
    used = (label > 0) & (span > 0)
    code = jnp.where(used, label, 0)
    hot = jax.nn.one_hot(code - 1, CODES, dtype=bool)  # none in empty slots
    spans = jnp.where(hot, span[..., None], 0)
    last, runs, run_hot = _add_runs(spec, stats, code)
    weighed = {
        kind: online_weights.add(sums, online_weights.weights(kind, words, span), hot, run_hot)
        for kind, sums in stats.weighed.items()
    }
    readings = stats.readings
    if readings is not None:
        readings = online_signal.extend(readings, dt, stats.begin, tracks.primitive)
    return RunningStats(
        begin=stats.begin,
        count=stats.count + jnp.sum(hot, axis=2, dtype=jnp.int32),
        time=stats.time + jnp.sum(spans, axis=2, dtype=jnp.int32),
        longest=jnp.maximum(stats.longest, jnp.max(spans, axis=2)),
        last=last,
        runs=runs,
        weighed=weighed,
        values=None if stats.values is None else _add_values(spec, stats, words, used, code, span),
        readings=readings,
    )


def _add_values(
    spec: FeatureSpec, stats: RunningStats, words: LabelTrack, used: Array, code: Array, span: Array
) -> Values:
    values = stats.values
    assert values is not None
    weighted = (
        jnp.stack([words.vmax - words.vmin, words.grad, words.avg], axis=-1) * span.astype(jnp.float32)[..., None]
    )
    group_hot = jax.nn.one_hot(_group(spec, code) - 1, CODES, dtype=bool)
    sums = jnp.sum(jnp.where(group_hot[..., None], weighted[..., None, :], 0), axis=2)
    total, lost = two_sum(values.total, values.lost, sums)
    lowest = float(np.finfo(np.float32).min)
    first, final = _edge_values(values, jnp.any(stats.count > 0, axis=-1), words, used)
    return Values(
        total=total,
        lost=lost,
        top=jnp.maximum(values.top, jnp.max(jnp.where(used, words.vmax, lowest), axis=-1)),
        bottom=jnp.minimum(values.bottom, jnp.min(jnp.where(used, words.vmin, -lowest), axis=-1)),
        first=first,
        final=final,
    )


def _edge_values(values: Values, before: Array, words: LabelTrack, used: Array) -> tuple[Array, Array]:
    """Value where the first label begins and where the latest ends, after labels some of which are not ``used``.

    ``before`` ``[layer, axis]``: whether there was a label before.
    """
    rising, slots = words.grad > 0, used.shape[-1]
    begins = jnp.where(rising, words.vmin, words.vmax)
    ends = jnp.where(rising, words.vmax, words.vmin)
    earliest = jnp.argmax(used, axis=-1, keepdims=True)
    latest = slots - 1 - jnp.argmax(used[..., ::-1], axis=-1, keepdims=True)
    some = jnp.any(used, axis=-1)
    first = jnp.take_along_axis(begins, earliest, axis=-1)[..., 0]
    final = jnp.take_along_axis(ends, latest, axis=-1)[..., 0]
    return jnp.where(some & ~before, first, values.first), jnp.where(some, final, values.final)


def _group(spec: FeatureSpec, code: Array) -> Array:
    """Group code ``[layer, axis, slot]`` (0 = empty): signs of primitives, labels elsewhere."""
    table = jnp.asarray(_groups(spec))
    layer = jnp.arange(len(spec.layers))[:, None, None]
    return table[jnp.broadcast_to(layer, code.shape), code]


def _groups(spec: FeatureSpec) -> NDArray[np.int32]:
    """Group code of every label code, ``[layer, 1 + code]``."""
    plain = np.arange(CODES + 1, dtype=np.int32)
    return np.stack([PRIMITIVE_GROUP + 1 if name == "primitive" else plain for name in spec.layers])


def _add_runs(spec: FeatureSpec, stats: RunningStats, code: Array) -> tuple[Array, Array, Array]:
    """The latest codes, the counts of runs, and which run each label ends ``[layer, axis, slot, run]``.

    ``code`` ``[layer, axis, slot]`` may have empty slots.
    """
    last = stats.last
    if stats.runs.shape[-1] == 0:
        return last, stats.runs, jnp.zeros((*code.shape, 0), bool)
    place = jnp.asarray(CODES ** np.arange(spec.ngram - 1, -1, -1), jnp.int32)
    index = []
    for slot in range(code.shape[-1]):
        here = code[..., slot : slot + 1]
        window = jnp.concatenate([last, here], axis=-1)
        whole = jnp.all(window > 0, axis=-1)
        index.append(jnp.where(whole, jnp.sum((window - 1) * place[None, None], axis=-1), -1))
        last = jnp.where(here > 0, window[..., 1:], last)
    hot = jax.nn.one_hot(jnp.stack(index, axis=-1), stats.runs.shape[-1], dtype=bool)
    return last, stats.runs + jnp.sum(hot, axis=2, dtype=jnp.int32), hot


def describe_interval(spec: FeatureSpec, dt: float, stats: RunningStats, now: Array) -> Array:
    """Features float32 ``[feature]`` of the interval up to sample ``now``, in the order of :func:`names`."""
    blocks: dict[str, Callable[[], list[Array]]] = {
        "histogram": lambda: [_word_shares(stats, kind) for kind in spec.word_weighing],
        "ngram": lambda: [_run_shares(stats, kind) for kind in spec.run_weighing],
        "duration": lambda: [_ratio(stats.time, stats.count) * dt, stats.longest.astype(jnp.float32) * dt],
    }
    if (values := stats.values) is not None:
        blocks |= {
            "attributes": lambda: _attributes(spec, stats, values),
            "offset": lambda: _offset(spec, stats, values),
            "course": lambda: _course(spec, stats, values),
            "edges": lambda: [compressed(_edges(stats, values))],
        }
    wide = [block for family in blocks if family in spec.families for block in blocks[family]()]
    flat = [jnp.concatenate(wide, axis=-1).reshape(-1)] if wide else []
    if stats.readings is not None:
        flat.append(online_signal.describe(spec.families, stats.readings, now - stats.begin))
    flat.append(((now - stats.begin).astype(jnp.float32) * dt)[None])
    return jnp.concatenate(flat)[jnp.asarray(_columns(spec, stats.count.shape[1]))]


def _word_shares(stats: RunningStats, kind: str) -> Array:
    if kind == "change":
        return online_weights.share(stats.weighed[kind].words)
    return _share(stats.time if kind == "time" else stats.count)


def _run_shares(stats: RunningStats, kind: str) -> Array:
    return _share(stats.runs) if kind == "count" else online_weights.share(stats.weighed[kind].runs)


def _ratio(a: Array, b: Array) -> Array:
    """a / b in single precision, and 0 where b is 0."""
    a, b = a.astype(jnp.float32), b.astype(jnp.float32)
    return jnp.where(b > 0, a / jnp.maximum(b, 1), 0)


def _share(counts: Array) -> Array:
    return _ratio(counts, jnp.broadcast_to(jnp.sum(counts, axis=-1, keepdims=True), counts.shape))


def _means(spec: FeatureSpec, stats: RunningStats, values: Values) -> tuple[Array, Array, Array]:
    """Duration-weighted means: ``[layer, axis, group, 3]``, where the group occurs, and the level of the interval."""
    groups = jnp.asarray(_groups(spec)[:, 1:, None] == np.arange(1, CODES + 1))  # [layer, code, group]
    time = jnp.sum(jnp.where(groups[:, None], stats.time[..., None], 0), axis=2)
    exact = values.total + values.lost
    mean = _ratio(exact, jnp.broadcast_to(time[..., None], exact.shape))
    level = _ratio(jnp.sum(exact[..., 2], axis=-1, keepdims=True), jnp.sum(time, axis=-1, keepdims=True))
    return mean, time > 0, level


def _attributes(spec: FeatureSpec, stats: RunningStats, values: Values) -> list[Array]:
    mean, occurs, level = _means(spec, stats, values)
    labelled = jnp.any(stats.count > 0, axis=-1)
    span = jnp.where(labelled, values.top - values.bottom, 0)[..., None]
    relative = jnp.where(occurs, mean[..., 2] - level, 0)
    return [compressed(x) for x in (mean[..., 0], mean[..., 1], relative, span)]


def _offset(spec: FeatureSpec, stats: RunningStats, values: Values) -> list[Array]:
    mean, _, level = _means(spec, stats, values)
    return [compressed(mean[..., 2]), compressed(level)]


def _edges(stats: RunningStats, values: Values) -> Array:
    labelled = jnp.any(stats.count > 0, axis=-1)[..., None]
    return jnp.where(labelled, jnp.stack([values.first, values.final, values.top, values.bottom], axis=-1), 0)


def _course(spec: FeatureSpec, stats: RunningStats, values: Values) -> list[Array]:
    edges, level = _edges(stats, values), _means(spec, stats, values)[2]
    return [compressed(edges - level), compressed(edges[..., 1:2] - edges[..., :1])]


def _columns(spec: FeatureSpec, axes: int) -> NDArray[np.int32]:
    """Where each feature lies in ``describe``'s columns: ``[layer, axis, wide column]``, signal families, seconds."""
    chosen = [family for family in FAMILIES if family in spec.families]
    width = sum(padded for family in chosen for padded, _ in _widths(spec, family, 0))
    behind = len(spec.layers) * axes * width
    out: list[int] = []
    for layer, name in enumerate(spec.layers):
        edge = 0
        for family in chosen:
            parts = list(_widths(spec, family, layer))
            for axis in range(axes):
                here = (layer * axes + axis) * width + edge
                for padded, kept in parts:
                    out.extend(here + column for column in kept)
                    here += padded
            edge += sum(padded for padded, _ in parts)
        if name == "primitive":
            out.extend(range(behind, behind + online_signal.width(spec.families, axes)))
            behind += online_signal.width(spec.families, axes)
    out.extend([behind] * len(_SECONDS & set(chosen)))
    return np.array(out, np.int32)


def _widths(spec: FeatureSpec, family: str, layer: int) -> Iterator[tuple[int, list[int]]]:
    """Blocks of a family: columns with padding, and those that the layer's own alphabet fills."""
    name = spec.layers[layer]
    size = LAYER_SIZES[LAYERS.index(name)]
    labels = (CODES, list(range(size)))
    groups = (CODES, list(range(len(Group) if name == "primitive" else size)))
    if family == "ngram":
        place = CODES ** np.arange(spec.ngram - 1, -1, -1)
        runs = [int(np.dot(run, place)) for run in itertools.product(range(size), repeat=spec.ngram)]
        yield from [(CODES**spec.ngram, runs)] * len(spec.run_weighing)
    else:
        yield from {
            "histogram": [labels] * len(spec.word_weighing),
            "duration": [labels, labels],
            "attributes": [groups, groups, groups, (1, [0])],
            "offset": [groups, (1, [0])],
            "course": [(5, [0, 1, 2, 3, 4])],
            "edges": [(4, [0, 1, 2, 3])],
        }.get(family, [])


def names(spec: FeatureSpec, axes: int = len(AXES)) -> tuple[str, ...]:
    """Names of the features, those of :func:`rcbht_jax.features.spec`."""
    return _nothing(spec, axes).names


def weights(spec: FeatureSpec, axes: int = len(AXES)) -> NDArray[np.float64] | None:
    """What scaled features are multiplied by ``[feature]``, as on the host; None = all weigh the same."""
    return _nothing(spec, axes).weights(spec)


def _nothing(spec: FeatureSpec, axes: int) -> Features:
    """The features of an empty interval."""
    zero = np.zeros((1, axes, 1))
    track = LabelTrack(*(zero.astype(np.int32),) * 4, *(zero,) * 4)
    one = Intervals(np.zeros(1, np.int64), np.zeros(1, np.int64), np.ones(1, np.int64), 1.0)
    return interval_features(LabelTracks(track, track, track), one, spec)
