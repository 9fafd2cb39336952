"""The column of time of a table, and its unit, from names and values."""

from __future__ import annotations

import re
from collections.abc import Mapping as AnyMapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import SECONDS, TIMES, TIMES_ABROAD, base_and_unit, snake, split_unit
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import names
from rcbht_jax.io.importing.clock import is_time
from rcbht_jax.io.importing.clock_parts import JOINT
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table

SENSIBLE = 1e-4, 0.5  # s: steps of samples that make a unit of time likely
_SECONDS = re.compile(r"^(|.*[./_ ])(?:secs?|seconds)$")
_DAYS = (2e4, 8e4), (6e5, 8e5)  # days since 1900 (spreadsheets) and since the year 0 (MATLAB), of our time
_LAST = ("time", "times", "timestamp", "timestamps", "stamp", "stamps", "duration", "datenum", *TIMES_ABROAD)


def with_one_time(path: Path, columns: AnyMapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The columns without times that stand again before further signals, as LabVIEW writes them.

    >>> times = np.arange(3.0)
    >>> list(with_one_time(Path("a.lvm"), {"X_Value": times, "Fx": times, "X_Value.2": times, "Fz": times}))
    ['X_Value', 'Fx', 'Fz']

    Raises:
        InputError: they are not those of the first such column, within half a sample.
    """
    names = list(columns)
    more = list[str]()
    for name, first in ((name, match[1]) for name in names[:-1] if (match := re.fullmatch(r"(.+)\.\d+", name))):
        if base_and_unit(first)[0] not in (*TIMES, *TIMES_ABROAD) or first not in names[: names.index(name) - 1]:
            continue  # no signals between them
        own, others = columns[first], columns[name]
        if own.dtype.kind != "f" or others.dtype.kind != "f":
            continue
        own, others = (both := np.stack([own, others]))[:, np.isfinite(both).all(0)]
        alike = np.array_equal(own, others)  # also where they start anew
        if not (alike or (_grow(own) and _grow(others))):
            continue
        if not alike and (np.abs(own - others) > np.median(np.abs(np.diff(own))) / 2).any():
            raise InputError(
                f"{path}: the times in column {name} are not those in {first}; save the signals of each one by one."
            )
        more.append(name)
    return {name: column for name, column in columns.items() if name not in more}


def with_time(table: Table, mapping: Mapping, free: list[str]) -> Mapping:
    """The mapping, which names no time, with the column of time and its unit, if one of the free columns can be one.

    >>> table = Table("a.csv", {"simTime": np.arange(9) * 0.01, "Fz": np.ones(9)})
    >>> mapping = with_time(table, Mapping(), ["simTime", "Fz"])
    >>> mapping.time, mapping.time_unit
    ('simTime', 's')
    """
    if joint := next((name for name in free if JOINT in name and _is_joint(table, name)), ""):
        return replace(mapping, time=joint, time_unit="s")
    # A table of messages may have empty columns called like a time: they are those of objects, such as a header.
    free = [name for name in free if table.columns[name].dtype.kind == "U" or np.isfinite(table.columns[name]).any()]
    parsed = {name: base_and_unit(name) for name in free}
    bases = {re.split(r"[./]", base)[-1]: name for name, (base, _) in reversed(parsed.items()) if grows(table, name)}
    bases |= {base: name for name, (base, _) in reversed(parsed.items())}
    if not {"min", "minute", "minutes"}.isdisjoint(bases):  # seconds beside them are those of a minute
        bases = {base: name for base, name in bases.items() if base not in ("sec", "secs", "seconds")}
    whole = _with_nanoseconds(table, free)
    # The stamps of a header are better than times of receipt; else the order of the list decides.
    stamps = [name for name in whole if "stamp" in name.lower()]
    for candidate in (*stamps, *(bases[base] for base in TIMES if base in bases), *whole):
        unit = "s" if candidate in whole else parsed[candidate][1]
        values = table.columns[candidate]
        if values.dtype.kind == "U" and not are_dates(values):
            continue
        anew = parsed[candidate][0] == "x_value" and (values[1:] < values[:-1]).any()  # in each piece of LabVIEW's
        if (
            table.rate is not None and candidate not in whole and (anew or (values[1:] == values[:-1]).mean() > 0.01)
        ):  # too coarse for the rate
            continue
        unit = table.units.get(candidate) or (unit if unit in SECONDS else _unit(table, candidate))
        return replace(mapping, time=candidate, time_unit=unit, nanoseconds=whole.get(candidate, ""))
    if table.rate is not None:
        first = next(iter(table.columns), "")
        steps = np.diff(table.columns[first]) if first in free and _is_first(table, first) else np.zeros(1)
        counted = np.allclose(steps * table.rate, 1, atol=0.05)
        return replace(mapping, time=first, time_unit="s") if counted else mapping
    # A column in s that grows is a time in any language, such as an index that pandas wrote.
    stated = {name: table.units.get(name) or parsed[name][1] for name in free}
    timed = (name for name in free if stated[name] in SECONDS and grows(table, name))
    if index := next(timed, ""):
        return replace(mapping, time=index, time_unit=stated[index])
    if dated := next((name for name in free if is_clock(table.columns[name])), ""):
        return replace(mapping, time=dated, time_unit="s")
    if likely := _likely_time(table, free):
        return replace(mapping, time=likely, time_unit=_unit(table, likely))
    return mapping


def unit_of_times(table: Table, mapping: Mapping) -> str:
    """The unit of the times of a mapping: its own, else that of the file or of the name of the column, else s.

    >>> table = Table("a.csv", {"t_ms": np.arange(2.0)})
    >>> unit_of_times(table, Mapping(time="t_ms")), unit_of_times(table, Mapping(time="t_ms", time_unit="us"))
    ('ms', 'us')
    """
    stated = mapping.time_unit or table.units.get(mapping.time) or base_and_unit(mapping.time)[1]
    return stated if stated in SECONDS else "s"


def _is_joint(table: Table, name: str) -> bool:
    """Whether several columns were joined to this time, perhaps to one that does not exist."""
    values = table.columns[name]
    return bool(re.search(r"\d:\d", str(values[0]))) if values.dtype.kind == "U" else table.units.get(name) == "s"


def _likely_time(table: Table, free: list[str]) -> str:
    """A column that grows and is called like a time, lies in a group of times, or has no name; "" = there is none."""
    growing = [name for name in free if grows(table, name)]
    axes = "".join(names.preferred(names.wrenches(free)).values())
    paths = {name: re.split(r"[./]", snake(split_unit(name)[0])) for name in growing}
    called = [
        name for name, parts in paths.items() if set(parts[:-1]) & set(TIMES) or _is_called(table, name, parts[-1])
    ]
    # Where every sensor has times of its own, those of the wrench have its name.
    called.sort(key=lambda name: f"/{paths[name][-1]}_" not in axes)
    days = (name for name in growing if _in_days(table.columns[name]))
    nameless = (name for name in growing[:1] if name == next(iter(table.columns)) and _is_first(table, name))
    return next(iter([*called, *days, *nameless]), "")


def is_stamp(table: Table, name: str) -> bool:
    """Whether a column holds times of another sensor: it grows, and its path has a name of times.

    >>> columns = {"Fx.Data": np.ones(3), "Fx.Time": np.arange(3.0)}
    >>> [is_stamp(Table("a.mat", columns), name) for name in columns]
    [False, True]
    """
    parts = re.split(r"[./]", base_and_unit(name)[0])
    return len(parts) > 1 and bool(set(parts) & set(TIMES)) and grows(table, name)


def _is_called(table: Table, name: str, last: str) -> bool:
    """Whether a name ends in a word for a time, numbers aside, or begins with one and does not count steps."""
    words = re.split(r"[\W_]+", re.sub(r"_\d+$", "", last))
    return words[-1] in _LAST or (words[0] in _LAST and bool((np.diff(table.columns[name]) != 1).any()))


def _with_nanoseconds(table: Table, free: list[str]) -> dict[str, str]:
    """Columns of whole seconds, not all zero, and that of the nanoseconds beside each."""
    numeric = (name for name in free if table.columns[name].dtype.kind != "U")
    lower = {snake(name).replace("nano_sec", "nanosec"): name for name in numeric}
    found: dict[str, str] = {}
    for key, name in lower.items():
        if (match := _SECONDS.match(key)) and table.columns[name].any():
            rest = next((lower[match[1] + ending] for ending in names.NANOSECONDS if match[1] + ending in lower), "")
            if rest:
                found[name] = rest
    if "c0" in lower and "c1" in lower and _stamped(table.columns["c0"], table.columns["c1"]):
        found["c0"] = "c1"
    return found


def _stamped(seconds: NDArray[Any], rest: NDArray[Any]) -> bool:
    """Whether two nameless columns are the stamps of a ROS message, as ``ros2 topic echo --csv`` writes them."""
    whole = all((values == np.round(values)).all() for values in (seconds, rest))
    return bool(whole and seconds.min() > 1e9 and seconds.max() < 1e10 and rest.min() >= 0 and 1e8 < rest.max() < 1e9)


def grows(table: Table, name: str) -> bool:
    """Whether numbers grow, but where a recording ends and another begins.

    >>> [grows(Table("a.csv", {"t": np.array(times)}), "t") for times in ([0.0, 1.0, 1.0], [1.0, 0.0])]
    [True, False]
    """
    values = table.columns[name]
    return values.dtype.kind != "U" and _grow(values)


def _grow(values: NDArray[Any]) -> bool:
    steps = np.diff(values)
    return bool((steps > 0).any() and (steps >= 0).mean() > 0.9)


def are_dates(values: NDArray[Any]) -> bool:
    """Whether texts are times, by the first of them.

    >>> are_dates(np.array(["2024-05-01T12:00:00"])), are_dates(np.array(["push"]))
    (True, False)
    """
    return not len(values) or is_time(str(values[0]))


def is_clock(values: NDArray[Any]) -> bool:
    """Whether a column of text holds times of day that change with most rows.

    >>> is_clock(np.array(["10:00:00.1", "10:00:00.2"])), is_clock(np.array(["10:00:00.1"] * 9))
    (True, False)
    """
    known = values[values != ""] if values.dtype.kind == "U" else values[:0]
    return len(np.unique(known)) > len(values) / 2 and are_dates(known)


def _unit(table: Table, name: str) -> str:
    """Unit of time stamps without one: counts from a date show by their size, others by their steps."""
    values = table.columns[name]
    if values.dtype.kind == "U":
        return "s"
    if _in_days(values):
        return "d"
    known, unit = values[np.isfinite(values)], unit_by_size(values)
    if len(known) and known.min() >= 1e9 and known.max() < 1e10:  # s since 1970, however slow the log
        return "s"
    with np.errstate(over="ignore"):
        steps = _steps(known)
    if not (steps > 0).any():
        return unit
    step = float(np.median(steps[steps > 0]))
    seconds = step * SECONDS[unit]
    # No robot's wrench is logged at 1 Hz: those who count 0, 1, 2 count milliseconds.
    if seconds < 1 or (seconds == 1 and not names.wrenches(table.columns)):
        return unit
    likely = [finer for finer, scale in SECONDS.items() if SENSIBLE[0] <= step * scale < SENSIBLE[1]]
    return likely[0] if len(likely) == 1 else unit


def _steps(times: NDArray[Any]) -> NDArray[Any]:
    """Steps of times, forwards also where the newest comes first."""
    steps = np.diff(times)
    return -steps if (steps < 0).sum() > (steps > 0).sum() else steps


def unit_by_size(values: NDArray[Any]) -> str:
    """The unit of numbers that count from 1970, by their size; s for smaller ones.

    >>> unit_by_size(np.array([1.7e18])), unit_by_size(np.array([2.5]))
    ('ns', 's')
    """
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if largest > least), "s")


def _in_days(values: NDArray[Any]) -> bool:
    """Whether numbers count days, as spreadsheets and MATLAB do, in steps of samples."""
    if values.dtype.kind == "U":
        return False
    known = values[np.isfinite(values)]
    steps = _steps(known)
    first, last = known.min(initial=np.inf), known.max(initial=-np.inf)
    ours = any(low < first and last < high for low, high in _DAYS)
    return ours and bool((steps > 0).any()) and float(np.median(steps[steps > 0])) * SECONDS["d"] < SENSIBLE[1]


def _is_first(table: Table, name: str) -> bool:
    """Whether a nameless column, or the first of an array, grows like time, and not like a counter of rows."""
    values, others = table.columns[name], len(table.columns) - 1
    if values.dtype.kind == "U":
        return False
    step = np.diff(values)
    if len(values) < 3 or not np.isfinite(values).all() or not (step > 0).all() or (step == 1).all():
        return False
    head = name.removesuffix("_0")
    alone = values[0] == 0 and sum(key.startswith(f"{head}_") for key in table.columns) - 1 == others
    named = base_and_unit(name)[0] in ("c0", "unnamed: 0", "values_0") or (name != head and (alone or values[0] > 1e9))
    return bool(named and np.median(np.abs(step - np.median(step))) < np.median(step))
