"""Tables in which each row is of one message: the rows of other topics are no samples of the wrench."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from rcbht_jax.io.importing.conform import sparse
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.stand_ins import without_stand_ins
from rcbht_jax.io.importing.table import Table


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
    """The rows that are samples, their values ``[row, channel]``, and notes of what is left out at the end and between.

    Rows without values are no samples where most are, where they are every second row, or where they hold what most
    samples lack.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> nan = np.nan
    >>> columns = {"t": np.arange(5.0), "Fz": np.array([1, nan, 2, nan, 3]), "q": np.array([nan, 7, nan, nan, nan])}
    >>> mapping = Mapping((Channel("Fz"),), time="t")
    >>> rows, values, notes = with_values(Table("a.csv", columns), mapping, np.arange(5))
    >>> rows.tolist(), values[:, 0].tolist(), notes
    ([0, 2, 3, 4], [1.0, 2.0, nan, 3.0], ['between:1'])

    Args:
        table: of which the rows are.
        mapping: of its columns.
        rows: of a recording.
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
    if known.sum() < held / 2 or sparse(np.flatnonzero(known)):  # a log in the steps of something faster
        return ~known
    own = {mapping.time, mapping.nanoseconds, mapping.group, *(channel.column for channel in mapping.channels)}
    other = np.zeros(len(rows), bool)  # of messages of other topics
    for column in (table.columns[name][rows] for name in table.columns if name not in own):
        there = filled(column)
        if 2 * there[known].sum() < known.sum():
            other |= there
    return other & ~known
