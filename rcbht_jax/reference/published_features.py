"""The published feature matrices of the RCBHT data sets: label sequences of fixed length.

A sequence is the labels of one axis and layer, resampled to slots of equal duration; a slot has the label that fills
most of it. A row concatenates the sequences of all axes and layers. Labels count from zero, as in the published
files. Ties between labels and the order of the columns follow the iteration order of Python 2 dictionaries whose keys
are the names of the labels; this module reproduces it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int16
from numpy.typing import ArrayLike

from rcbht_jax.errors import InputError
from rcbht_jax.labels import ALPHABETS, AXES, LAYERS, name
from rcbht_jax.reference import OfflineLabels, state_onsets
from rcbht_jax.robots.snap_assembly import STATES

Row = Int16[np.ndarray, " feature"]


class Lengths(NamedTuple):
    """Slots per sequence of each layer."""

    primitive: int
    mc: int
    llb: int


# From the longest sequence of each published set; "states" = per state, "outcome" = success or failure.
LENGTHS = {
    "sim_outcome": Lengths(266, 61, 36),
    "sim_states": Lengths(179, 37, 22),
    "real_outcome": Lengths(1122, 224, 46),
    "real_states": Lengths(844, 161, 29),
    "two_left_states": Lengths(211, 52, 34),
    "two_right_states": Lengths(250, 49, 35),
}

# Columns of the tables in the published features: label, start, end.
_TABLES = {"primitive": ("prim_raw", 6, 3, 4), "mc": ("mc", 0, 6, 9), "llb": ("llb", 0, 12, 15)}
_LEVEL_NAMES = {"primitive": "primitive", "composite": "mc", "llbehavior": "llb"}

# Names are unique across layers: compositions are lower case, behaviours upper case.
_NUMBER = {name(layer, code): code - 1 for layer, labels in zip(LAYERS, ALPHABETS, strict=True) for code in labels}

_HASH_MASK = 2**64 - 1
_FIRST_SLOTS = 8


class Sentence(NamedTuple):
    """Names of the labels of one axis and layer, with their start and end times, s."""

    label: tuple[str, ...]
    start: tuple[float, ...]
    end: tuple[float, ...]


Sentences = dict[str, tuple[Sentence, ...]]  # by name of the layer; Fx Fy Fz Mx My Mz


def python2_hash(text: str) -> int:
    """Hash of an ASCII string in 64-bit Python 2 without randomisation, as an unsigned number."""
    if not text:
        return 0
    value = ord(text[0]) << 7
    for character in text:
        value = (1000003 * value) ^ ord(character)
    value = (value & _HASH_MASK) ^ len(text)
    return value - 1 if value == _HASH_MASK else value


def _insert(slots: list[str | None], key: str) -> None:
    """Put a key into the first free slot of its probe sequence."""
    index = perturb = python2_hash(key)
    mask = len(slots) - 1
    while slots[index & mask] is not None:
        index = 5 * index + perturb + 1
        perturb >>= 5
    slots[index & mask] = key


def python2_order(keys: Iterable[str]) -> list[str]:
    """Distinct keys in the iteration order of a Python 2 dictionary filled in the given order."""
    slots: list[str | None] = [None] * _FIRST_SLOTS
    for used, key in enumerate(dict.fromkeys(keys), start=1):
        _insert(slots, key)
        if used * 3 >= len(slots) * 2:
            old = [slot for slot in slots if slot is not None]
            size = _FIRST_SLOTS
            while size <= 4 * used:
                size *= 2
            slots = [None] * size
            for old_key in old:
                _insert(slots, old_key)
    return [key for key in slots if key is not None]


LEVEL_ORDER = tuple(_LEVEL_NAMES[level] for level in python2_order(_LEVEL_NAMES))
AXIS_ORDER = tuple(python2_order(AXES))


def _as_printed(values: Float64[np.ndarray, " row"]) -> tuple[float, ...]:
    """Values as read from text files with five decimals, like those of the original programs."""
    return tuple(float(f"{value:.5f}") for value in values)


def sentences(labels: OfflineLabels) -> Sentences:
    """The sequences of one recording as in the original text files: raw primitives (Q8), filtered others."""
    result: Sentences = {}
    for layer, (field, label, start, end) in _TABLES.items():
        result[layer] = tuple(
            Sentence(
                tuple(name(layer, int(code)) for code in table[:, label]),
                _as_printed(table[:, start]),
                _as_printed(table[:, end]),
            )
            for table in getattr(labels, field)
        )
    return result


def state_marks(onset: ArrayLike, recording: Sentences) -> list[float]:
    """End times of the four states, s, from the values of the state file.

    The last state ends with the last behaviour of Fx if the file has no end of it.

    Raises:
        InputError: a state is missing.
    """
    marks = state_onsets(onset)[1:]
    if len(marks) == len(STATES) - 1:
        marks.append(recording["llb"][0].end[-1])
    if len(marks) != len(STATES):
        raise InputError(f"The state file gives {len(marks)} boundaries; expected four states.")
    return marks


def split(sentence: Sentence, marks: Sequence[float]) -> list[Sentence]:
    """Sequence of each state, which ends at one of the marks; a label across a mark is cut there."""
    parts: list[list[tuple[str, float, float]]] = [[] for _ in marks]
    k = 0
    for label, start, end in zip(*sentence, strict=True):
        begin = start
        while k < len(marks) and end > marks[k]:
            parts[k].append((label, begin, marks[k]))
            begin = marks[k]
            k += 1
        if k < len(marks):
            parts[k].append((label, begin, end))
            k += end == marks[k]
    return [_sentence(part) for part in parts]


def _sentence(items: list[tuple[str, float, float]]) -> Sentence:
    label, start, end = zip(*items, strict=True) if items else ((), (), ())
    return Sentence(label, start, end)


def resample(sentence: Sentence, slots: int) -> Row:
    """The labels of a sequence, counted from zero, in ``slots`` parts of equal duration.

    Only end times are used: a gap belongs to the label after it, and an overlap counts as negative time. A slot has
    the label with the most time in it; of several, the first in the order of a Python 2 dictionary.

    Raises:
        InputError: there are no labels or slots, or the labels have no duration.
    """
    order = sorted(range(len(sentence.label)), key=lambda i: sentence.start[i])
    if not order or slots < 1:
        raise InputError(f"{len(order)} labels cannot fill {slots} slots; expected at least one of each.")
    origin = sentence.start[order[0]]
    duration = sentence.end[order[-1]] - origin
    if duration <= 0:
        raise InputError(f"The labels last {duration} s; expected a positive duration.")
    winners: list[int] = []
    last, end = 0.0, duration * 1 / slots
    durations: dict[str, float] = {}
    for i in order:
        label, until = sentence.label[i], sentence.end[i] - origin
        while until >= end and len(winners) < slots:
            durations[label] = durations.get(label, 0) + (end - last)
            winners.append(_NUMBER[label if len(durations) == 1 else _winner(durations)])
            durations, last = {}, end
            end = duration * ((len(winners) + 1) / slots)
        durations[label] = durations.get(label, 0) + (until - last)
        last = until
    return np.array(winners, np.int16)


def _winner(durations: dict[str, float]) -> str:
    most = max(durations.values())
    tied = [label for label, time in durations.items() if time == most]
    return tied[0] if len(tied) == 1 else next(label for label in python2_order(durations) if label in tied)


def feature_row(recording: Sentences, lengths: Lengths) -> Row:
    """The ``6 * sum(lengths)`` features of one recording or one state; see :func:`feature_names`."""
    return np.concatenate(
        [
            resample(recording[layer][AXES.index(axis)], getattr(lengths, layer))
            for layer in LEVEL_ORDER
            for axis in AXIS_ORDER
        ]
    )


def outcome_features(labels: OfflineLabels, lengths: Lengths) -> Row:
    """The ``6 * sum(lengths)`` features of a whole recording, for success or failure."""
    return feature_row(sentences(labels), lengths)


def state_features(labels: OfflineLabels, onset: ArrayLike, lengths: Lengths) -> Int16[np.ndarray, "4 feature"]:
    """The ``6 * sum(lengths)`` features of each of the four states of a recording.

    Args:
        labels: of one recording.
        onset: values of its state file, s.
        lengths: slots per layer.

    Raises:
        InputError: the recording lacks a state.
    """
    recording = sentences(labels)
    marks = state_marks(onset, recording)
    parts = {layer: [split(axis, marks) for axis in recording[layer]] for layer in LAYERS}
    return np.stack(
        [
            feature_row({layer: tuple(axis[k] for axis in parts[layer]) for layer in LAYERS}, lengths)
            for k in range(len(STATES))
        ]
    )


def longest(recordings: Iterable[Sentences]) -> Lengths:
    """Slots per layer such that no sequence of these recordings (or states of recordings) loses a label.

    Raises:
        InputError: there are no recordings.
    """
    counts = [[max(len(axis.label) for axis in each[layer]) for layer in LAYERS] for each in recordings]
    if not counts:
        raise InputError("There are no recordings; expected at least one, whose lengths are used.")
    return Lengths(*(max(column) for column in zip(*counts, strict=True)))


def feature_names(lengths: Lengths) -> list[str]:
    """Names of the columns, for example ``"mc_Fx_0"``: layer, axis, slot."""
    return [
        f"{layer}_{axis}_{slot}"
        for layer in LEVEL_ORDER
        for axis in AXIS_ORDER
        for slot in range(getattr(lengths, layer))
    ]
