"""Features of the labels of one layer: columns per axis, each with a name and a meaning."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float, Int, Num
from numpy.lib.stride_tricks import sliding_window_view

from rcbht_jax.features.spans import ClippedSpans, ratio, share, weighted_counts
from rcbht_jax.labels import ALPHABETS, LAYER_SIZES, LAYERS, PRIMITIVE_GROUP, Group, name
from rcbht_jax.types import Array

# Values are compressed as sign(v) log(1 + |v| / unit); the unit is about five times the noise of the sensor.
UNIT = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])  # N or Nm of a wrench (slopes: per second)

Columns = Float[np.ndarray, "interval axis column"]
# One family of one layer: values per interval and lane (axis or pair of axes), and (suffix, meaning) of each column.
Block = tuple[Float[np.ndarray, "_ lane column"], list[tuple[str, str]]]


def _names(layer: str) -> list[str]:
    return [name(layer, code) for code in range(1, LAYER_SIZES[LAYERS.index(layer)] + 1)]


def majority(words: ClippedSpans, slots: int) -> Int[np.ndarray, "interval axis slot"]:
    """Code of the label with most time in each of ``slots`` equal parts of an interval; 0 = no label."""
    # Times are multiplied by the number of slots, so that slot edges are whole multiples of the length.
    width = words.length[:, None, None]
    first, last = words.start * slots, words.end * slots
    used = words.code > 0
    slot0 = np.where(used, first // width, 0)
    slot1 = np.where(used, (last - 1) // width, 0)
    shape = (*words.code.shape[:2], slots + 1, words.size)
    lane = np.arange(shape[0] * shape[1]).reshape(*shape[:2], 1)

    def spread(slot: Int[np.ndarray, "*_"], weight: Num[np.ndarray, "*_"]) -> Float[np.ndarray, "*_"]:
        index = ((lane * (slots + 1) + slot) * words.size + np.maximum(words.code - 1, 0)).ravel()
        sums = np.bincount(index, np.where(used, weight, 0).ravel(), int(np.prod(shape)))
        return sums.astype(np.float64).reshape(shape)

    # A span fills whole slots slot0..slot1 (a step up and a step down), minus what its two ends leave free.
    full = np.broadcast_to(width, first.shape)
    whole = np.cumsum(spread(slot0, full) - spread(slot1 + 1, full), axis=2)
    free = spread(slot0, first - slot0 * width) + spread(slot1, (slot1 + 1) * width - last)
    held = (whole - free)[:, :, :slots]
    return np.where(held.max(-1) > 0, held.argmax(-1) + 1, 0)


def resampled(words: ClippedSpans, slots: int, one_hot: bool) -> Block:
    """Labels of ``slots`` equal parts of the interval, as codes or one-hot."""
    codes = majority(words, slots)
    if not one_hot:
        columns = [(f"{k}", f"code of the label that fills slot {k + 1} of {slots}") for k in range(slots)]
        return codes.astype(np.float64), columns
    hot = codes[..., None] == np.arange(1, words.size + 1)
    columns = [
        (f"{k}.{label}", f"1 if {label} fills slot {k + 1} of {slots}")
        for k in range(slots)
        for label in _names(words.layer)
    ]
    return hot.reshape(*codes.shape[:2], -1).astype(np.float64), columns


WEIGHINGS = ("count", "time", "change")
_WORD_SHARE = {
    "time": "share of the labelled time spent in {}",
    "count": "share of the labels that are {}",
    "change": "share of the change of value, summed over the labels, that is of {}",
}
_RUN_SHARE = {
    "time": "share of the time of all runs of {} labels that is of {}",
    "count": "share of runs of {} labels that are {}",
    "change": "share of the change of value of all runs of {} labels that is of {}",
}


def word_weights(words: ClippedSpans, kind: str) -> Float[np.ndarray, "interval axis word"]:
    """What each label weighs: one, its samples, or the change of value of that part of it which the interval holds.

    A label changes by its highest minus its lowest value, evenly over its length. Empty slots weigh nothing.
    """
    if kind == "count":
        return (words.code > 0).astype(np.float64)
    if kind == "time":
        return words.duration.astype(np.float64)
    return ratio((words.value["vmax"] - words.value["vmin"]) * words.duration, words.value["whole"])


def histogram(words: ClippedSpans, weighing: Sequence[str]) -> Block:
    """Share of each label in the sum of all, by each weighing in turn."""
    shares = [share(weighted_counts(words.code, word_weights(words, kind), words.size)) for kind in weighing]
    labels = _names(words.layer)
    columns = [(f"{kind}.{x}", _WORD_SHARE[kind].format(x)) for kind in weighing for x in labels]
    return np.concatenate(shares, -1), columns


def ngram(words: ClippedSpans, n: int, weighing: Sequence[str]) -> Block:
    """Share of each run of ``n`` successive labels, by each weighing in turn; a run weighs what its labels weigh."""
    named = list(itertools.product(_names(words.layer), repeat=n))
    columns = [
        ("-".join(run) if kind == "count" else f"{kind}.{'-'.join(run)}", _RUN_SHARE[kind].format(n, " ".join(run)))
        for kind in weighing
        for run in named
    ]
    if words.code.shape[-1] < n:
        return np.zeros((*words.code.shape[:2], len(columns))), columns
    windows = partial(sliding_window_view, window_shape=n, axis=-1)
    runs = windows(words.code)
    place = words.size ** np.arange(n - 1, -1, -1)
    code = np.where((runs > 0).all(-1), ((runs - 1) * place).sum(-1) + 1, 0)
    weights = [windows(word_weights(words, kind)).sum(-1) for kind in weighing]
    return np.concatenate([share(weighted_counts(code, one, words.size**n)) for one in weights], -1), columns


def duration(words: ClippedSpans, dt: float) -> Block:
    """Mean and longest duration per label in seconds, from ``dt`` seconds per sample."""
    total = weighted_counts(words.code, words.duration, words.size)
    mean = ratio(total, weighted_counts(words.code, words.code > 0, words.size))
    lanes = np.arange(total[..., 0].size).reshape(*total.shape[:2], 1)
    longest = np.zeros((lanes.size, words.size + 1))
    np.maximum.at(longest, (lanes, words.code), words.duration)
    top = longest[:, 1:].reshape(total.shape)
    labels = _names(words.layer)
    columns = [(f"mean.{x}", f"mean duration of a label {x}, s") for x in labels]
    columns += [(f"max.{x}", f"longest duration of a label {x}, s") for x in labels]
    return np.concatenate([mean, top], -1) * dt, columns


def _groups(words: ClippedSpans) -> tuple[Int[np.ndarray, "interval axis word"], list[str]]:
    """Group code per word (0 = empty) and group names: the signs of primitives, the labels of other layers."""
    if words.layer == "primitive":
        return (PRIMITIVE_GROUP[words.code] + 1).astype(np.int64), [g.name.lower() for g in Group]
    return words.code, [label.name for label in ALPHABETS[LAYERS.index(words.layer)]]


def compressed(x: Float[Array, "*lanes axis column"]) -> Float[Array, "*lanes axis column"]:
    """Signed logarithm of N or Nm (per second) in units of UNIT, so that peaks do not dominate; NumPy or JAX.

    Unless there are six axes, the unit of forces is used for all of them.
    """
    xp, unit = x.__array_namespace__(), UNIT if x.shape[-2] == UNIT.size else UNIT[:1]
    return xp.sign(x) * xp.log1p(abs(x) / xp.broadcast_to(xp.asarray(unit, x.dtype)[:, None], x.shape))


def _mean_per_group(words: ClippedSpans, value: Float[np.ndarray, "interval axis word"]) -> Columns:
    code, labels = _groups(words)
    return ratio(
        weighted_counts(code, words.duration * value, len(labels)), weighted_counts(code, words.duration, len(labels))
    )


def _mean_level(words: ClippedSpans) -> Float[np.ndarray, "interval axis 1"]:
    """Duration-weighted mean level, N or Nm."""
    time = words.duration.sum(-1, keepdims=True).astype(np.float64)
    return ratio((words.duration * words.value["avg"]).sum(-1, keepdims=True), time)


def attributes(words: ClippedSpans) -> Block:
    """Amplitude, slope and level relative to the interval's mean, per group; the range of the interval."""
    labels = _groups(words)[1]
    level = words.value["avg"] - _mean_level(words)
    top = np.where(words.code > 0, words.value["vmax"], -np.inf).max(-1, keepdims=True)
    bottom = np.where(words.code > 0, words.value["vmin"], np.inf).min(-1, keepdims=True)
    span = np.where(np.isfinite(top), top - bottom, 0)
    amplitude = _mean_per_group(words, words.value["vmax"] - words.value["vmin"])
    slope = _mean_per_group(words, words.value["grad"])
    values = np.concatenate([amplitude, slope, _mean_per_group(words, level), span], -1)
    columns = [(f"amp.{x}", f"mean amplitude of {x} labels, signed log") for x in labels]
    columns += [(f"grad.{x}", f"mean slope of {x} labels, signed log") for x in labels]
    columns += [(f"level.{x}", f"mean level of {x} labels minus the interval's, signed log") for x in labels]
    columns += [("range", "highest minus lowest value in the interval, signed log")]
    return compressed(values), columns


def offset(words: ClippedSpans) -> Block:
    """Absolute mean level, per group and of the interval."""
    columns = [(f"avg.{x}", f"absolute mean level of {x} labels, signed log") for x in _groups(words)[1]]
    columns += [("avg", "absolute mean level of the interval, signed log")]
    values = np.concatenate([_mean_per_group(words, words.value["avg"]), _mean_level(words)], -1)
    return compressed(values), columns


_EDGES = ("first", "last", "highest", "lowest")


def _edges(words: ClippedSpans) -> Float[np.ndarray, "interval axis 4"]:
    """First, last, highest and lowest value of the fitted lines, N or Nm; 0 without any label."""
    used = words.code > 0
    rising = words.value["grad"] > 0
    begins = np.where(rising, words.value["vmin"], words.value["vmax"])[..., :1]
    ends = np.where(rising, words.value["vmax"], words.value["vmin"])
    last = np.maximum(used.sum(-1, keepdims=True) - 1, 0)
    top = np.where(used, words.value["vmax"], -np.inf).max(-1, keepdims=True)
    bottom = np.where(used, words.value["vmin"], np.inf).min(-1, keepdims=True)
    parts = [begins, np.take_along_axis(ends, last, -1), top, bottom]
    return np.where(used.any(-1, keepdims=True), np.concatenate(parts, -1), 0)


def course(words: ClippedSpans) -> Block:
    """First, last, highest and lowest value relative to the mean level of the interval, and the change."""
    edges, level = _edges(words), _mean_level(words)
    values = np.concatenate([edges - level, edges[..., 1:2] - edges[..., :1]], -1)
    columns = [(x, f"{x} value minus the interval's mean level, signed log") for x in _EDGES]
    return compressed(values), [*columns, ("change", "last minus first value, signed log")]


def edges(words: ClippedSpans) -> Block:
    """First, last, highest and lowest value, absolute."""
    return compressed(_edges(words)), [(x, f"{x} value of the interval, signed log") for x in _EDGES]
