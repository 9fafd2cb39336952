"""Rows of a table: which are samples, and which are of one recording."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import conform
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import in_order, text

MAX_GROUPS = 100_000
Stamps = Callable[[], NDArray[np.float64] | None]  # of all rows, s; None = there are none that can be read


def filled(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Where a column has values.

    >>> filled(np.array([1.0, np.nan])).tolist(), filled(np.array(["a", ""])).tolist()
    ([True, False], [True, False])
    """
    found: NDArray[np.bool_] = column != "" if column.dtype.kind == "U" else ~np.isnan(column)
    return found


def with_values(
    table: Table, mapping: Mapping, rows: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[np.float64], list[str]]:
    """Of a recording's rows those that are samples, their values ``[row, channel]``, and notes of what is left out.

    Rows without values are no samples where most are, where they are every second row, or where they hold what most
    samples lack.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> nan = np.nan
    >>> columns = {"t": np.arange(5.0), "Fz": np.array([1, nan, 2, nan, 3]), "q": np.array([nan, 7, nan, nan, nan])}
    >>> mapping = Mapping((Channel("Fz"),), time="t")
    >>> rows, values, notes = with_values(Table("a.csv", columns), mapping, np.arange(5))
    >>> rows.tolist(), values[:, 0].tolist(), notes
    ([0, 2, 3, 4], [1.0, 2.0, nan, 3.0], ['between:1'])
    """
    raw = np.stack([table.columns[channel.column][rows] for channel in mapping.channels], 1)
    raw = without_stand_ins(raw, mapping)
    known = ~np.isnan(raw).all(1)
    held = int(np.flatnonzero(known).max(initial=-1)) + 1 or len(rows)
    notes = [f"padded:{len(rows) - held}"] if held < len(rows) else []
    within = np.arange(len(rows)) < held
    if mapping.time and 1 < int(known.sum()) < held:
        within &= ~_no_samples(table, mapping, rows, known, held)
        notes += [f"between:{held - int(within.sum())}"] if within.sum() < held else []
    return rows[within], raw[within], notes


def _no_samples(
    table: Table, mapping: Mapping, rows: NDArray[Any], known: Bool[np.ndarray, " row"], held: int
) -> NDArray[np.bool_]:
    if known.sum() < held / 2 or conform.sparse(np.flatnonzero(known)):  # a log in the steps of something faster
        return ~known
    own = {mapping.time, mapping.nanoseconds, mapping.group, *(channel.column for channel in mapping.channels)}
    other = np.zeros(len(rows), bool)  # of messages of other topics
    for column in (table.columns[name][rows] for name in table.columns if name not in own):
        there = filled(column)
        if 2 * there[known].sum() < known.sum():
            other |= there
    return other & ~known


def without_stand_ins(values: NDArray[Any], mapping: Mapping) -> NDArray[Any]:
    """The values, NaN for those that a mapping calls missing."""
    if not mapping.missing:
        return values
    missing = np.isclose(values[..., None], mapping.missing, rtol=1e-6, atol=0.0).any(-1)  # a float32 is near
    return np.where(missing, np.nan, values)


def from_each_start(time: Float[np.ndarray, " sample"]) -> list[NDArray[np.int64]]:
    """The samples from each time at which that of a table begins again, each time about where it began first.

    All samples are one recording if some would be shorter than ``HELD``, or if there were too many.

    >>> [rows[0].item() for rows in from_each_start(np.tile(np.arange(20) * 0.01, 2))]
    [0, 20]
    """
    every = np.arange(len(time))
    starts = np.flatnonzero(np.diff(time) < 0) + 1
    if not 0 < len(starts) < MAX_GROUPS or not np.isfinite(time).all():
        return [every]
    bounds = np.concatenate([[0], starts, [len(time)]])
    shortest = (time[bounds[1:] - 1] - time[bounds[:-1]]).min()
    near = np.abs(time[starts] - time[0]) <= 0.1 * shortest
    return np.split(every, starts) if near.all() and np.diff(bounds).min() >= conform.HELD else [every]


def rows_of_groups(table: Table, name: str, stamps: Stamps | None) -> tuple[dict[str, NDArray[np.int64]], int]:
    """The rows of every value of a column but the empty one, and how often a value comes again as a recording.

    Where a value comes again after others, as trials that every session counts anew, each stretch is a recording,
    ``VALUE-1``, ``VALUE-2``, ..., if its time does not go on from the stretch before. ``stamps`` gives the times, which
    are read only then; without it, all rows of a value are one recording.

    >>> trial = np.repeat([1.0, 2.0, 1.0, 2.0], 10)
    >>> table = Table("a.csv", {"t": np.tile(np.arange(10.0), 4), "trial": trial})
    >>> groups, again = rows_of_groups(table, "trial", lambda: table.columns["t"])
    >>> {value: rows[0].item() for value, rows in groups.items()}, again
    ({'1-1': 0, '1-2': 20, '2-1': 10, '2-2': 30}, 2)
    >>> list(rows_of_groups(table, "trial", lambda: np.arange(40.0))[0])
    ['1-1', '1-2', '2-1', '2-2']

    Raises:
        InputError: the column has more values than files hold recordings.
    """
    values, which = np.unique(table.columns[name], return_inverse=True)
    if len(values) > MAX_GROUPS:
        raise InputError(f"{table.name}: {name} has {len(values)} values; it does not separate recordings.")
    order = np.argsort(which, kind="stable")
    bounds = np.cumsum(np.bincount(which, minlength=len(values)))[:-1]
    place = np.cumsum(filled(table.columns[name]))  # rows without a value come between no stretches
    groups = {text(value): rows for value, rows in zip(values, np.split(order, bounds), strict=True) if text(value)}
    if values.dtype.kind == "U":
        groups = {value: groups[value] for value in sorted(groups, key=in_order)}
    begins = {value: found for value, rows in groups.items() if len(found := _begins(place[rows]))}
    if not begins or stamps is None:
        return groups, 0
    times = stamps()
    parts: dict[str, NDArray[np.int64]] = {}
    for value, rows in groups.items():
        starts = begins.get(value, np.zeros(0, np.int64))
        starts = starts if times is None else starts[_anew(times[rows], starts)]
        parts |= dict(_stretches(value, np.split(rows, starts), groups.keys()))
    return parts, len(parts) - len(groups)


def _begins(place: Int[np.ndarray, " row"]) -> NDArray[np.int64]:
    """Where stretches of rows begin after the first, if all are too long for those of sensors that take turns."""
    begins = np.flatnonzero(np.diff(place) > 1) + 1
    lengths = np.diff([0, *begins, len(place)])
    return begins if lengths.min() >= conform.HELD else begins[:0]


def _anew(times: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether the time does not go on where a stretch begins."""
    steps = np.diff(times)
    usual = np.median(steps[steps > 0]) if (steps > 0).any() else 0.0
    step = steps[starts - 1]
    return (step <= 0) | (step > conform.GAP * usual)


def _stretches(
    value: str, parts: list[NDArray[np.int64]], others: Container[str]
) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """The stretches of a value by names that no other value has."""
    mark = "-"
    while any(f"{value}{mark}{number}" in others for number in range(1, len(parts) + 1)):
        mark += "-"
    for number, rows in enumerate(parts, 1):
        yield (f"{value}{mark}{number}" if len(parts) > 1 else value), rows
