"""The rows of each recording of one table, by the values of a column."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator

import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import conform, topics
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import in_order, text

MAX_GROUPS = 100_000
Stamps = Callable[[], NDArray[np.float64] | None]  # of all rows, s; None = there are none that can be read


def rows_of_groups(table: Table, name: str, stamps: Stamps | None) -> tuple[dict[str, NDArray[np.int64]], int]:
    """The rows of every value of a column but the empty one, and how often a value comes again as a recording.

    Where a value comes again after others, as trials that every session counts anew, each stretch is a recording,
    ``VALUE-1``, ``VALUE-2``, ..., if its time does not go on from the stretch before.

    >>> trial = np.repeat([1.0, 2.0, 1.0, 2.0], 10)
    >>> table = Table("a.csv", {"t": np.tile(np.arange(10.0), 4), "trial": trial})
    >>> groups, again = rows_of_groups(table, "trial", lambda: table.columns["t"])
    >>> {value: rows[0].item() for value, rows in groups.items()}, again
    ({'1-1': 0, '1-2': 20, '2-1': 10, '2-2': 30}, 2)
    >>> list(rows_of_groups(table, "trial", lambda: np.arange(40.0))[0])
    ['1-1', '1-2', '2-1', '2-2']

    Args:
        table: of several recordings.
        name: of the column.
        stamps: gives the times, which are read only if a value comes again; None = all rows of a value are one.

    Raises:
        InputError: the column has more values than files hold recordings.
    """
    values, which = np.unique(table.columns[name], return_inverse=True)
    if len(values) > MAX_GROUPS:
        raise InputError(f"{table.name}: {name} has {len(values)} values; it does not separate recordings.")
    order = np.argsort(which, kind="stable")
    bounds = np.cumsum(np.bincount(which, minlength=len(values)))[:-1]
    place = np.cumsum(topics.filled(table.columns[name]))  # rows without a value come between no stretches
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
