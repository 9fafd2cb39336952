"""Lines that data loggers and LabVIEW (.lvm) write before the names of the columns, and what they state about these."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

from rcbht_jax._util.cells import number_of
from rcbht_jax._util.columns import FORCES, MOMENTS, split_unit
from rcbht_jax.io.importing import cells
from rcbht_jax.io.importing.names import wrenches
from rcbht_jax.io.importing.words import rate_of

END_OF_HEADER = b"***End_of_Header***"  # of LabVIEW
LINES = 5  # of names and units at most
_SEPARATOR = re.compile(rb'^(?:\xef\xbb\xbf)?"?sep=[^\s]?"?\s*$', re.IGNORECASE)  # that spreadsheets read


@dataclass(frozen=True)
class Stated:
    """What lines before the names or comments state; readings that are counts are divided by the counts of a unit."""

    rate: float | None  # samples per second
    counts: Mapping[str, float]  # column -> counts of one unit
    units: Mapping[str, str]  # column -> unit


def line_of_names(lines: list[bytes]) -> int:
    """Number of the line that holds the names of the columns, if lines with fewer cells stand before it; 0 = none do.

    Only a line of text with as many cells as all rows after it is one of names: rows that are cut off, or too few
    names, remain mistakes.

    >>> line_of_names([b"# a log", b"Date,today", b"t,Fx,Fz", b"0,1,2", b"1,1,2"])
    2
    """
    filled = [number for number, line in enumerate(lines) if line.strip()]
    if after := _end_of_header(lines):
        return after
    if lines and _SEPARATOR.match(lines[0]):
        return 1 + line_of_names(lines[1:])
    if len(filled) < 3:
        return 0
    begins = [next(iter(cells.split(lines[number], cells.delimiter_of(lines[number]))), "") for number in filled]
    samples = [place for place, cell in enumerate(begins) if not cells.is_word(cell)]
    if 2 * len(samples) > len(filled):  # words below the last sample are no rows
        filled = filled[: samples[-1] + 1]
    delimiter = cells.delimiter_of(lines[filled[-1]])
    rows = [cells.split(lines[number], delimiter) for number in filled]
    width = len(rows[-1])
    kept = [len(row) == width or not cells.COMMENT.match(lines[at]) for row, at in zip(rows, filled, strict=True)]
    rows, filled = list(compress(rows, kept)), list(compress(filled, kept))
    first = max((at + 1 for at, row in enumerate(rows) if len(row) != width), default=0)
    if not 0 < first < len(rows) - 1 or any(len(row) > width for row in rows[:first]):
        return 0
    while first < len(rows) - 2 and cells.count_numbers(rows[first]):
        first += 1  # a line about every column, such as its date or its number of samples
    below = row_of_numbers(rows[first + 1 :]) or []
    timed = bool(below) and not cells.is_word(below[0])  # with a time
    sampled = timed or 2 * cells.count_numbers(below) >= width
    return filled[first] if sampled and not cells.count_numbers(rows[first]) else 0


def row_of_numbers(rows: Sequence[list[str]]) -> list[str] | None:
    """The first of the next rows that has a number; None = none has one.

    >>> row_of_numbers([["x", "y"], ["[N]", ""], ["1", "2"]])
    ['1', '2']
    """
    return next((row for row in rows[:LINES] if cells.count_numbers(row)), None)


def stated(lines: Iterable[bytes], names: Iterable[str]) -> Stated:
    """What pairs of a word and a value say about the columns: the rate, counts per unit of force and of torque, units.

    >>> found = stated([b"Sample Rate:,500", b"Force Units:,N", b"Counts per Unit Force:,1000"], ["Fx", "Fy", "Fz"])
    >>> found.rate, found.counts["Fz"], found.units["Fz"]
    (500.0, 1000.0, 'N')
    """
    lines, names = list(lines), list(names)
    said = dict(pair for line in lines for pair in _pairs(line))
    rates = [rate for key, text in said.items() if (rate := rate_of(key, text, longer=True))]
    rates += [1 / period] if (period := _period_in(lines)) > 0 else []
    counts: dict[str, float] = {}
    units: dict[str, str] = {}
    both = [
        split_unit(f"x [{text}]")[1] for text in re.split(r"[\[\](),;/\s]+", said.get("units", said.get("unit", "")))
    ]
    axes = [pair for wrench in wrenches(names) for pair in wrench.items()]
    for quantity, letter in (("force", "F"), ("torque", "M")):
        per = number_of(said.get(f"counts per unit {quantity}", said.get(f"counts per {quantity}", "")))
        those = [column for axis, column in axes if axis.startswith(letter)]
        counts |= dict.fromkeys(those, per) if per > 0 else {}
        unit = split_unit(f"x [{said.get(f'{quantity} units', '')}]")[1]
        unit = unit or next((one for one in both if one in {"F": FORCES, "M": MOMENTS}[letter]), "")
        units |= dict.fromkeys(those, unit) if unit else {}
    units |= _units_in(lines, names)
    return Stated(next(iter(rates), None), counts, units)


def _pairs(line: bytes) -> Iterator[tuple[str, str]]:
    """Words and their values: each pair in a cell, between a colon or an equals sign, or in two successive cells.

    A comma may also stand between several values of the only word.
    """
    line = cells.COMMENT.sub(b"", line)
    row = [cell for cell in cells.split(line, cells.delimiter_of(line)) if cell]
    within = [re.split(r"\s*[:=]\s*", cell, maxsplit=1) for cell in row]
    if row and all(len(pair) == 2 and pair[1] for pair in within):
        yield from (_stating(*pair) for pair in within)
    elif (len(row) == 2 and not any(within[0][1:])) or (
        len(row) % 2 == 0 and all(cell.endswith((":", "=")) for cell in row[::2])
    ):
        yield from (_stating(key, value) for key, value in zip(row[::2], row[1::2], strict=True))
    else:
        pair = re.split(r"\s*[:=]\s*", line.decode("utf-8", "replace").strip(), maxsplit=1)
        yield from [_stating(*pair)] if len(pair) == 2 else []


def _stating(key: str, value: str) -> tuple[str, str]:
    return key.strip(" :=").lower().replace("_", " "), value.strip()


def _end_of_header(lines: Sequence[bytes]) -> int:
    """Number of the line of names after the first mark that such a line follows, else after the last; 0 = no mark."""
    ends = [number for number, line in enumerate(lines) if line.startswith(END_OF_HEADER)]
    after = [next((k for k in range(end + 1, len(lines)) if lines[k].strip()), 0) for end in ends]
    return next((number for number in after if lines[number].startswith(b"X_Value")), after[-1] if after else 0)


def _units_in(lines: Iterable[bytes], names: Sequence[str]) -> dict[str, str]:
    """The units of columns that LabVIEW states; the first column is that of the time, and a comment has no unit."""
    rows = (cells.split(line, cells.delimiter_of(line)) for line in lines if line.startswith(b"Y_Unit_Label"))
    pairs = (pair for row in rows for pair in zip(names[1:], row[1:], strict=False))
    return {name: unit for name, cell in pairs if (unit := split_unit(f"x [{cell}]")[1])}


def _period_in(lines: Iterable[bytes]) -> float:
    """Seconds between samples that LabVIEW states, the same for every column; 0 = none."""
    rows = (cells.split(line, cells.delimiter_of(line))[1:] for line in lines if line.startswith(b"Delta_X"))
    stated = {float(cell) for row in rows for cell in row if cell and cells.is_number(cell)}
    return stated.pop() if len(stated) == 1 else 0.0
