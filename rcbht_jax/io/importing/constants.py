"""Numbers that are constant in each recording of a source: they describe the recordings, and are no signal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rcbht_jax._util.columns import base_and_unit, measured
from rcbht_jax.io.importing.guess import some
from rcbht_jax.io.importing.names import COUNTERS, column_name, of_any_arm
from rcbht_jax.io.importing.record import Record
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.trees import are_numbered
from rcbht_jax.io.importing.words import text


def constants_of(table: Table, unused: Iterable[str]) -> dict[str, float]:
    """The values of those columns of a recording's table that are one number throughout, missing cells aside.

    >>> constants_of(Table("a.csv", {"peg": np.full(3, 8.0), "q": np.arange(3.0)}), ["peg", "q"])
    {'peg': 8.0}
    """
    found = {}
    for name in unused:
        values = table.columns[name]
        known = values[np.isfinite(values)] if values.dtype.kind == "f" else values[:0]
        if len(known) and (known == known[0]).all() and base_and_unit(name)[0] not in COUNTERS:
            found[name] = float(known[0])
    return found


def describe(records: Sequence[Record], constants: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """Make constants by recording that all have, and that differ, their columns, as text; returns the name of each.

    >>> records = [Record(name, np.arange(2.0), np.zeros((2, 1)), ("Fz",), ("N",)) for name in "ab"]
    >>> describe(records, {"a": {"peg": 8.0, "mode": 7.0}, "b": {"peg": 10.0, "mode": 7.0}})
    {'peg': 'peg'}
    >>> records[1].columns
    {'peg': '10'}
    """
    given = [constants.get(record.name, {}) for record in records]
    those = [name for name in given[0] if all(name in one for one in given) and len({one[name] for one in given}) > 1]
    names = {name: column_name(of_any_arm(name)) for name in those}
    for record, own in zip(records, given, strict=True):
        for name, column in names.items():
            record.columns.setdefault(column, text(own[name]))
    return names


def without_properties(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Make axes that are one number in every recording their columns, as text; returns the records and those axes.

    All recordings have the same axes. Those with a unit, or named like an axis of a wrench, remain: a sensor may be at
    rest. So do all if nothing else is left.

    >>> values = np.stack([np.arange(3.0), np.full(3, 0.5)], 1)
    >>> records = [Record("a", np.arange(3.0), values, ("load", "mass"), ("", ""))]
    >>> [record], names = without_properties(records)
    >>> record.axes, record.columns, names
    (('load',), {'mass': '0.5'}, ['mass'])
    """
    axes, units = records[0].axes, records[0].units
    plain = [not unit and measured([axis], [""]) == "signal" for axis, unit in zip(axes, units, strict=True)]
    still = (all(np.ptp(record.values[:, k]) == 0 for record in records) for k in range(len(axes)))
    names = [axis for axis, *known in zip(axes, plain, still, strict=True) if all(known)]
    if not names or len(names) == len(axes):
        return list(records), []
    kept = [place for place, axis in enumerate(axes) if axis not in names]
    found = []
    for record in records:
        facts = {column_name(name): text(record.values[0, axes.index(name)]) for name in names}
        left = tuple(axes[place] for place in kept), tuple(units[place] for place in kept)
        notes = [note for note in record.notes if note.partition(":")[2] not in names]
        found.append(
            replace(record, values=record.values[:, kept], axes=left[0], units=left[1], notes=notes,
                    columns={**facts, **record.columns})
        )  # fmt: skip
    return found, names


def still_axes(records: Sequence[Record]) -> list[str]:
    """A remark on each of the same axes of all that never changes within some recording: its sensor may be dead.

    >>> values = np.stack([np.arange(3.0), np.full(3, 0.5)], 1)
    >>> still_axes([Record("a", np.arange(3.0), values, ("Fz", "Fx"), ("N", "N"))])
    ['Fx never changes within any recording; is its sensor connected?']
    """
    still = np.array([np.ptp(record.values, axis=0) == 0 for record in records]).sum(0)
    found = []
    for axis, count in zip(records[0].axes, still.tolist(), strict=True):
        where = "any recording" if count == len(records) else f"{count} of {len(records)} recordings"
        found += [f"{axis} never changes within {where}; is its sensor connected?"] if count else []
    return found


def at_once(records: Sequence[Record]) -> list[str]:
    """A remark on recordings of one file that were made at the same time: sensors of one trial, perhaps.

    They last as long at rates of their own, or overlap on a clock that began long before them.

    >>> values = np.zeros((40, 1))
    >>> wrist, ati = (Record(f"a.h5#{part}", np.linspace(0, 1, count), values[:count], ("Fz",), ("N",), part=part)
    ...               for part, count in (("wrist", 40), ("ati", 20)))
    >>> at_once([wrist, ati])[0].partition(";")[0]
    "Recordings of one file that were made at the same time may be of sensors of one trial: 'a.h5#wrist', 'a.h5#ati'"
    """
    files: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        # numbered parts are trials, each perhaps on a clock of its own
        if not (record.part.isdecimal() or are_numbered([record.part])):
            files.setdefault((record.file, record.arm), []).append(record)
    ordered = (sorted(those, key=lambda record: (record.origin, record.time[-1])) for those in files.values())
    found = dict.fromkeys(
        record.name for those in ordered for pair in pairwise(those) if _overlap(*pair) for record in pair
    )
    which = f"Recordings of one file that were made at the same time may be of sensors of one trial: {some(found)}"
    return [f"{which}; if so, keep one of them, or all on one side of every split."] if found else []


def _overlap(one: Record, other: Record) -> bool:
    """Whether two recordings, the first of which begins no later, were made at the same time."""
    length, end = one.time[-1], other.time[-1] + other.origin - one.origin
    counts = sorted((len(one.time), len(other.time)))
    close = max(0.02, 2 / counts[0]) * length  # two samples of the slower one, at least
    as_long = one.origin == other.origin and abs(end - length) < close and 3 * counts[0] < 2 * counts[1]
    return bool(as_long or (one.origin > length and other.origin < one.origin + length))
