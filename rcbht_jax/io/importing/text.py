"""Tables as text: CSV with commas, semicolons or tabs (and decimal commas), or blanks, with or without a line of names.

Data loggers write lines about the device before the names of the columns; those are left out.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_TABLE_LINE
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import cells
from rcbht_jax.io.importing.preamble import END_OF_HEADER, stated
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.timing import are_dates, with_one_time
from rcbht_jax.io.importing.titles import Titles, read_titles
from rcbht_jax.io.importing.unpacked import ENCODINGS, encoding_of, line_of, opened
from rcbht_jax.io.importing.words import text

CHUNK = 20_000  # rows that are Python objects at a time
PROBES = 100  # rows that show how numbers are written
_NO_NUMBER = re.compile(r"0\d+|\d+[eE]\d+|\d{16,}")  # but a name, or a serial number
_POINT = re.compile(rb"(?<!\d)0?\.\d|\.\d{1,2}(?!\d)|\.\d{4}|\d{4}\.\d")  # is a decimal one without doubt
_PLAIN = b"0123456789+-.eE,;\t \r\n"
HELD, SUMS = 64, 16  # lines below the last row at most, and those of them with as many cells as a row
LISTED, LETTERS = 16, 40  # of what was left out
_HALF = re.compile(r"[+-]?\d*\.\d*[eE][+-]?")  # a number that ends within its exponent
Line = tuple[int, list[str]]  # its number and its cells


def read_csv(path: Path, name: str, words: bool = False) -> Iterator[Table]:
    """The table of a text file.

    Names are those of the first line, and a line of units may follow. Columns without one are called c0, c1, ... by
    their place. Empty cells and "nan" are missing values, as are words such as "ERR" in columns of numbers. Lines that
    are no rows are left out: names that are repeated, comments, words below the last row, such as "mean", and a last
    line that was cut off while the log was written: it has no end, and too few cells or half an exponent. A file that
    is neither UTF-8 nor UTF-16 is read as Shift-JIS or GB 18030 if its bytes go in pairs as theirs do, as Windows-1251
    if its words are Cyrillic, else as Windows-1252. With ``words``, a column of numbers is text if it holds one that
    says less than its cell, such as 007 or 1E5.

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
        encoding = encoding_of(file)
        titles = read_titles(file, path, encoding)
        between = Between(titles.lines, len(titles.names))
        fast = None if words else _fast(file, titles.body, titles.delimiter, len(titles.names))
        faults: set[str] = set()
        read = fast or _slow(path, file, titles, between, encoding, faults, words)
    notes: tuple[str, ...] = (f"preamble:{len(titles.before)}",) if titles.before else ()
    notes += (f"lines:{between.count}",) if between.count else ()
    notes += (encoding,) if encoding in ENCODINGS else ()
    pairs = zip(titles.names, read, strict=True)
    columns = {key: part for name, one in pairs for key, part in _elements(name, one).items()}
    if len(columns) > MAX_COLUMNS:
        raise InputError(f"{path} has {len(columns)} columns; expected at most {MAX_COLUMNS}.")
    about = stated([*titles.before, *titles.comments], columns)
    for column, counts in about.counts.items():
        if columns[column].dtype.kind == "f":
            columns[column] = columns[column].astype(np.float64) / counts
    notes += ("counts",) if about.counts else ()
    columns, lines = with_one_time(path, columns), tuple(between.left)
    yield Table(name, columns, about.rate, about.units, notes=notes, lines=lines, faults=tuple(sorted(faults)))


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


def _fast(file: BinaryIO, body: int, delimiter: str, width: int) -> list[NDArray[np.float64]] | None:
    """All columns by NumPy's reader; None if the file does not consist of complete lines of plain numbers."""
    file.seek(body)
    if width > MAX_COLUMNS:
        return None
    blank, shown = True, False
    while block := file.read(MAX_TABLE_LINE):
        blank = blank and not block.strip()
        if block.translate(None, _PLAIN):
            return None
        if delimiter != "," and b"." in block and not (shown := shown or bool(_POINT.search(block))):
            return None  # each point may stand between thousands
        if len(block) == MAX_TABLE_LINE and not (b"\n" in block or b"\r" in block):
            return None  # a line that long would be read as a whole; row by row it is refused
    if blank:
        return None
    file.seek(body)
    lines = io.TextIOWrapper(file, "ascii", newline=None)
    try:
        table = np.loadtxt(lines, delimiter=None if delimiter == " " else delimiter, comments=None, ndmin=2)
    except (ValueError, UserWarning):
        return None
    finally:
        lines.detach()
    if table.shape[1] != width or not len(table):
        return None
    return [np.ascontiguousarray(column) for column in table.T]


def _slow(
    path: Path, file: BinaryIO, titles: Titles, between: Between, encoding: str, faults: set[str], words: bool
) -> list[NDArray[np.generic]]:
    """Row by row: text columns, empty cells, and a message that names the first bad line."""
    file.seek(0)
    before = sum(1 for _ in iter(lambda: file.readline(MAX_TABLE_LINE) if file.tell() < titles.body else b"", b""))
    file.seek(titles.body)
    columns = [_Column(path, name, titles.delimiter, words) for name in titles.names]
    rows: list[Line] = []
    for number, row, ended in _rows(path, file, titles.delimiter, before, encoding):
        if row[0].encode().startswith(END_OF_HEADER):
            raise InputError(
                f"{path}, line {number} ends a further header: it holds several segments (Multi_Headings in LabVIEW); "
                "save it with one header only."
            )
        # A delimiter at the end of every line makes an empty cell more.
        cut = row[:-1] if len(row) == len(columns) + 1 and not row[-1] else row
        rows += between.samples(number, cut, ended)
        if len(rows) >= CHUNK:
            _flush(path, columns, rows)
    _flush(path, columns, rows + (between.end(of_words=True) if between.too_many() else []))
    _flush(path, columns, between.end(columns[0].is_of_words()))
    if not columns[0].count:
        file.seek(0)
        ends = " whose lines end in line feeds" if b"\r" in file.readline(MAX_TABLE_LINE).rstrip() else ""
        raise InputError(f"{path} has no rows; expected a table{ends}.")
    faults.update(*(column.faults for column in columns))
    return [column.array() for column in columns]


def _rows(
    path: Path, file: BinaryIO, delimiter: str, before: int, encoding: str
) -> Iterator[tuple[int, list[str], bool]]:
    """The number of each row, its cells, and whether its line has an end."""
    ended = True

    def lines() -> Iterator[str]:
        nonlocal ended
        while raw := line_of(file, path):
            ended = raw.endswith(b"\n")
            yield raw.decode(encoding, "strict" if ended else "ignore")  # half a sign may end a log that was cut off

    blanks = map(cells.between_blanks, lines())
    reader = blanks if delimiter == " " else csv.reader(lines(), delimiter=delimiter)
    number = before
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except (csv.Error, UnicodeDecodeError) as error:
            coded = f"it is neither UTF-8 nor {ENCODINGS.get(encoding, 'UTF-16')}; save it as UTF-8"
            reason = coded if isinstance(error, UnicodeDecodeError) else str(error)
            raise InputError(f"{path}, line {number + 1} cannot be read: {reason}.") from None
        number += 1
        if any(cell.strip() for cell in row):
            yield number, [cell.strip() for cell in row], ended


def _flush(path: Path, columns: list[_Column], lines: list[Line]) -> None:
    """Add rows to the columns."""
    for number, row in lines:
        if len(row) != len(columns):
            blocks = len(columns) == 1 and len(row) == 6  # rows of a wrench below a word
            hint = "Read the blocks of a UCI file with: rcbht import uci." if blocks else "Is the line cut off?"
            if len(row) == len(columns) + 1 and not columns[0].count and number == lines[0][0]:
                hint = "Are these the names of rows, which R writes without a name above? Write row.names = FALSE."
            if [column.name for column in columns] == ["header:"]:
                hint = "Messages that ros2 topic echo prints are no table; print them with --csv, or record a bag."
            raise InputError(f"{path}, line {number}: {len(row)} cells; expected {len(columns)}. {hint}")
    if not columns[0].count:
        first = [row for _, row in lines[:PROBES]]
        marks = [mark for mark in ".," if cells.shows(first, mark)]
        for column in columns if len(marks) == 1 else ():
            column.numerals.assume(marks[0])
    numbers = [number for number, _ in lines]
    for column, some in zip(columns, zip(*(row for _, row in lines), strict=True), strict=False):
        column.add(some, numbers)
    lines.clear()


class _Column:
    """A column that grows; it is text if its first cell with content is."""

    def __init__(self, path: Path, name: str, delimiter: str, words: bool) -> None:
        self._path, self.name, self._where = path, name, f"{path}, column {name}"
        self._delimiter, self.numerals = delimiter, cells.Numerals(delimiter)
        self._parts: list[NDArray[np.generic]] = []
        self._kind = ""  # "f", "U"; "" = nothing but empty cells so far
        self._words, self._cells = words, list[str]()  # as they stand, if numbers among them may be words
        self.count = 0
        self.faults: set[str] = set()  # words for numbers that are not there

    def add(self, written: tuple[str, ...], lines: list[int]) -> None:
        self.count += len(written)
        self._cells += written if self._words else ()
        plain = [cells.plain(cell, "") for cell in written]
        try:
            row = self.numerals.read(plain) if self._kind != "U" else plain
        except ValueError as error:
            raise InputError(f"{self._where} holds {str(error)!r}.{cells.two_meanings(str(error))}") from None
        if not self._kind:
            filled = [cell for cell in row if cell.lower() not in cells.NAN]
            # One stray word in a column of numbers is a mistake, not a label.
            texts = [cell for cell in filled if not cells.is_number(cell)]
            of_text = 2 * len(texts) > len(filled) and not all(map(cells.two_meanings, texts))
            self._kind = "" if not filled else "U" if of_text else "f"
        if self._kind == "U":
            row = ["" if cell in ("nan", "NaN") else cells.plain(cell, self._delimiter) for cell in written]
            self._parts.append(cells.texts(row, self._where))
        else:
            self._parts.append(self._numbers(row, lines))

    def is_of_words(self) -> bool:
        """Whether it holds text that is no time."""
        return self._kind == "U" and not are_dates(self._parts[-1])

    def _numbers(self, row: list[str], lines: list[int]) -> NDArray[np.float64]:
        try:
            if not any("_" in cell for cell in row) and not np.isinf(plain := np.array(row, np.float64)).any():
                return plain
        except ValueError:
            pass
        values = np.empty(len(row))
        for place, cell in enumerate(row):
            if cell.lower() in cells.FAULTS:
                self.faults.add(cell)
                values[place] = np.nan
                continue
            if not cells.is_number(cell):
                where = f"{self._path}, line {lines[place]}, column {self.name}"
                raise InputError(f"{where}: {cell[:30]!r} is not a number.{cells.two_meanings(cell)}")
            values[place] = np.nan if cell.lower() in cells.NAN else float(cell)
        return values

    def array(self) -> NDArray[np.generic]:
        if self._kind != "U":
            values = np.concatenate(self._parts)
            less = [bool(_NO_NUMBER.fullmatch(cell)) for cell in self._cells]
            triples = zip(less, self._cells, values.tolist(), strict=True) if any(less) else ()
            words = [cell if says_more else text(value) for says_more, cell, value in triples]
            return cells.texts(words, self._where) if words else values
        parts: list[NDArray[np.str_]] = [
            np.full(len(part), "") if part.dtype.kind == "f" else part.astype(np.str_, copy=False)
            for part in self._parts
        ]
        longest = max(part.dtype.itemsize // 4 for part in parts)
        cells.check_texts(longest, sum(int(np.char.str_len(part).sum()) for part in parts), self.count, self._where)
        return np.concatenate(parts)


class Between:
    """Tells the rows of a table from the lines between and below them.

    Where rows begin with numbers or dates, words at the beginning of the last lines are no samples.

    >>> lines = Between([["t", "Fz"]], 2)
    >>> lines.samples(2, ["0.0", "1.5"]), lines.samples(3, ["t", "Fz"]), lines.samples(4, ["mean", "1.5"])
    ([(2, ['0.0', '1.5'])], [], [])
    >>> lines.end(of_words=False), lines.left
    ([], ['t', 'mean'])
    """

    def __init__(self, heads: Sequence[list[str]], width: int) -> None:
        """Take the lines of names, and the number of columns."""
        self._heads, self._width = heads, width
        self._words: bool | None = None  # whether rows begin with words; None = not known yet
        self._held: list[Line] = []
        self._samples = 0
        self.left: list[str] = []  # how the first lines begin that were left out
        self.count = 0

    def samples(self, number: int, row: list[str], ended: bool = True) -> list[Line]:
        """The rows that are known to be samples now that one more was read.

        One without the end of a line was cut off while the log was written if it has too few cells, or half an
        exponent in the last: it is no sample.
        """
        if row in self._heads or (row[0].startswith(("#", "%", "//")) and len(row) != self._width):
            self._leave(row[0][:LETTERS])
            return []
        if self._words is None and row[0]:
            self._words = cells.is_word(row[0])
        if self._words is False and len(self._held) < HELD and cells.is_word(row[0]):
            self._held.append((number, row))
            return []
        cut = len(row) < self._width or bool(_HALF.fullmatch(row[-1]))
        if not ended and self._samples and cut and not any("\n" in cell for cell in row):
            self._leave(cut_off(f"{row[0][:LETTERS]},"))
            return []
        found = [*self._held, (number, row)]
        self._held = []
        self._samples += len(found)
        return found

    def too_many(self) -> bool:
        """Whether the last rows are too many to be no samples, most of all where they have a cell for each column."""
        whole = sum(len(row) == self._width for _, row in self._held)
        return 2 * len(self._held) > self._samples or whole > SUMS

    def end(self, of_words: bool) -> list[Line]:
        """The last rows, if the first column is one of words; else they are left out."""
        held, self._held = self._held, []
        if of_words:
            return held
        for _, row in held:
            self._leave(row[0][:LETTERS])
        return []

    def _leave(self, text: str) -> None:
        self.count += 1
        if len(self.left) < LISTED:
            self.left.append(text)


def cut_off(text: str) -> str:
    """How the report quotes a last line that was cut off while the log was written, from how it begins.

    >>> cut_off("12.5,")
    '12.5, ... (the last line, which is cut off)'
    """
    return f"{text} ... (the last line, which is cut off)"
