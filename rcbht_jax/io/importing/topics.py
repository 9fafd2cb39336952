"""Rows and values that are no samples: those of messages of other topics, and numbers for missing values."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural
from rcbht_jax.io.importing.conform import sparse
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import text

_USUAL = (999.0, 9999.0, 99999.0, 999999.0, 32768.0)  # of either sign
_HUGE = 1e15  # no sensor measures as much
_FAR = 5  # times the largest other value


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
    raw = _without_stand_ins(raw, mapping)
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


def _without_stand_ins(values: NDArray[Any], mapping: Mapping) -> NDArray[Any]:
    """The values, NaN for those that a mapping calls missing."""
    if not mapping.missing:
        return values
    missing = np.isclose(values[..., None], mapping.missing, rtol=1e-6, atol=0.0).any(-1)  # a float32 is near
    return np.where(missing, np.nan, values)


def stand_ins(table: Table, mapping: Mapping) -> str:
    """A warning about a number in the channels that may stand for missing values; "" = there is none.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> table = Table("a.csv", {"Fz": np.array([1.5, -9999.0, 2.5])})
    >>> stand_ins(table, Mapping((Channel("Fz"),)))
    'Fz is -9999 in 1 sample, far from all others; if this means that values are missing, map it: missing = [-9999].'
    """
    for channel in mapping.channels:
        values = _without_stand_ins(table.columns[channel.column], mapping)
        if number := _stand_in(values[np.isfinite(values)]):
            samples = plural(int((values == number).sum()), "sample")
            why = f"far from all others; if this means that values are missing, map it: missing = [{text(number)}]."
            return f"{channel.column} is {text(number)} in {samples}, {why}"
    return ""


def _stand_in(values: NDArray[Any]) -> float:
    """The number among finite values that may stand for missing ones; 0 = there is none."""
    if not len(values):
        return 0.0
    number = float(values[np.abs(values).argmax()])
    others = np.abs(values[values != number]).max(initial=0.0)
    named = abs(number) in _USUAL or abs(number) >= _HUGE
    return number if named and 0 < _FAR * others < abs(number) else 0.0
