"""What LabVIEW writes before the rows of a table (.lvm): a header, units of the columns, the name of a comment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rcbht_jax._util.columns import UNITS
from rcbht_jax.io.importing import cells


def end_of_header(lines: Sequence[bytes]) -> int:
    """Number of the line after the last mark that ends a header; 0 = there is none.

    >>> end_of_header([b"LabVIEW Measurement", b"***End_of_Header***", b"", b"X_Value,Fz,Comment"])
    3
    """
    ends = [number for number, line in enumerate(lines) if line.startswith(b"***End_of_Header***")]
    return next((number for number in range(ends[-1] + 1, len(lines)) if lines[number].strip()), 0) if ends else 0


def without_comment(titles: list[str], below: Sequence[str]) -> list[str]:
    """The names of the columns without that of the comment, which it writes whether or not rows have one.

    >>> without_comment(["X_Value", "Fz", "Comment"], ["0.0", "1.5"])
    ['X_Value', 'Fz']
    """
    return titles[:-1] if titles[-1:] == ["Comment"] and len(titles) == len(below) + 1 else titles


def units_in(lines: Iterable[bytes], names: Sequence[str]) -> dict[str, str]:
    """The units of columns that a header states; the first column is that of the time, and a comment has no unit.

    >>> units_in([b"Y_Unit_Label,Newton,Newton"], ["X_Value", "Fx", "Fz"])
    {'Fx': 'N', 'Fz': 'N'}
    """
    rows = (cells.split(line, cells.delimiter_of(line)) for line in lines if line.startswith(b"Y_Unit_Label"))
    pairs = (pair for row in rows for pair in zip(names[1:], map(str.lower, row[1:]), strict=False))
    return {name: UNITS[cell] for name, cell in pairs if cell in UNITS}
