"""What LabVIEW writes before the rows of a table (.lvm): a header, units of the columns, the name of a comment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import cells


def ends_header(line: bytes) -> bool:
    """Whether a line is the mark that ends a header.

    >>> ends_header(b"***End_of_Header***"), ends_header(b"X_Value,Fz")
    (True, False)
    """
    return line.startswith(b"***End_of_Header***")


def end_of_header(lines: Sequence[bytes]) -> int:
    """Number of the line of names after the first mark that such a line follows, else after the last; 0 = no mark.

    >>> end_of_header([b"LabVIEW Measurement", b"***End_of_Header***", b"", b"X_Value,Fz,Comment"])
    3
    """
    ends = [number for number, line in enumerate(lines) if ends_header(line)]
    after = [next((k for k in range(end + 1, len(lines)) if lines[k].strip()), 0) for end in ends]
    return next((number for number in after if lines[number].startswith(b"X_Value")), after[-1] if after else 0)


def without_comment(titles: list[str], below: Sequence[str]) -> list[str]:
    """The names of the columns without that of the comment, which it writes whether or not rows have one.

    >>> without_comment(["X_Value", "Fz", "Comment"], ["0.0", "1.5"])
    ['X_Value', 'Fz']
    """
    return titles[:-1] if titles[-1:] == ["Comment"] and len(titles) == len(below) + 1 else titles


def units_in(lines: Iterable[bytes], names: Sequence[str]) -> dict[str, str]:
    """The units of columns that a header states; the first column is that of the time, and a comment has no unit.

    >>> units_in([b"Y_Unit_Label,Newton,N*m"], ["X_Value", "Fx", "Mx"])
    {'Fx': 'N', 'Mx': 'Nm'}
    """
    rows = (cells.split(line, cells.delimiter_of(line)) for line in lines if line.startswith(b"Y_Unit_Label"))
    pairs = (pair for row in rows for pair in zip(names[1:], row[1:], strict=False))
    return {name: unit for name, cell in pairs if (unit := split_unit(f"x [{cell}]")[1])}


def period_in(lines: Iterable[bytes]) -> float:
    """Seconds between samples that a header states, the same for every column; 0 = none.

    >>> period_in([b"Delta_X\\t0,005\\t0,005"]), period_in([b"Delta_X\\t0.005\\t0.001"])
    (0.005, 0.0)
    """
    rows = (cells.split(line, cells.delimiter_of(line))[1:] for line in lines if line.startswith(b"Delta_X"))
    stated = {float(cell) for row in rows for cell in row if cell and cells.is_number(cell)}
    return stated.pop() if len(stated) == 1 else 0.0


def with_one_time(path: Path, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The columns without the times that it writes before every signal, where they are the same.

    >>> times = np.arange(3.0)
    >>> list(with_one_time(Path("a.lvm"), {"X_Value": times, "Fx": times, "X_Value.2": times, "Fz": times}))
    ['X_Value', 'Fx', 'Fz']

    Raises:
        InputError: a signal has times of its own.
    """
    more = [name for name in columns if name.startswith("X_Value.")]
    for name in more:
        if not np.array_equal(columns[name], columns["X_Value"]):
            raise InputError(
                f"{path}: the times in column {name} are not those in X_Value; save the signals one by one."
            )
    return {name: column for name, column in columns.items() if name not in more}
