"""Strict parser of the whitespace-separated tables of the HIRO recordings (``R_Torques.dat`` and so on).

Spaces or tabs, trailing tabs, CRLF and blank lines are allowed; anything else that is not a complete table of
finite numbers on an even time grid is an error that names the file and the line.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import MAX_TEXT_BYTES, read_bytes
from rcbht_jax.errors import InputError

MIN_DT, MAX_DT = 1e-4, 1.0
PLAIN = b"0123456789+-.eE \t\r\n"
DT_TOLERANCE = 0.05  # of the time step: far above print rounding, far below a lost sample

# Largest plausible magnitude of each quantity, and what a larger one probably means.
LIMITS = {
    "wrench": (1e5, "are the values in newtons and newton metres"),
    "joint angles": (10.0, "are the angles in radians, not degrees"),
    "pose": (10.0, "are the values in metres and radians, not millimetres and degrees"),
}


@dataclass(frozen=True)
class TimedTable:
    """One signal file: a time column and six value columns."""

    time: Float64[np.ndarray, " row"]  # s, evenly spaced
    values: Float64[np.ndarray, "row 6"]
    dt: float  # s between rows


def read_table(path: Path, columns: int) -> Float64[np.ndarray, "row {columns}"]:
    """Read a table of finite numbers.

    Raises:
        InputError: the file is missing, larger than ``MAX_TEXT_BYTES``, empty, or has a line that is not exactly
            ``columns`` finite numbers.
    """
    raw = read_bytes(path, MAX_TEXT_BYTES, empty=True)
    if not raw.strip():
        raise InputError(f"{path} is empty; expected lines of {columns} numbers.")
    table = _read_fast(raw)
    if table is None or table.shape[1] != columns:
        table = _read_slowly(path, raw, columns)
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        where = f"{_place(path, int(row))}, column {column + 1}"
        raise InputError(f"{where}: the value is {table[row, column]}; expected a finite number.")
    return table


def read_timed(path: Path, quantity: str) -> TimedTable:
    """Read a signal file: time (s) and six columns of ``quantity`` (a key of ``LIMITS``).

    Raises:
        InputError: as :func:`read_table`; also fewer than two rows, time stamps that do not increase or are uneven,
            a time step outside 0.1 ms .. 1 s, or magnitudes that suggest other units.
    """
    table = read_table(path, 7)
    if len(table) < 2:
        raise InputError(f"{path} has one line; expected at least two, to know the time step.")
    dt = _time_step(path, table[:, 0])
    limit, hint = LIMITS[quantity]
    large = np.argwhere(np.abs(table[:, 1:]) > limit)
    if len(large):
        row, column = large[0]
        where = f"{_place(path, int(row))}, column {column + 2}"
        value = table[row, column + 1]
        raise InputError(f"{where}: {value:g} is too large for {quantity} (limit {limit:g}); {hint}?")
    return TimedTable(table[:, 0], table[:, 1:], dt)


def read_state_times(path: Path) -> Float64[np.ndarray, " state"]:
    """Read a state file: start times in s, none for an empty file.

    Raises:
        InputError: a line is not one finite number, or the times do not increase.
    """
    if not read_bytes(path, MAX_TEXT_BYTES, empty=True).strip():
        return np.zeros(0)
    times = read_table(path, 1)[:, 0]
    step = np.diff(times)
    if (step <= 0).any():
        row = int(np.flatnonzero(step <= 0)[0]) + 1
        raise InputError(
            f"{_place(path, row)}: state time {times[row]:g} s does not come after {times[row - 1]:g} s; expected "
            "increasing times."
        )
    return times


def _time_step(path: Path, time: Float64[np.ndarray, " row"]) -> float:
    """The constant time step of a file, s; an InputError names the line where it is not constant."""
    step = np.diff(time)
    dt = float(np.median(step))
    uneven = np.flatnonzero((step <= 0) | (np.abs(step - dt) > DT_TOLERANCE * abs(dt)))
    if len(uneven):
        row = int(uneven[0]) + 1
        where = _place(path, row)
        if step[row - 1] <= 0:
            raise InputError(
                f"{where}: time {time[row]:g} s does not come after {time[row - 1]:g} s; expected time to increase."
            )
        raise InputError(
            f"{where}: the time step is {step[row - 1]:g} s where the file's is {dt:g} s; "
            "expected a constant step. Resample the file or cut it here."
        )
    if not MIN_DT <= dt <= MAX_DT:
        raise InputError(
            f"{path}: the time step is {dt:g} s; expected {MIN_DT:g} to {MAX_DT:g} s. Is the time in seconds?"
        )
    return dt


def _read_fast(raw: bytes) -> Float64[np.ndarray, "row column"] | None:
    """The table by NumPy's reader; None if it does not consist of complete lines of plain numbers."""
    if raw.translate(None, PLAIN):
        return None
    try:
        return np.loadtxt(io.StringIO(raw.decode("ascii"), newline=None), comments=None, ndmin=2)
    except ValueError:
        return None


def _read_slowly(path: Path, raw: bytes, columns: int) -> Float64[np.ndarray, "row {columns}"]:
    """Line by line: names the first bad line, or reads what the fast reader does not accept."""
    rows: list[list[float]] = []
    for number, line in enumerate(raw.splitlines(), start=1):
        if not (fields := line.split()):
            continue
        values = [_number(field, f"{path}, line {number}") for field in fields]
        if len(values) != columns:
            where = f"{path}, line {number}: {plural(len(values), 'column')}; expected {columns}"
            if len(values) < columns or rows:
                raise InputError(f"{where}. Is the line cut off?")
            raise InputError(f'{where}, of HIRO; read another table with "rcbht import csv", and a map (--map).')
        rows.append(values)
    return np.array(rows, np.float64)


def _number(field: bytes, where: str) -> float:
    try:
        # Python reads 1_000 as a number; no logger writes that.
        if b"_" in field:
            raise ValueError
        return float(field)
    except ValueError:
        text = repr(field[:30]).removeprefix("b")
        raise InputError(f"{where}: {text} is not a number.") from None


def _place(path: Path, row: int) -> str:
    """A file, and the line (from 1) of a row (from 0) of its table; blank lines are not rows."""
    lines = enumerate(read_bytes(path, MAX_TEXT_BYTES).splitlines(), start=1)
    return f"{path}, line {[number for number, line in lines if line.split()][row]}"
