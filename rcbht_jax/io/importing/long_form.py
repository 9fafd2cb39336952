"""Tables in long form, a row for each time and channel, as data frames are stacked: with a column per channel again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.names import wrenches
from rcbht_jax.io.importing.table import Table

PROBES = 64  # cells of a column that are looked at first


def widened(table: Table, mapping: Mapping) -> Table:
    """The table with a column per channel, if a column of text names the axes of a wrench; else the table itself.

    All other columns but one, the values, and perhaps their units, must be the same for every channel.

    >>> cells = {"t": np.repeat([0.0, 0.1], 3), "axis": np.tile(["Fx", "Fy", "Fz"], 2), "value": np.arange(6.0)}
    >>> wide = widened(Table("a.csv", cells), Mapping())
    >>> {name: values.tolist() for name, values in wide.columns.items()}
    {'t': [0.0, 0.1], 'Fx': [0.0, 3.0], 'Fy': [1.0, 4.0], 'Fz': [2.0, 5.0]}

    Args:
        table: as read.
        mapping: whose channels, if it states some, are columns of the result.
    """
    if mapping.channels and all(channel.column in table.columns for channel in mapping.channels):
        return table
    for name, values in table.columns.items():
        if values.dtype.kind == "U" and _names_axes(values) and (found := _widened(table, name)):
            return found
    return table


def _names_axes(values: NDArray[np.str_]) -> bool:
    """Whether cells from the beginning and from everywhere name the axes of a wrench."""
    some = np.concatenate([values[:PROBES], values[:: max(len(values) // PROBES, 1)]])
    return bool(wrenches(np.unique(some).tolist()))


def _widened(table: Table, name: str) -> Table | None:
    """The table with a column for each value of one of its columns; None = its other columns do not agree."""
    channels = np.unique(table.columns[name])
    rows = [np.flatnonzero(table.columns[name] == channel) for channel in channels]
    if len({len(one) for one in rows}) > 1:
        return None
    others = {key: [values[one] for one in rows] for key, values in table.columns.items() if key != name}
    shared = {key: parts[0] for key, parts in others.items() if all(_equal(parts[0], part) for part in parts)}
    own = {key: parts for key, parts in others.items() if key not in shared}
    units = {key: parts for key, parts in own.items() if key.lower() in ("unit", "units")}
    numbers = [parts for key, parts in own.items() if key not in units and parts[0].dtype.kind != "U"]
    if len(numbers) != 1 or len(own) > 1 + len(units):
        return None
    stated = {
        str(channel): split_unit(f"x [{part[0]}]")[1]
        for parts in units.values()
        for channel, part in zip(channels, parts, strict=True)
    }
    columns = shared | dict(zip(map(str, channels), numbers[0], strict=True))
    return replace(table, columns=columns, units={**table.units, **stated})


def _equal(one: NDArray[np.generic], other: NDArray[np.generic]) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
