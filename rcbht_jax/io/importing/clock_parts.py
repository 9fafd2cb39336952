"""Times in several columns: a date, a time of day and milliseconds, or seconds and a rest."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import TIMES, TIMES_ABROAD, UNITS, base_and_unit, snake
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table

JOINT = " + "  # between the names of columns that are one time
_DATES = ("date", "datum", "data", "fecha", "дата", "日期", "日付")
_CLOCKS = ("uhrzeit", "time_of_day", "heure", "hora", "ora", "时刻", "時刻", *TIMES, *TIMES_ABROAD)
_REST = {"millis": "ms", "millisec": "ms", "millisecs": "ms", "micros": "us", "microsec": "us", "nanos": "ns"}
_OF_DAY = re.compile(r"(\d{1,2}:\d{2}:\d{2})([.,]\d+)?(\s*[AaPp]\.?[Mm]\.?)?")
_DATE = re.compile(r"\d{1,4}([-./ ])\w{1,9}\1\d{1,4}|\d{8}")
_GERMAN = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})")
_HEAD = re.compile(r"(|.*[./_ ])(?:secs?|seconds|s)")


def with_whole_times(table: Table, mapping: Mapping) -> Table:
    """The table with one column of time where several hold its parts; else the table itself.

    A date that stays the same also remains a column. What a mapping uses is not joined.

    >>> columns = {"Date": ["2026-05-01"] * 2, "Time": ["12:00:00"] * 2, "ms": [5.0, 10.0], "Fz": [1.0, 2.0]}
    >>> whole = with_whole_times(Table("a.csv", {name: np.array(one) for name, one in columns.items()}), Mapping())
    >>> list(whole.columns), whole.columns["Date + Time + ms"].tolist()
    (['Date + Time + ms', 'Date', 'Fz'], ['2026-05-01T12:00:00.005', '2026-05-01T12:00:00.010'])
    """
    if mapping.source_rate is not None or mapping.time in table.columns:
        return table
    stated = {*(one.column for one in mapping.channels), *(one.column for one in mapping.annotations), mapping.group}
    bases: dict[str, str] = {}
    for name in table.columns:
        if name not in stated:
            for base in (base_and_unit(name)[0], name):
                bases.setdefault(snake(base).replace(" ", "_"), name)
    found = _of_text(table, bases) or _with_rest(table, bases)
    if found is None:
        return table
    parts, whole = found
    name = JOINT.join(parts)
    kept = [part for part in parts[:1] if _is(table, part, _DATE) and len(np.unique(table.columns[part])) == 1]
    rest = {key: column for key, column in table.columns.items() if key not in parts or key in kept}
    units = {**table.units, **({name: "s"} if whole.dtype.kind == "f" else {})}
    return replace(table, columns={name: whole, **rest}, units=units)


def _of_text(table: Table, bases: dict[str, str]) -> tuple[list[str], NDArray[Any]] | None:
    """A time of day as text with its date before or its milliseconds behind it, and their columns; None = neither."""
    clock = next((bases[word] for word in _CLOCKS if word in bases and _is(table, bases[word], _OF_DAY)), "")
    if not clock:
        return None
    times = table.columns[clock].tolist()
    found = [match.groups("") for match in map(_OF_DAY.fullmatch, times) if match]
    if len(found) < len(times):  # a cell is empty, or another kind of time
        return None
    parts = [clock]
    if not any(fraction for _, fraction, _ in found) and (finer := _rest(table, bases, "")):
        rest, digits = finer
        parts.append(rest)
        counts = table.columns[rest].astype(np.int64).tolist()
        found = [(time, f".{count:0{digits}}", half) for (time, _, half), count in zip(found, counts, strict=True)]
    texts = [f"{time}{fraction}{half}" for time, fraction, half in found]
    if date := next((bases[word] for word in _DATES if word in bases and _is(table, bases[word], _DATE)), ""):
        parts.insert(0, date)
        texts = [f"{_iso(day)}{time}" for day, time in zip(table.columns[date].tolist(), texts, strict=True)]
    return (parts, np.array(texts)) if len(parts) > 1 else None


def _iso(date: str) -> str:
    """A date and what separates it from a time: as ISO 8601 has them where the order of day and month is known."""
    if match := _GERMAN.fullmatch(date):
        return f"{match[3]}-{int(match[2]):02}-{int(match[1]):02}T"
    if match := re.fullmatch(r"(\d{4})[-/.]?(\d{2})[-/.]?(\d{2})", date):
        return f"{match[1]}-{match[2]}-{match[3]}T"
    return f"{date} "


def _with_rest(table: Table, bases: dict[str, str]) -> tuple[list[str], NDArray[Any]] | None:
    """Whole seconds with the milliseconds or microseconds beside them, such as tv_sec and tv_usec; None = none are."""
    for base, name in bases.items():
        values = table.columns[name]
        head = match[1] if (match := _HEAD.fullmatch(base)) else "" if base in TIMES else None
        if head is None or values.dtype.kind != "f" or base_and_unit(name)[1] not in ("", "s"):
            continue
        if not (np.isfinite(values) & (values == np.round(values))).all():
            continue
        if len(values) > 1 and (np.diff(values) > 0).mean() > 0.9:  # each recording of a table may begin anew
            continue
        finer = _rest(table, bases, head)
        if finer and finer[1] < 9:  # nanoseconds stay apart, where doubles hold them
            rest, digits = finer
            times = values + table.columns[rest] / 10.0**digits
            if (np.diff(times) >= 0).all():  # else they are parts of a minute
                return [name, rest], times
    return None


def _rest(table: Table, bases: dict[str, str], head: str) -> tuple[str, int] | None:
    """A column of whole milliseconds, microseconds or nanoseconds below a second, and its number of digits."""
    for base, name in bases.items():
        values, word = table.columns[name], base.removeprefix(head)
        unit = _REST.get(word, UNITS.get(word, ""))
        digits = {"ms": 3, "us": 6, "ns": 9}.get(unit, 0) if base.startswith(head) and values.dtype.kind == "f" else 0
        if digits and ((values >= 0) & (values < 10**digits) & (values == np.round(values))).all():
            return name, digits
    return None


def _is(table: Table, name: str, form: re.Pattern[str]) -> bool:
    """Whether the first cell of a column of text has a form."""
    values = table.columns[name]
    return values.dtype.kind == "U" and len(values) > 0 and bool(form.fullmatch(str(values[0])))
