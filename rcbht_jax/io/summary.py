"""The counts that "rcbht info" shows, made of each part when it is written, so that no row is read to count."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from rcbht_jax.types import Recordings

# Version of the counts, stored in "counting" of each part; raise it when they change. Other versions are not checked.
COUNTING = 1
MOST_TEXTS = 1000  # different ones in a column of one part; beyond, they are not counted

Summary = dict[str, Any]  # of JSON values


def summary_of(recordings: Recordings) -> Summary:
    """Counts of recordings by group and length, of notes, annotations and columns; those of length 0 are left out.

    Example:
        >>> counts = summary_of(Recordings.example())
        >>> [group[2:] for group in counts["groups"]]
        [['failure', 'R', {'300': 4}], ['success', 'R', {'300': 4}]]
    """
    used = np.flatnonzero(recordings.length)
    rows = recordings if len(used) == len(recordings) else recordings.take(used)
    names = (rows.source, rows.session, rows.outcome, rows.arm, rows.length)
    lengths: dict[tuple[str, ...], Counter[str]] = {}
    for *key, samples in zip(*(column.tolist() for column in names), strict=True):
        lengths.setdefault(tuple(key), Counter())[str(samples)] += 1
    flags = Counter(flag.split(":")[0].split("=")[0] for note in rows.note.tolist() for flag in note.split(";") if flag)
    return {
        "groups": [[*key, dict(counts)] for key, counts in lengths.items()],
        "notes": dict(flags),
        "annotations": _annotations(rows),
        "columns": {name: _column(values) for name, values in rows.columns.items()},
    }


def merged(summaries: Iterable[Summary]) -> Summary:
    """The summary of several parts together."""
    groups: dict[tuple[str, ...], Counter[str]] = {}
    notes: Counter[str] = Counter()
    annotations: dict[str, dict[str, list[int]]] = {}
    columns: dict[str, dict[str, Any]] = {}
    for summary in summaries:
        for *key, counts in summary["groups"]:
            groups.setdefault(tuple(key), Counter()).update(counts)
        notes.update(summary["notes"])
        for track, labels in summary["annotations"].items():
            known = annotations.setdefault(track, {})
            for label, pair in labels.items():
                known[label] = [a + b for a, b in zip(known.get(label, [0, 0]), pair, strict=True)]
        for name, column in summary["columns"].items():
            columns[name] = _both(columns[name], column) if name in columns else column
    return {
        "groups": [[*key, dict(counts)] for key, counts in groups.items()],
        "notes": dict(notes),
        "annotations": annotations,
        "columns": columns,
    }


def quantiles(counts: dict[str, int]) -> list[float]:
    """Smallest, median and largest of numbers that are counted.

    Example:
        >>> quantiles({"10": 1, "20": 1, "40": 2})
        [10.0, 30.0, 40.0]
    """
    ordered = sorted((int(value), count) for value, count in counts.items())
    ends = np.cumsum([count for _, count in ordered])
    middle = [ordered[int(np.searchsorted(ends, k, side="right"))][0] for k in ((ends[-1] - 1) // 2, ends[-1] // 2)]
    return [float(ordered[0][0]), sum(middle) / 2, float(ordered[-1][0])]


def _annotations(recordings: Recordings) -> dict[str, dict[str, list[int]]]:
    """By track and label: intervals, and recordings that have one."""
    return {
        track: {
            label: [int((marks.code == code).sum()), len(np.unique(marks.recording[marks.code == code]))]
            for code, label in enumerate(marks.labels[track])
        }
        for track in recordings.annotations.tracks
        for marks in [recordings.annotations.of(track)]
    }


def _column(values: np.ndarray) -> dict[str, Any]:
    """Of text: the counts of each, None = too many; of numbers: how many are finite, smallest and largest."""
    if values.dtype.kind == "U":
        counts = Counter(text for text in values.tolist() if text)
        return {"texts": dict(counts) if len(counts) <= MOST_TEXTS else None}
    finite = values[np.isfinite(values)]
    return {"numbers": len(finite), "range": [float(finite.min()), float(finite.max())] if len(finite) else None}


def _both(one: dict[str, Any], two: dict[str, Any]) -> dict[str, Any]:
    if "texts" in one:
        many = one["texts"] is None or two["texts"] is None
        return {"texts": None if many else dict(Counter(one["texts"]) + Counter(two["texts"]))}
    ranges = [found["range"] for found in (one, two) if found["range"] is not None]
    spans = [min(low for low, _ in ranges), max(high for _, high in ranges)] if ranges else None
    return {"numbers": one["numbers"] + two["numbers"], "range": spans}
