"""Rows of the label tables as lists of floats, and the arithmetic on which the original programs rely.

A deleted row is a row of zeros; it stays in place, and acts as a neighbour, until the end of the pass.
Integer labels are stored as floats, as in the original tables.
"""

from __future__ import annotations

import math

Row = list[float]
Table = list[Row]


def ratio(a: float, b: float) -> float:
    """IEEE division: x/0 is infinite and 0/0 is NaN."""
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a)


def unusable(value: float) -> bool:
    """The original program skips ratios of exactly zero or infinity, but not NaN."""
    return value == 0.0 or math.isinf(value)


def outside(value: float, low: float, high: float) -> bool:
    """True beyond either limit; NaN is inside, because every comparison with it is false."""
    return value > high or value < low


def near(x: float, following: float, tolerance: float, clean: bool = False) -> bool:
    """Relative closeness of the magnitudes of two values.

    The original program scales the tolerance by the larger *signed* value, so that the result depends on the sign
    of the axis (Q15); ``clean`` scales it by the larger magnitude.
    """
    scale = max(abs(x), abs(following)) if clean else abs(max(x, following))
    return abs(abs(x) - abs(following)) <= tolerance * scale


def wipe(row: Row) -> None:
    """Delete a row in place."""
    row[:] = [0.0] * len(row)


def compact(rows: Table) -> Table:
    """Rows that are not deleted; a table of exactly one row is returned unchanged (Q29)."""
    return rows if len(rows) == 1 else [row for row in rows if any(row)]


def run_length(rows: Table, i: int, column: int) -> int:
    """Number of rows directly after ``i`` with the same label."""
    k = i + 1
    while k < len(rows) and rows[k][column] == rows[i][column]:
        k += 1
    return k - i - 1
