"""Tables as text: CSV with commas, semicolons or tabs (and decimal commas), or blanks, with or without a line of names.

Data loggers write lines about the device before the names of the columns; those are left out.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_TABLE_LINE
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import cells, labview
from rcbht_jax.io.importing.preamble import line_of_names, stated
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.unpacked import opened

PREAMBLE, PREAMBLE_LINE = 64, 2**14  # lines at most before the names of the columns, and bytes of one
CHUNK = 20_000  # rows that are Python objects at a time
_PLAIN = b"0123456789+-.eE,;\t \r\n"


def read_csv(path: Path, name: str) -> Iterator[Table]:
    """The table of a text file.

    Names are those of the first line, and a line of units may follow. Columns without one are called c0, c1, ... by
    their place. Empty cells are missing values. A file that is neither UTF-8 nor UTF-16 is read as Windows-1252, which
    spreadsheets write in Western Europe.

    >>> Path("a.csv").write_text("t,Fz,phase\\n0,1.5,free\\n0.1,2,touch\\n")
    34
    >>> [table] = read_csv(Path("a.csv"), "a.csv")
    >>> {key: values.tolist() for key, values in table.columns.items()}
    {'t': [0.0, 0.1], 'Fz': [1.5, 2.0], 'phase': ['free', 'touch']}

    Raises:
        InputError: not a regular file, too large, not text, a line of another number of cells, or text in a column of
            numbers; the sentence names the line.
    """
    with opened(path) as file:
        encoding = _encoding(file)
        before = _preamble(file)
        head, comment, comments = _head(file, path)
        delimiter = cells.delimiter_of(head)
        titles, below = cells.split(head, delimiter, encoding), _below(file, delimiter, encoding)
        titles = labview.without_comment(titles, below) if before else titles
        titled = comment or cells.is_title(titles, below)
        body = file.tell() if titled else file.tell() - len(head)
        units, first = _units_below(file, delimiter, encoding) if titled else ([], body)
        if titles and len(units) == len(titles):
            body = first
            titles = [f"{title} [{unit}]" if unit else title for title, unit in zip(titles, units, strict=True)]
        names = _names(titles, path) if titled else [f"c{number}" for number in range(len(titles))]
        read = _fast(file, body, delimiter, len(names)) or _slow(path, file, body, delimiter, names, encoding)
    notes = ((f"preamble:{len(before)}",) if before else ()) + (("cp1252",) if encoding == "cp1252" else ())
    columns = {key: part for name, one in zip(names, read, strict=True) for key, part in _elements(name, one).items()}
    if len(columns) > MAX_COLUMNS:
        raise InputError(f"{path} has {len(columns)} columns; expected at most {MAX_COLUMNS}.")
    about = stated([*before, *comments], columns)
    for column, counts in about.counts.items():
        if columns[column].dtype.kind == "f":
            columns[column] = columns[column].astype(np.float64) / counts
    notes += ("counts",) if about.counts else ()
    yield Table(name, columns, about.rate, about.units, notes=notes)


def _elements(name: str, column: NDArray[np.generic]) -> dict[str, NDArray[np.generic]]:
    """The columns of lists of numbers, as many in each cell; a column of anything else by itself."""
    if column.dtype.kind != "U" or not str(column[0]).startswith(("[", "(")):
        return {name: column}
    texts = column.tolist()
    if not all(text.startswith(("[", "(")) and text.endswith(("]", ")")) for text in texts):
        return {name: column}
    try:
        rows = [list(map(float, re.split(r"[\s,;]+", text[1:-1].strip(" ,;\n")))) for text in texts]
        table = np.array(rows, np.float64)
    except ValueError:
        return {name: column}
    return {f"{name}_{number}": table[:, number] for number in range(table.shape[1])}


def _encoding(file: BinaryIO) -> str:
    """Encoding of the whole file, whose position is kept."""
    decoder, encoding = codecs.getincrementaldecoder("utf-8-sig")(), "utf-8-sig"
    try:
        while block := file.read(MAX_TABLE_LINE):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        encoding = "cp1252"
    file.seek(0)
    return encoding


def _preamble(file: BinaryIO) -> list[bytes]:
    """Move to the line of names, if lines with fewer cells stand before it; returns those lines."""
    lines: list[bytes] = []
    while len(lines) < PREAMBLE + 2 and (line := file.readline(PREAMBLE_LINE)):
        lines.append(line)
        if not line.endswith(b"\n"):
            break  # the last one, or longer than those of loggers are
    passed = line_of_names(lines)
    file.seek(sum(map(len, lines[:passed])))
    return lines[:passed]


def _head(file: BinaryIO, path: Path) -> tuple[bytes, bool, list[bytes]]:
    """The first line with content, whether it is a comment (of several the last), and the first comments."""
    comment = b""
    comments: list[bytes] = []
    while line := file.readline(MAX_TABLE_LINE):
        if len(line) == MAX_TABLE_LINE and not line.endswith(b"\n"):
            raise InputError(f"{path} has a line of more than {MAX_TABLE_LINE} bytes; that is not a table.")
        if line.startswith((b"#", b"%")) and not line.startswith(b"%time"):
            comment = line.lstrip(b"#% ")
            comments = [*comments, line][:PREAMBLE]
        elif line.strip():
            # A comment is the line of names if it has as many of them as the first row has cells.
            row = cells.split(line, cells.delimiter_of(line))
            titles = cells.split(comment, cells.delimiter_of(comment)) if comment else []
            if len(titles) == len(row) and all(map(cells.is_number, row)):
                file.seek(file.tell() - len(line))
                return comment, True, comments
            return line, False, comments
    raise InputError(f"{path} is empty; expected a table.")


def _below(file: BinaryIO, delimiter: str, encoding: str) -> list[str]:
    """The cells of the next line, whose position is kept."""
    place = file.tell()
    row = cells.split(file.readline(MAX_TABLE_LINE), delimiter, encoding)
    file.seek(place)
    return row


def _units_below(file: BinaryIO, delimiter: str, encoding: str) -> tuple[list[str], int]:
    """The units in the next line, if those columns hold numbers in the line after it, and where that line begins."""
    units, place = cells.units(cells.split(file.readline(MAX_TABLE_LINE), delimiter, encoding)), file.tell()
    first = cells.split(file.readline(MAX_TABLE_LINE), delimiter, encoding)
    of_numbers = len(first) == len(units) and all(
        cells.is_number(cell) or not cell for cell, unit in zip(first, units, strict=True) if unit
    )
    return (units if of_numbers and any(map(cells.is_number, first)) else []), place


def _names(titles: list[str], path: Path) -> list[str]:
    if len(titles) > MAX_COLUMNS:
        raise InputError(f"{path} has {len(titles)} columns; expected at most {MAX_COLUMNS}.")
    if any(not cell.isprintable() for cell in titles):
        raise InputError(f"{path} is not a table: its first line is not text. Unpack it if it is compressed.")
    seen: dict[str, int] = {}
    names = []
    for number, title in enumerate(titles):
        cell = title or f"c{number}"
        count = seen[cell] = seen.get(cell, 0) + 1
        names.append(cell if count == 1 else f"{cell}.{count}")
    return names


def _fast(file: BinaryIO, body: int, delimiter: str, width: int) -> list[NDArray[np.float64]] | None:
    """All columns by NumPy's reader; None if the file does not consist of complete lines of plain numbers."""
    file.seek(body)
    if width > MAX_COLUMNS:
        return None
    blank = True
    while block := file.read(MAX_TABLE_LINE):
        blank = blank and not block.strip()
        if block.translate(None, _PLAIN):
            return None
        if len(block) == MAX_TABLE_LINE and not (b"\n" in block or b"\r" in block):
            return None  # a line that long would be read as a whole; row by row it is refused
    if blank:
        return None
    file.seek(body)
    try:
        lines = io.TextIOWrapper(file, "ascii", newline=None)
        table = np.loadtxt(lines, delimiter=None if delimiter == " " else delimiter, comments=None, ndmin=2)
        lines.detach()
    except (ValueError, UserWarning):
        lines.detach()
        return None
    if table.shape[1] != width or not len(table):
        return None
    return [np.ascontiguousarray(column) for column in table.T]


def _slow(
    path: Path, file: BinaryIO, body: int, delimiter: str, names: list[str], encoding: str
) -> list[NDArray[np.generic]]:
    """Row by row: text columns, empty cells, and a message that names the first bad line."""
    file.seek(0)
    before = sum(1 for _ in iter(lambda: file.readline(MAX_TABLE_LINE) if file.tell() < body else b"", b""))
    file.seek(body)
    columns = [_Column(path, name) for name in names]
    rows: list[list[str]] = []
    numbers: list[int] = []
    for number, row in _rows(path, file, delimiter, before, encoding):
        # A delimiter at the end of every line makes an empty cell more.
        if len(row) == len(names) + 1 and not row[-1]:
            row = row[:-1]
        if len(row) != len(names):
            blocks = len(names) == 1 and len(row) == 6  # rows of a wrench below a word
            hint = "Read the blocks of a UCI file with: rcbht import uci." if blocks else "Is the line cut off?"
            raise InputError(f"{path}, line {number}: {len(row)} cells; expected {len(names)}. {hint}")
        rows.append(row)
        numbers.append(number)
        if len(rows) == CHUNK:
            _flush(columns, rows, numbers)
    _flush(columns, rows, numbers)
    if not columns or not columns[0].count:
        raise InputError(f"{path} has no rows; expected a table.")
    return [column.array() for column in columns]


def _rows(path: Path, file: BinaryIO, delimiter: str, before: int, encoding: str) -> Iterator[tuple[int, list[str]]]:
    def lines() -> Iterator[str]:
        while raw := file.readline(MAX_TABLE_LINE):
            if len(raw) == MAX_TABLE_LINE and not raw.endswith(b"\n"):
                raise InputError(f"{path} has a line of more than {MAX_TABLE_LINE} bytes; that is not a table.")
            yield raw.decode(encoding)

    blanks = (line.split() for line in lines())
    reader = blanks if delimiter == " " else csv.reader(lines(), delimiter=delimiter)
    number = before
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except (csv.Error, UnicodeDecodeError) as error:
            wrong = isinstance(error, UnicodeDecodeError)
            reason = "it is neither UTF-8 nor Windows-1252; save it as UTF-8" if wrong else str(error)
            raise InputError(f"{path}, line {number + 1} cannot be read: {reason}.") from None
        number += 1
        if any(cell.strip() for cell in row):
            yield number, [cells.plain(cell.strip(), delimiter) for cell in row]


def _flush(columns: list[_Column], rows: list[list[str]], numbers: list[int]) -> None:
    for column, some in zip(columns, zip(*rows, strict=True), strict=False):
        column.add(some, numbers)
    rows.clear()
    numbers.clear()


class _Column:
    """A column that grows; it is text if its first cell with content is."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name, self._where = path, name, f"{path}, column {name}"
        self._parts: list[NDArray[np.generic]] = []
        self._kind = ""  # "f", "U"; "" = nothing but empty cells so far
        self.count = 0

    def add(self, row: tuple[str, ...], lines: list[int]) -> None:
        self.count += len(row)
        if not self._kind:
            filled = [cell for cell in row if cell.lower() not in cells.NAN]
            # One stray word in a column of numbers is a mistake, not a label.
            texts = sum(not cells.is_number(cell) for cell in filled)
            self._kind = "" if not filled else "U" if 2 * texts > len(filled) else "f"
        if self._kind == "U":
            self._parts.append(cells.texts(row, self._where))
        else:
            self._parts.append(self._numbers(row, lines))

    def _numbers(self, row: tuple[str, ...], lines: list[int]) -> NDArray[np.float64]:
        try:
            if not any("_" in cell for cell in row):
                return np.array(row, np.float64)
        except ValueError:
            pass
        values = np.empty(len(row))
        for place, cell in enumerate(row):
            if not cells.is_number(cell):
                where = f"{self._path}, line {lines[place]}, column {self._name}"
                raise InputError(f"{where}: {cell[:30]!r} is not a number.")
            values[place] = np.nan if cell.lower() in cells.NAN else float(cell)
        return values

    def array(self) -> NDArray[np.generic]:
        if self._kind != "U":
            return np.concatenate(self._parts)
        parts: list[NDArray[np.str_]] = [
            np.full(len(part), "") if part.dtype.kind == "f" else part.astype(np.str_, copy=False)
            for part in self._parts
        ]
        longest = max(part.dtype.itemsize // 4 for part in parts)
        cells.check_texts(longest, sum(int(np.char.str_len(part).sum()) for part in parts), self.count, self._where)
        return np.concatenate(parts)
