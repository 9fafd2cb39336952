"""Tables in long form, a row for each time and channel, as data frames are stacked: with a column per channel again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit, unit_of_time
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.names import wrenches
from rcbht_jax.io.importing.table import Table

UNITS = ("unit", "units")
VALUES = ("value", "_value", "values", "val", "reading", "measurement")
PROBES = 64  # cells of a column that are looked at first


def widened(table: Table, mapping: Mapping) -> Table:
    """The table with a column per channel, if a column of text names the axes of a wrench; else the table itself.

    All other columns but one, the values, and perhaps their units, must be the same for every channel. Where rows are
    missing, so are the values: rows of one time and recording belong together. Channels that a mapping states are
    columns of the result.

    >>> cells = {"t": np.repeat([0.0, 0.1], 3), "axis": np.tile(["Fx", "Fy", "Fz"], 2), "value": np.arange(6.0)}
    >>> wide = widened(Table("a.csv", cells), Mapping())
    >>> {name: values.tolist() for name, values in wide.columns.items()}
    {'t': [0.0, 0.1], 'Fx': [0.0, 3.0], 'Fy': [1.0, 4.0], 'Fz': [2.0, 5.0]}
    """
    if mapping.channels and all(channel.column in table.columns for channel in mapping.channels):
        return table
    for name, values in table.columns.items():
        some = np.concatenate([values[:PROBES], values[:: max(len(values) // PROBES, 1)]])  # from everywhere
        if values.dtype.kind == "U" and wrenches(np.unique(some).tolist()) and (found := _widened(table, name)):
            return found
    return table


def _widened(table: Table, name: str) -> Table | None:
    """The table with a column for each value of one of its columns; None = its other columns do not agree."""
    channels = np.unique(table.columns[name])
    rows = [np.flatnonzero(table.columns[name] == channel) for channel in channels]
    if len({len(one) for one in rows}) > 1:
        return _joined(table, name, channels, rows)
    others = {key: [values[one] for one in rows] for key, values in table.columns.items() if key != name}
    shared = {
        key: parts[0]
        for key, parts in others.items()
        if all(np.array_equal(parts[0], part, equal_nan=part.dtype.kind == "f") for part in parts)
    }
    own = {key: parts for key, parts in others.items() if key not in shared}
    units = {key: parts for key, parts in own.items() if key.lower() in UNITS}
    # A number for each channel, such as that of a series, says nothing about the samples.
    own = {key: parts for key, parts in own.items() if key in units or any((part != part[0]).any() for part in parts)}
    numbers = [parts for key, parts in own.items() if key not in units and parts[0].dtype.kind != "U"]
    if len(numbers) != 1 or len(own) > 1 + len(units):
        return None
    columns = shared | dict(zip(map(str, channels), numbers[0], strict=True))
    return replace(table, columns=columns, units=_units(table, channels, rows))


def _units(table: Table, channels: NDArray[np.str_], rows: list[NDArray[np.intp]]) -> dict[str, str]:
    """The units of the table, and of each channel where a column states it."""
    stated = {
        str(channel): split_unit(f"x [{values[own[0]]}]")[1]
        for key, values in table.columns.items()
        if key.lower() in UNITS
        for channel, own in zip(channels, rows, strict=True)
    }
    return {**table.units, **stated}


def _joined(table: Table, name: str, channels: NDArray[np.str_], rows: list[NDArray[np.intp]]) -> Table | None:
    """As :func:`_widened` where channels lack rows, if one column of numbers is called a value and another a time."""
    called = {key.lower(): key for key in table.columns}
    value = next((called[word] for word in VALUES if word in called), "")
    keys = [key for key in table.columns if key not in (name, value) and key.lower() not in UNITS]
    if not value or table.columns[value].dtype.kind == "U" or not any(map(unit_of_time, keys)):
        return None
    codes = np.stack([np.unique(table.columns[key], return_inverse=True)[1] for key in keys])
    order = sorted(range(len(keys)), key=lambda number: codes[number].max())  # of one recording, then of one time
    places, first, row = np.unique(codes[order], axis=1, return_index=True, return_inverse=True)
    columns = {key: table.columns[key][first] for key in keys}
    for channel, own in zip(channels, rows, strict=True):
        if len(np.unique(row.ravel()[own])) < len(own):
            return None
        columns[str(channel)] = np.full(places.shape[1], np.nan)
        columns[str(channel)][row.ravel()[own]] = table.columns[value][own]
    return replace(table, columns=columns, units=_units(table, channels, rows))
