"""What an import did with every file: imported, left out and why, copies, warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from rcbht_jax._util.printable import plural
from rcbht_jax.io.importing.record import Record
from rcbht_jax.io.importing.words import text
from rcbht_jax.labels import AXES


@dataclass
class ImportReport:
    """Result of an import. Names are relative to the source; a part of a file follows after "#"."""

    imported: list[str] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)  # name, reason
    duplicates: list[tuple[str, str]] = field(default_factory=list)  # name of the copy, what it copies
    warnings: list[tuple[str, str]] = field(default_factory=list)  # name, irregularity
    remarks: list[str] = field(default_factory=list)  # about all recordings
    understood: list[dict[str, str]] = field(default_factory=list)  # column, role, unit: of all files
    content_sha256: str = ""  # of every file read

    @property
    def first_reason(self) -> str:
        """The reason why the first file was left out, with its name; "" = none was."""
        name, reason = next(iter(self.skipped), ("", ""))
        return f" The first reason: {reason if name in reason else f'{name}: {reason}'}" if self.skipped else ""

    def to_dict(self) -> dict[str, Any]:
        """The report as plain lists and strings."""
        return asdict(self)


def without_copies(records: Sequence[Record], report: ImportReport, keep: bool = False) -> list[Record]:
    """The recordings, exact copies once unless ``keep``, in their order; copies and beginnings of others are reported.

    Copies whose columns or annotations contradict each other are all kept and noted ``contradictory-duplicate:OTHER``;
    a recording that is the beginning of a longer one is kept and noted ``beginning-of:OTHER``.

    >>> time, values = np.arange(5.0), np.arange(5.0)[:, None]
    >>> one, two = (Record(name, time, values, ("Fz",), ("N",)) for name in "ab")
    >>> report = ImportReport()
    >>> [record.name for record in without_copies([one, two], report)], report.duplicates
    (['a'], [('b', 'exact copy of a; imported once.')])
    """
    # Sorted by their bytes, a recording comes directly before those that begin with it.
    content = [((record.axes, record.units), np.ascontiguousarray(record.values).tobytes()) for record in records]
    order = sorted(range(len(records)), key=lambda number: (content[number], number))
    dropped: set[int] = set()
    same: list[int] = []  # recordings of equal values
    for place, number in enumerate(order):
        if same and content[number] != content[same[0]]:
            same = []
        twin = next((other for other in same if _facts(records[other]) == _facts(records[number])), None)
        if twin is not None:
            original = records[twin].name
            what = "imported all the same" if keep else "imported once"
            report.duplicates.append((records[number].name, f"exact copy of {original}; {what}."))
            if keep:
                _note(records[number], f"copy-of:{original}")
            else:
                dropped.add(number)
            continue
        if same:
            first, name = records[same[0]], records[number].name
            differs = f"identical to {first.name}, whose columns or annotations differ; both are imported."
            report.warnings.append((name, differs))
            _note(records[number], f"contradictory-duplicate:{first.name}")
            _note(first, f"contradictory-duplicate:{name}")
        same.append(number)
        longer = _longer(content, order, place)
        if longer is not None:
            name = records[longer].name
            report.duplicates.append((records[number].name, f"beginning of {name}; imported, and noted."))
            _note(records[number], f"beginning-of:{name}")
    return [record for number, record in enumerate(records) if number not in dropped]


def _longer(content: Sequence[tuple[tuple[tuple[str, ...], ...], bytes]], order: list[int], place: int) -> int | None:
    """A recording that begins with that at a place of the order and goes on."""
    kind, own = content[order[place]]
    for number in order[place + 1 :]:
        other, values = content[number]
        if other != kind or not values.startswith(own):
            return None
        if len(values) > len(own):
            return number
    return None


def _facts(record: Record) -> tuple[Any, ...]:
    """Columns and annotations as texts, of which those of unknown ends are equal."""
    return tuple(tuple(map(text, row)) for row in (*sorted(record.columns.items()), *record.intervals))


def _note(record: Record, flag: str) -> None:
    record.notes.append(flag.replace(";", ","))


def most_common(records: Sequence[Record], report: ImportReport) -> list[Record]:
    """The recordings with the most frequent axes and units, of those with forces if there are any; reports the others.

    Beside the wrench, a folder may hold as many files of another sensor.
    """
    kinds = Counter((record.axes, record.units) for record in records)
    if len(kinds) < 2:
        return list(records)
    common, count = max(kinds.items(), key=lambda kind: (not set(AXES).isdisjoint(kind[0][0]), kind[1]))
    for record in records:
        if (record.axes, record.units) != common:
            own, others = _axes(record.axes, record.units), _axes(*common)
            most = plural(count, "other has", "others have")
            reason = f"has the axes {own}; {most} {others}. Import it on its own."
            report.skipped.append((record.name, reason))
    return [record for record in records if (record.axes, record.units) == common]


def _axes(axes: Iterable[str], units: Iterable[str]) -> str:
    pairs = [f"{axis} ({unit})" if unit else axis for axis, unit in zip(axes, units, strict=True)]
    return ", ".join(pairs[:6]) + (f" and {len(pairs) - 6} more" if len(pairs) > 6 else "")
