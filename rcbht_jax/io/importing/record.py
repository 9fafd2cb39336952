"""Recordings of a table by a mapping: split, scaled, annotated, not yet on a common grid."""

from __future__ import annotations

import re
from collections.abc import Iterator
from collections.abc import Mapping as AnyMapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.columns import SECONDS, TIMES, base_and_unit
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import conform
from rcbht_jax.io.importing.arms import column_of_arms
from rcbht_jax.io.importing.clock import first_second, no_time, seconds_of
from rcbht_jax.io.importing.given import Given
from rcbht_jax.io.importing.mapping import Mapping, Track, Value, check_bias
from rcbht_jax.io.importing.names import column_name
from rcbht_jax.io.importing.rows import filled, from_each_start, rows_of_groups, with_values
from rcbht_jax.io.importing.table import Interval, Table
from rcbht_jax.io.importing.timing import unit_of_times
from rcbht_jax.io.importing.words import OUTCOMES, is_outcome, of_numbers, text, words_of_numbers
from rcbht_jax.labels import AXES
from rcbht_jax.types import STANDARD_COLUMNS

Row = AnyMapping[str, str]  # of the table of recordings


@dataclass(frozen=True)
class Record:
    """One recording as it was sampled."""

    name: str  # unique in the source
    time: Float[np.ndarray, " sample"]  # s, increasing
    values: Float[np.ndarray, "sample axis"]  # finite, in the units of the axes
    axes: tuple[str, ...]
    units: tuple[str, ...]
    columns: dict[str, str | float] = field(default_factory=dict)
    intervals: list[Interval] = field(default_factory=list)  # s from the first sample
    notes: list[str] = field(default_factory=list)
    origin: float = 0.0  # s, of the first sample on the source's clock
    part: str = ""  # of the file, as the name ends with it; "" = the whole file
    listed: bool = False  # in the table of recordings
    doubts: list[str] = field(default_factory=list)  # about its annotations and its tare

    @property
    def file(self) -> str:
        """The name without the part."""
        return self.name.removesuffix(f"#{self.part}") if self.part else self.name

    @property
    def arm(self) -> str:
        """The topic that the part names, or the value of a column "arm"; "" = neither."""
        return self.part if self.part.startswith("/") else str(self.columns.get("arm", ""))

    @property
    def trial_part(self) -> str:
        """The part without the arm: that of the trial."""
        return without_arm(self.part, self.arm)

    @property
    def folder(self) -> str:
        """The folder of the file, relative to the source; "" = the source itself."""
        parent = str(PurePosixPath(self.file).parent)
        return "" if parent == "." else parent

    @property
    def period(self) -> float:
        """Time between two samples, s; gaps do not count."""
        return conform.clock(self.time).period

    @property
    def end(self) -> float:
        """One period after the last sample, s."""
        return float(self.time[-1]) + self.period


def records(
    table: Table, mapping: Mapping, rows: AnyMapping[str, Row] | None = None
) -> Iterator[Record | tuple[str, str]]:
    """The recordings of one table; for one that cannot be used its name and the reason.

    ``rows`` are those of the table of recordings by FILE#PART, part or file, for the columns that come from there.

    >>> table = Table("a.csv", {"t": np.arange(4) * 0.1, "Fz": np.ones(4), "id": np.array([1.0, 1, 2, 2])})
    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> mapping = Mapping((Channel("Fz", unit="kN", scale=0.001),), time="t", group="id")
    >>> [(record.name, record.values[0, 0].item()) for record in records(table, mapping)]
    [('a.csv#1', 0.001), ('a.csv#2', 0.001)]

    Raises:
        InputError: a column of the mapping is missing, or is text where numbers are needed.
    """
    _check(table, mapping)
    count = len(next(iter(table.columns.values())))
    parts: dict[str, NDArray[Any]] = {"": np.arange(count)}
    stamps: NDArray[np.float64] | None = None
    if mapping.group:
        parts, again = _groups(table, mapping)
        table = replace(table, notes=(*table.notes, f"again:{again}")) if again else table
        sides = column_of_arms(table, mapping, parts)
        for name in filter(None, (mapping.group, sides)):
            group = table.columns[name]
            if ((group == "") if group.dtype.kind == "U" else ~np.isfinite(group)).any():
                yield table.name, f"rows without a value in {name} belong to no recording."
        if sides:
            arms = {value: table.columns[sides][rows] for value, rows in parts.items()}
            parts = {
                f"{value}#{arm}": parts[value][own == arm]
                for value, own in arms.items()
                for arm in np.unique(own)
                if arm
            }
    elif (stamps := _readable_stamps(table, mapping, parts[""])) is not None:
        several = from_each_start(stamps)
        if len(several) > 1:
            parts = {str(number): part for number, part in enumerate(several, 1)}
            table = replace(table, notes=(*table.notes, f"restarts:{len(parts) - 1}"))
    given = _given(table, mapping, parts)
    for value, part in parts.items():
        name = f"{table.name}#{value}" if value else table.name
        place = "#".join(filter(None, [table.part, value]))
        row = next((rows[key] for key in (name, place, table.file) if key in rows), None) if rows else None
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
                record = _record(table, mapping, part, name, row or {}, stamps)
            begin = record.origin if mapping.time else record.origin + part[0] * record.period
            intervals, doubts = given.of(begin, record.end, record.period)
            record.intervals[:0], record.doubts[:0] = intervals, doubts
            yield replace(record, part=place, listed=row is not None)
        except InputError as error:
            yield name, str(error)
    if lost := given.lost:
        yield table.name, lost


def _given(table: Table, mapping: Mapping, parts: dict[str, NDArray[Any]]) -> Given:
    """The annotations of a table; those of a file of several recordings are of the one on whose stretch they lie."""
    arms = mapping.group and mapping.columns.get("arm", Value()).column == mapping.group  # of the same trial
    if not table.intervals or len(parts) == 1 or arms:
        return Given(table.intervals)
    try:
        rows, _, _ = with_values(table, mapping, np.sort(np.concatenate(list(parts.values()))))
        stamps = _stamps(table, mapping, rows)
    except InputError:  # which every recording says
        return Given(table.intervals, shared=True)
    known = stamps[np.isfinite(stamps)]
    if mapping.time:
        steps = np.diff(known)
        whole = len(known) > 1 and bool((steps >= 0).all() or (steps <= 0).all())
    else:
        whole = len(known) > 1 and all((np.diff(part) == 1).all() for part in parts.values())
    if not whole:
        return Given(table.intervals, shared=True)
    period = float(np.median(np.abs(np.diff(known))))  # gaps do not count
    origin = _on_clock(table, mapping, rows, float(known.min()))
    return Given(table.intervals, (origin, float(np.ptp(known)) + period, period))


def _groups(table: Table, mapping: Mapping) -> tuple[dict[str, NDArray[Any]], int]:
    """The rows of each recording of a table with a group, by its name; how often a value of it comes again as one."""
    every = np.arange(len(table.columns[mapping.group]))
    arms = mapping.columns.get("arm", Value()).column == mapping.group  # whose blocks may take turns
    return rows_of_groups(table, mapping.group, None if arms else lambda: _readable_stamps(table, mapping, every))


def rows_of_recordings(table: Table, mapping: Mapping) -> list[NDArray[Any]]:
    """The rows of each recording of a table, by its group, or by where numbers of its time start anew.

    >>> table = Table("a.csv", {"t": np.tile(np.arange(20) * 0.01, 2)})
    >>> [rows[0].item() for rows in rows_of_recordings(table, Mapping(time="t"))]
    [0, 20]

    Raises:
        InputError: the column of the group has more values than files hold recordings.
    """
    if mapping.group:
        return list(_groups(table, mapping)[0].values())
    every = np.arange(len(next(iter(table.columns.values()))))
    numbers = mapping.time in table.columns and table.columns[mapping.time].dtype.kind != "U"
    stamps = _readable_stamps(table, mapping, every) if numbers else None
    return [every] if stamps is None else from_each_start(stamps)


def _on_clock(table: Table, mapping: Mapping, rows: NDArray[Any], first: float) -> float:
    """The first of the times of rows on the source's clock; times of text begin at their own."""
    texts = table.columns[mapping.time][rows] if mapping.time else rows
    return first + (first_second(texts.tolist()) if texts.dtype.kind == "U" else 0.0)


def without_arm(part: str, arm: str) -> str:
    """The part of a file without the arm that it names.

    >>> without_arm("demo_0#left", "left"), without_arm("/ft_sensor", "/ft_sensor")
    ('demo_0', '')
    """
    return "#".join(word for word in part.split("#") if word != arm)


def check_columns(table: Table, mapping: Mapping) -> None:
    """Check that a table has the columns of a mapping without which it is no recording: numbers, time and group.

    >>> check_columns(Table("a.csv", {"t": np.arange(4.0)}), Mapping(time="t"))

    Raises:
        InputError: a column is missing, or is text where numbers are expected.
    """
    numbers = [channel.column for channel in mapping.channels] + [mapping.nanoseconds]
    for name in filter(None, [*numbers, mapping.time, mapping.group]):
        if name not in table.columns:
            raise InputError(no_column(table, name))
        if name in numbers and table.columns[name].dtype.kind == "U":
            raise InputError(f"{table.name}: column {name!r} is text; expected numbers.")


def no_column(table: Table, name: str) -> str:
    """The sentence about a column that a table lacks.

    >>> no_column(Table("a.csv", {"t": np.arange(4.0)}), "Fz")
    "a.csv has no column 'Fz'; it has t."
    """
    return f"{table.name} has no column {name!r}; it has {', '.join(list(table.columns)[:20])}."


def _check(table: Table, mapping: Mapping) -> None:
    check_columns(table, mapping)
    if not mapping.time and (mapping.source_rate or table.rate) is None:
        texts = (key for key, one in table.columns.items() if base_and_unit(key)[0] in TIMES and one.dtype.kind == "U")
        if name := next(texts, ""):
            found = no_time(table.columns[name][:1].tolist() or [""])
            raise InputError(f"{table.name}: column {name!r} holds {found}")
        raise InputError(f"{table.name} has no column of time; name it in a map, or give --source-rate.")


def _record(
    table: Table, mapping: Mapping, rows: NDArray[Any], name: str, row: Row, known_stamps: NDArray[np.float64] | None
) -> Record:
    logged = rows
    rows, raw, padded = with_values(table, mapping, rows)
    if known_stamps is not None and len(known_stamps) == len(rows):
        stamps = known_stamps  # to read texts again takes long
    else:
        stamps = _stamps(table, mapping, rows)
    counted = rows
    if len(stamps) > 1 and (np.diff(stamps) < 0).all():  # newest first, as exports of databases are
        rows, raw, stamps = rows[::-1], raw[::-1], stamps[::-1]
        padded.append("reversed")
    new = conform.fresh(raw)
    padded += [f"held:{len(raw) - len(new)}"] if len(new) < len(raw) else []
    values = raw * [channel.scale for channel in mapping.channels] + [channel.offset for channel in mapping.channels]
    measured = stamps[new]
    known = measured[np.isfinite(measured)]
    first = known.min() if len(known) else 0.0
    time, values, notes = conform.tidy(measured - first, values[new])
    given = {target: _value(table, source, rows, row) for target, source in mapping.columns.items()}
    columns = _facts(table) | {target: value for target, value in given.items() if value is not None}
    notes += [f"changes:{target}" for target, value in given.items() if value is None]
    intervals = list[Interval]()
    if tracks := [track for track in mapping.annotations if track.column in table.columns]:
        order = np.argsort(stamps, kind="stable")
        order = order[stamps[order] >= first]
        for track in tracks:
            column = table.columns[track.column]
            if len(rows) < len(logged) and not filled(column[rows]).any():
                own = logged[filled(column[logged])]
                intervals += _of_messages(track, _stamps(table, mapping, own) - first, column[own])
                continue
            intervals += stretches(track, stamps[order] - first, column[rows][order])
    notes += [f"saturated:{mapping.axes[axis]}" for axis in conform.saturated(values)]  # a rotation would hide it
    notes += [f"stuck:{mapping.axes[axis]}" for axis in conform.stuck(values)]
    zeros = len(raw) - int(np.flatnonzero(raw.any(1)).max(initial=-1)) - 1
    notes += [*padded, f"zeros:{zeros}"] if conform.HELD <= zeros < len(raw) else padded
    values = _moved(mapping, time, values)
    origin = _on_clock(table, mapping, counted, float(first))
    short = time[-1] < mapping.tare
    doubts = ["is no longer than the tare: the mean of all of it was subtracted."] if short else []
    flags = [*table.notes, *notes]
    return Record(name, time, values, mapping.axes, mapping.units, columns, intervals, flags, origin, doubts=doubts)


def _facts(table: Table) -> dict[str, str | float]:
    """What a table states about its recordings, by column."""
    columns: dict[str, str | float] = {}
    for key, fact in table.facts.items():
        short = re.split("[./]", key.lower())[-1]
        columns[short if short in (*STANDARD_COLUMNS, "trial") else column_name(key)] = fact
        if short == "success" and is_outcome("success", [fact]):  # a word of "outcome" stays that of its file
            columns.setdefault("outcome", OUTCOMES[text(fact).lower()])
    return columns


def _stamps(table: Table, mapping: Mapping, rows: NDArray[Any]) -> NDArray[np.float64]:
    """Times of rows, s."""
    if not mapping.time:
        return np.arange(len(rows)) / float(mapping.source_rate or table.rate or 1)
    column: NDArray[Any] = table.columns[mapping.time][rows]
    if column.dtype.kind == "U":
        try:
            return seconds_of(column.tolist())
        except ValueError:
            raise InputError(f"column {mapping.time!r} holds {no_time(column.tolist())}") from None
    scaled: NDArray[np.float64] = column * SECONDS[unit_of_times(table, mapping)]
    return scaled + table.columns[mapping.nanoseconds][rows] * 1e-9 if mapping.nanoseconds else scaled


def _readable_stamps(table: Table, mapping: Mapping, rows: NDArray[Any]) -> NDArray[np.float64] | None:
    """Times of rows, s; None = there is no column of times, or one is none, perhaps in a row without values."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _stamps(table, mapping, rows) if mapping.time else None
    except InputError:
        return None


def _value(table: Table, source: Value, rows: NDArray[Any], row: Row) -> str | float | None:
    """A column's value for a recording, empty cells aside; None = it changes within it."""
    if source.value:
        return source.value
    words = source.words
    if source.folder:
        found = source.folder_of(table.file)
    elif source.table:
        found = row.get(source.table, "")
    elif source.column in table.columns:
        column = table.columns[source.column][rows]
        words = words if column.dtype.kind == "U" else words_of_numbers(words)
        if source.last:
            column = column[filled(column)][-1:]
        values = {text(value) for value in np.unique(column)} - {""}
        if len(values) > 1:
            return None
        found = values.pop() if values else ""
    else:
        fact = table.facts.get(source.column, "")
        found, words = text(fact), words if isinstance(fact, str) else words_of_numbers(words)
    return words.get(found, words.get(found.lower(), found))


def stretches(track: Track, time: NDArray[np.float64], column: NDArray[Any]) -> list[Interval]:
    """An interval for every stretch of one value, to the beginning of the next; empty values mark nothing.

    The end of the last is infinite: that of the recording.

    >>> stretches(Track("phase", "p"), np.arange(4) * 0.5, np.array(["a", "a", "", "b"]))
    [('phase', 'a', 0.0, 1.0), ('phase', 'b', 1.5, inf)]
    """
    if column.dtype.kind != "U":
        column, track = np.array([text(value) for value in column], np.str_), of_numbers(track)
    begin = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    end = np.append(time[begin[1:]], np.inf)
    found = []
    for start, stop, value in zip(time[begin].tolist(), end.tolist(), column[begin].tolist(), strict=True):
        label = track.words.get(value, value)
        if label and label not in track.ignore:
            found.append((track.track, label, start, stop))
    return found


def _of_messages(track: Track, time: NDArray[np.float64], column: NDArray[Any]) -> list[Interval]:
    """As :func:`stretches`, for values that hold until the next message."""
    begin = max(int(np.searchsorted(time, 0.0, "right")) - 1, 0)
    return stretches(track, np.maximum(time[begin:], 0.0), column[begin:]) if len(time) else []


def _moved(mapping: Mapping, time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bias, tare and rotation."""
    if mapping.bias:
        check_bias(mapping, values.shape[1])
        values = values - np.array(mapping.bias)
    if mapping.tare:
        half = np.median(np.diff(time)) / 2 if len(time) > 1 else 0.0  # stamps are rounded
        values = values - values[: max(1, int(np.searchsorted(time, mapping.tare - half)))].mean(0)
    matrix = mapping.matrix()
    if matrix is None:
        return values
    values, triples = values.copy(), 0
    for triple in (AXES[:3], AXES[3:]):
        if set(triple) <= set(mapping.axes):
            where = [mapping.axes.index(axis) for axis in triple]
            values[:, where] = values[:, where] @ matrix.T
            triples += 1
    if not triples:
        raise InputError("a rotation needs channels named Fx Fy Fz or Mx My Mz.")
    return values
