"""Rows of the authors' tables as lists of floats, and the arithmetic that their program relies on.

A deleted row is a row of zeros; it stays in place, and acts as a neighbour, until the end of the pass.
Integer labels are stored as floats, as in the authors' tables.
"""

from __future__ import annotations

import math

Row = list[float]
Table = list[Row]


def ratio(a: float, b: float) -> float:
    """IEEE division: x/0 is infinite and 0/0 is not a number."""
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a)


def unusable(value: float) -> bool:
    """The reference skips ratios of exactly zero or infinity; not-a-number passes."""
    return value == 0.0 or math.isinf(value)


def outside(value: float, low: float, high: float) -> bool:
    """True beyond either limit; not-a-number is inside because every comparison with it is false."""
    return value > high or value < low


def near(x: float, following: float, tolerance: float, clean: bool = False) -> bool:
    """Relative closeness of two values (section 7).

    The reference scales the tolerance by the larger *signed* value, so the answer changes with the sign
    of the axis (quirk Q15); ``clean`` scales it by the larger magnitude.
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
