"""Specification of a feature matrix, and the matrix with the name, family and meaning of each column."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from rcbht_jax._util.arms import title_of
from rcbht_jax._util.untrusted import checked_fields
from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError
from rcbht_jax.features import signal_families
from rcbht_jax.features import word_families as families
from rcbht_jax.features.spans import ClippedSpans, Intervals, check_rate, clip
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks, axis_names

_OF_WORDS = ("sentence", "histogram", "ngram", "duration", "attributes", "offset", "course", "edges")
FAMILIES = (*_OF_WORDS, *signal_families.FAMILIES, "elapsed")
WHOLE = ("sentence",)  # families that need the whole interval at once

ABSOLUTE = ("offset", "edges", "levels")  # families that a constant added to the wrench changes
_BALANCED = (ABSOLUTE, ("elapsed",))  # sets of families with few columns that count as much as all others

MAX_SLOTS = 4096  # resampled labels of a layer
_CHUNK = 64  # intervals handled at once, which bounds memory


@dataclass(frozen=True)
class FeatureSpec:
    """Which features to compute; equal specifications give the same columns in the same order.

    Attributes:
        families: see docs/howto/features.md.
        layers: of labels: "primitive", "mc", "llb".
        slots: resampled labels per interval, of each of the three layers, for the family sentence.
        one_hot: resampled labels as one column per slot and label instead of one code per slot.
        ngram: labels in a run, 1 to 3.
        weighing: how labels weigh in histogram and ngram: count, time, change (of value), each with columns of its own;
            none = time and count in histogram, count in ngram. Long words of the fit rule carry more information by
            time and change.
        balance: absolute families, elapsed time and all other families together weigh the same.

    Raises:
        InputError: unknown or no families or layers, a layer twice, slots or ngram out of range, or a value of another
            type.

    Example:
        >>> FeatureSpec(families=("histogram", "elapsed"), layers=("llb",)).families
        ('histogram', 'elapsed')
    """

    families: tuple[str, ...] = ("histogram", "ngram", "attributes")
    layers: tuple[str, ...] = LAYERS
    slots: tuple[int, int, int] = (64, 32, 16)
    one_hot: bool = False
    ngram: int = 2
    weighing: tuple[str, ...] = ()
    balance: bool = False

    def __post_init__(self) -> None:
        make_plain(self)
        known = set(self.families) <= set(FAMILIES) and set(self.layers) <= set(LAYERS)
        if not known or not self.families or not self.layers:
            raise InputError(
                f"feature families {self.families} of layers {self.layers} are not known; choose at least "
                f"one family of {', '.join(FAMILIES)} and one layer of {', '.join(LAYERS)}."
            )
        if len(set(self.layers)) < len(self.layers):
            raise InputError(f"the layers {', '.join(self.layers)} name one twice; give each once.")
        if set(self.families) & set(signal_families.FAMILIES) and "primitive" not in self.layers:
            raise InputError(
                f"the families {', '.join(signal_families.FAMILIES)} describe primitives; add primitive to the layers."
            )
        if not (min(self.slots) >= 1 and max(self.slots) <= MAX_SLOTS) or not 1 <= self.ngram <= 3:
            raise InputError(f"slots {self.slots} must be 1 to {MAX_SLOTS} and ngram {self.ngram} must be 1, 2 or 3.")
        if not set(self.weighing) <= set(families.WEIGHINGS) or len(set(self.weighing)) < len(self.weighing):
            raise InputError(
                f"labels cannot be weighed by {', '.join(self.weighing)}; choose from {', '.join(families.WEIGHINGS)}, "
                "each once."
            )
        if self.weighing and not {"histogram", "ngram"} & set(self.families):
            raise InputError("labels are weighed in the families histogram and ngram; add one, or leave out weighing.")

    @property
    def word_weighing(self) -> tuple[str, ...]:
        """Weighings of the family histogram, in the order of its columns."""
        return self.weighing or ("time", "count")

    @property
    def run_weighing(self) -> tuple[str, ...]:
        """Weighings of the family ngram, in the order of its columns."""
        return self.weighing or ("count",)

    @staticmethod
    def from_dict(fields: dict[str, Any]) -> FeatureSpec:
        """Undo ``dataclasses.asdict`` after a trip through JSON, where tuples become lists."""
        return FeatureSpec(**checked_fields(FeatureSpec, fields))


@dataclass(frozen=True)
class Features:
    """A feature matrix with a description of every column."""

    values: Float32[np.ndarray, "interval feature"]
    names: tuple[str, ...]  # [feature] family.layer.axis.what
    families: tuple[str, ...]  # [feature] one of FAMILIES
    meanings: tuple[str, ...]  # [feature] one line each

    def weights(self, spec: FeatureSpec) -> Float[np.ndarray, " feature"] | None:
        """Factors of the scaled columns, mean square 1; None = all weigh the same.

        With ``spec.balance``, absolute families (few columns), elapsed time (one) and all other families (many) get
        the same total weight, as far as they are present.
        """
        return balanced_weights(self.families) if spec.balance else None

    def select(self, families: Sequence[str]) -> Features:
        """Only the columns of these families."""
        columns = [i for i, family in enumerate(self.families) if family in families]
        described = {f: tuple(getattr(self, f)[i] for i in columns) for f in ("names", "families", "meanings")}
        return Features(values=self.values[:, columns], **described)


def balanced_weights(families: Sequence[str]) -> Float[np.ndarray, " feature"] | None:
    """Weights of columns with these families, see :meth:`Features.weights`; None = all weigh the same.

    >>> balanced_weights(("histogram", "histogram", "histogram", "elapsed")).round(3).tolist()
    [0.816, 0.816, 0.816, 1.414]
    """
    group = sum((k + 1) * np.isin(families, members) for k, members in enumerate(_BALANCED))
    present, inverse, count = np.unique(group, return_inverse=True, return_counts=True)
    if len(present) < 2:
        return None
    return np.asarray(np.sqrt(len(families) / len(present) / count)[inverse], np.float64)


def concatenate_features(parts: Mapping[str, Features]) -> Features:
    """Features of the same intervals from several encoders, side by side; the name of each becomes a prefix.

    A single part is returned without a prefix.

    Raises:
        InputError: no parts, or different numbers of intervals.
    """
    rows = {name: part.values.shape[0] for name, part in parts.items()}
    if len(set(rows.values())) != 1:
        counts = ", ".join(f"{name} {count}" for name, count in rows.items())
        raise InputError(f"features of different intervals cannot be concatenated: {counts or 'none'} intervals.")
    if len(parts) == 1:
        return next(iter(parts.values()))
    return _side_by_side([_prefixed(part, name, name) for name, part in parts.items()])


def interval_features(
    tracks: LabelTracks, intervals: Intervals, spec: FeatureSpec, axes: Sequence[str] = ()
) -> Features:
    """Features of each interval.

    Args:
        tracks: labels, every array ``[recording, axis, slot]``, spans in samples; any number of axes.
        intervals: samples of the recordings.
        spec: which features.
        axes: their names in the names of features; none = Fx to Mz where there are six, else numbered ones. Models
            compare names of features, so name axes only where no model is stored.

    Raises:
        InputError: an interval is empty or points outside the recordings, or the labels are of a single one or of
            another rate.
    """
    shape = np.shape(tracks.primitive.label)
    if len(shape) != 3:
        raise InputError(f"Labels have the shape {shape}; expected [recording, axis, slot], as of tracks.take(0).")
    axes = tuple(axes) or axis_names(shape[1])
    _check(intervals, shape[0])
    check_rate(tracks, intervals.dt, "the intervals are of")
    blocks = [block for layer in spec.layers for block in _layer(getattr(tracks, layer), intervals, layer, spec, axes)]
    seconds = ((intervals.end - intervals.start) * intervals.dt).astype(np.float32)[:, None]
    if "duration" in spec.families:
        blocks.append(Features(seconds, ("duration.total",), ("duration",), ("length of the interval, s",)))
    if "elapsed" in spec.families:
        blocks.append(Features(seconds, ("elapsed",), ("elapsed",), ("time since the start of the interval, s",)))
    return _side_by_side(blocks)


def concatenate_arms(arms: Mapping[str, Features]) -> Features:
    """Features of arms, by name, in one row per trial; if there are several, names begin with that of their arm.

    Raises:
        InputError: different numbers of intervals.
    """
    counts = {title_of(name): len(part.values) for name, part in arms.items()}
    if len(set(counts.values())) > 1:
        found = " and ".join(f"the {name} has {count} intervals" for name, count in counts.items())
        raise InputError(f"{found}; all arms need one per trial, in the same order.")
    if len(arms) == 1:
        return next(iter(arms.values()))
    return _side_by_side([_prefixed(part, name, title_of(name)) for name, part in arms.items()])


def longest(tracks: LabelTracks, intervals: Intervals) -> tuple[int, int, int]:
    """The authors' number of slots: per layer, the largest number of labels of any interval and axis.

    Pass training intervals only, because the result depends on all of them.
    """
    _check(intervals, int(np.asarray(tracks.primitive.label).shape[0]))
    counts = []
    for layer in LAYERS:
        parts = clip(getattr(tracks, layer), intervals, layer, _CHUNK)
        counts.append(max(1, *(int((part.code > 0).sum(-1).max(initial=0)) for part in parts)))
    return counts[0], counts[1], counts[2]


def _check(intervals: Intervals, recordings: int) -> None:
    bad = np.flatnonzero((intervals.end <= intervals.start) | (intervals.start < 0))
    if bad.size:
        i = int(bad[0])
        raise InputError(
            f"interval {i} covers the samples {intervals.start[i]} to {intervals.end[i]}; "
            "it needs a start of at least 0 and an end after it."
        )
    if len(intervals) and not (intervals.recording.min() >= 0 and intervals.recording.max() < recordings):
        raise InputError(f"an interval names a recording outside the {recordings} labelled ones.")


def _layer(
    track: LabelTrack, intervals: Intervals, layer: str, spec: FeatureSpec, axes: tuple[str, ...]
) -> list[Features]:
    makers: dict[str, Callable[[ClippedSpans], families.Block]] = {
        "sentence": partial(families.resampled, slots=spec.slots[LAYERS.index(layer)], one_hot=spec.one_hot),
        "histogram": partial(families.histogram, weighing=spec.word_weighing),
        "ngram": partial(families.ngram, n=spec.ngram, weighing=spec.run_weighing),
        "duration": partial(families.duration, dt=intervals.dt),
        "attributes": families.attributes,
        "offset": families.offset,
        "course": families.course,
        "edges": families.edges,
    }
    chunks = clip(track, intervals, layer, _CHUNK)
    parts = [
        _flat([makers[family](words) for words in chunks], family, layer, axes)
        for family in _OF_WORDS
        if family in spec.families
    ]
    of_signal = [family for family in signal_families.FAMILIES if family in spec.families and layer == "primitive"]
    signals = [signal_families.read_back(words, intervals.dt) for words in chunks if of_signal]
    for family in of_signal:
        lanes = signal_families.axis_pairs(axes) if family == "together" else axes
        make, columns = signal_families.FAMILIES[family], signal_families.COLUMNS[family]
        parts.append(_flat([(make(signal), columns) for signal in signals], family, layer, lanes))
    return parts


def _flat(blocks: list[families.Block], family: str, layer: str, lanes: Sequence[str]) -> Features:
    """Chunks of one family under each other: columns of each lane (an axis, or a pair of axes) in turn."""
    values, columns = np.concatenate([block[0] for block in blocks]), blocks[0][1]
    named = [(f"{family}.{layer}.{lane}.{what}", f"{lane} {layer}: {text}") for lane in lanes for what, text in columns]
    flat = values.reshape(len(values), values.shape[1] * values.shape[2]).astype(np.float32)
    return Features(flat, tuple(n for n, _ in named), (family,) * len(named), tuple(t for _, t in named))


def _side_by_side(parts: Sequence[Features]) -> Features:
    return Features(
        np.concatenate([p.values for p in parts], axis=1),
        tuple(n for p in parts for n in p.names),
        tuple(f for p in parts for f in p.families),
        tuple(m for p in parts for m in p.meanings),
    )


def _prefixed(part: Features, prefix: str, whose: str) -> Features:
    names = tuple(f"{prefix}.{n}" for n in part.names)
    return replace(part, names=names, meanings=tuple(f"{whose}, {m}" for m in part.meanings))
