"""The specification of a feature matrix, the matrix with the meaning of its columns, and how it is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.features import signal_families
from rcbht_jax.features import word_families as families
from rcbht_jax.features.spans import Intervals, clip
from rcbht_jax.labels import AXES, LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks

_OF_WORDS = ("sentence", "histogram", "ngram", "duration", "attributes", "offset", "course", "edges")
FAMILIES = (*_OF_WORDS, *signal_families.FAMILIES, "elapsed")
WHOLE = ("sentence",)  # families that need the whole sentence at once

ABSOLUTE = ("offset", "edges", "levels")  # families that a constant added to the wrench changes
_KINDS = (ABSOLUTE, ("elapsed",))  # kinds of families that say something of their own in few columns

_CHUNK = 64  # sentences handled at once, which bounds memory


@dataclass(frozen=True)
class FeatureSpec:
    """Which features to make; the same object rebuilds the same columns in the same order."""

    families: tuple[str, ...] = ("histogram", "ngram", "attributes")
    layers: tuple[str, ...] = LAYERS
    slots: tuple[int, int, int] = (64, 32, 16)  # L of the resampled sentence: primitive, mc, llb
    one_hot: bool = False  # resampled sentence as one column per slot and label, not one code per slot
    ngram: int = 2  # labels in a run
    balance: bool = False  # absolute families, elapsed time and all other families weigh the same

    def __post_init__(self) -> None:
        known = set(self.families) <= set(FAMILIES) and set(self.layers) <= set(LAYERS)
        if not known or not self.families or not self.layers:
            raise InputError(
                f"feature families {self.families} of layers {self.layers} cannot be made; choose at least "
                f"one family of {', '.join(FAMILIES)} and one layer of {', '.join(LAYERS)}."
            )
        if set(self.families) & set(signal_families.FAMILIES) and "primitive" not in self.layers:
            raise InputError(
                f"the families {', '.join(signal_families.FAMILIES)} describe primitives; add primitive to the layers."
            )
        if min(self.slots) < 1 or not 1 <= self.ngram <= 3:
            raise InputError(f"slots {self.slots} must be positive and ngram {self.ngram} must be 1, 2 or 3.")

    @staticmethod
    def from_dict(fields: dict[str, Any]) -> FeatureSpec:
        """Undo ``dataclasses.asdict`` after a trip through JSON, where tuples become lists."""
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
        return FeatureSpec(**plain)


@dataclass(frozen=True)
class Features:
    """A feature matrix that can explain every one of its columns."""

    values: NDArray[np.float32]  # [sentence, feature]
    names: tuple[str, ...]  # [feature] family.layer.axis.what
    families: tuple[str, ...]  # [feature] one of FAMILIES
    meanings: tuple[str, ...]  # [feature] one line each

    def meaning(self, i: int) -> str:
        """What column ``i`` says, in one line."""
        return self.meanings[i]

    def weights(self, spec: FeatureSpec) -> NDArray[np.float64] | None:
        """What scaled columns are multiplied by, ``[feature]``, mean square 1; None = all weigh the same.

        With ``spec.balance`` where the force is (few columns), the time that has passed (one) and how the force moves
        (many) count the same, those of them that are told.
        """
        return balanced_weights(self.families) if spec.balance else None

    def select(self, families: Sequence[str]) -> Features:
        """Only the columns of these families."""
        keep = [i for i, family in enumerate(self.families) if family in families]
        pick = {f: tuple(getattr(self, f)[i] for i in keep) for f in ("names", "families", "meanings")}
        return Features(values=self.values[:, keep], **pick)


def balanced_weights(families: Sequence[str]) -> NDArray[np.float64] | None:
    """Weights of columns ``[feature]`` by their families, see :meth:`Features.weights`; None = all weigh the same."""
    kind = sum((k + 1) * np.isin(families, members) for k, members in enumerate(_KINDS))
    told, inverse, count = np.unique(kind, return_inverse=True, return_counts=True)
    if len(told) < 2:
        return None
    return np.asarray(np.sqrt(len(families) / len(told) / count)[inverse], np.float64)


def concatenate_features(grammars: Mapping[str, Features]) -> Features:
    """Several grammars of the same sentences in one row each; where there are several, names get theirs as prefix.

    Raises:
        InputError: they do not have the same number of sentences.
    """
    rows = {name: made.values.shape[0] for name, made in grammars.items()}
    if len(set(rows.values())) != 1:
        said = ", ".join(f"{name} {count}" for name, count in rows.items())
        raise InputError(f"grammars of different sentences cannot stand side by side: {said or 'none'} sentences.")
    if len(grammars) == 1:
        return next(iter(grammars.values()))
    return _side_by_side([_prefixed(made, name, name) for name, made in grammars.items()])


def interval_features(tracks: LabelTracks, intervals: Intervals, spec: FeatureSpec) -> Features:
    """Describe each sentence by the families of ``spec``.

    Args:
        tracks: labels, every array ``[recording, axis, slot]``, spans in samples.
        intervals: the sentences.
        spec: families, layers, L, one-hot and n.

    Raises:
        InputError: an interval is empty or points outside the recordings.
    """
    recordings = int(np.asarray(tracks.primitive.label).shape[0])
    _check(intervals, recordings)
    blocks = [block for layer in spec.layers for block in _layer(getattr(tracks, layer), intervals, layer, spec)]
    seconds = ((intervals.end - intervals.start) * intervals.dt).astype(np.float32)[:, None]
    if "duration" in spec.families:
        blocks.append(Features(seconds, ("duration.total",), ("duration",), ("length of the sentence, s",)))
    if "elapsed" in spec.families:
        blocks.append(Features(seconds, ("elapsed",), ("elapsed",), ("time since the sentence began, s",)))
    return _side_by_side(blocks)


def concatenate_arms(right: Features, left: Features) -> Features:
    """Put the sentences of two arms into one row per trial; names get the prefix ``R`` or ``L``."""
    if right.values.shape[0] != left.values.shape[0]:
        raise InputError(
            f"the right arm has {right.values.shape[0]} sentences and the left arm "
            f"{left.values.shape[0]}; both need one per trial, in the same order."
        )
    return _side_by_side([_prefixed(right, "R", "right arm"), _prefixed(left, "L", "left arm")])


def longest(tracks: LabelTracks, intervals: Intervals) -> tuple[int, int, int]:
    """The authors' L: per layer, the largest number of labels of any sentence and axis.

    It looks at every sentence given, so give it training sentences only.
    """
    _check(intervals, int(np.asarray(tracks.primitive.label).shape[0]))
    counts = []
    for layer in LAYERS:
        parts = [clip(getattr(tracks, layer), part, layer).code for part in _chunks(intervals)]
        counts.append(max(1, *(int((code > 0).sum(-1).max(initial=0)) for code in parts)))
    return counts[0], counts[1], counts[2]


def _check(intervals: Intervals, recordings: int) -> None:
    bad = np.flatnonzero((intervals.end <= intervals.start) | (intervals.start < 0))
    if bad.size:
        i = int(bad[0])
        raise InputError(
            f"sentence {i} covers the samples {intervals.start[i]} to {intervals.end[i]}; "
            "it needs a start of at least 0 and an end after it."
        )
    if len(intervals) and not (intervals.recording.min() >= 0 and intervals.recording.max() < recordings):
        raise InputError(f"a sentence names a recording outside the {recordings} labelled ones.")


def _chunks(intervals: Intervals) -> list[Intervals]:
    return [intervals.take(slice(i, i + _CHUNK)) for i in range(0, max(len(intervals), 1), _CHUNK)]


def _layer(track: LabelTrack, intervals: Intervals, layer: str, spec: FeatureSpec) -> list[Features]:
    makers = {
        "sentence": families.resampled(spec.slots[LAYERS.index(layer)], spec.one_hot),
        "histogram": families.histogram,
        "ngram": families.ngram(spec.ngram),
        "duration": families.duration(intervals.dt),
        "attributes": families.attributes,
        "offset": families.offset,
        "course": families.course,
        "edges": families.edges,
    }
    chunks = [clip(track, part, layer) for part in _chunks(intervals)]
    parts = []
    for family in _OF_WORDS:
        if family in spec.families:
            made = [makers[family](words) for words in chunks]
            parts.append(_flat(made, family, layer))
    wanted = [family for family in signal_families.FAMILIES if family in spec.families and layer == "primitive"]
    drawn = [signal_families.read_back(words, intervals.dt) for words in chunks if wanted]
    for family in wanted:
        over = signal_families.PAIRS if family == "together" else AXES
        parts.append(_flat([signal_families.FAMILIES[family](drawing) for drawing in drawn], family, layer, over))
    return parts


def _flat(made: list[families.Block], family: str, layer: str, over: Sequence[str] = AXES) -> Features:
    """Chunks of one family side by side: columns of each axis, or pair of axes, in turn."""
    values, columns = np.concatenate([m[0] for m in made]), made[0][1]
    named = [(f"{family}.{layer}.{axis}.{what}", f"{axis} {layer}: {text}") for axis in over for what, text in columns]
    flat = values.reshape(values.shape[0], -1).astype(np.float32)
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
