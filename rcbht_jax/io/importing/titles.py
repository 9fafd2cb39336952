"""The lines of a table before its rows: those of a data logger, comments, names of the columns, units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from rcbht_jax._util.columns import split_unit
from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_TABLE_LINE
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import cells
from rcbht_jax.io.importing.names import wrenches
from rcbht_jax.io.importing.preamble import line_of_names, row_of_numbers
from rcbht_jax.io.importing.unpacked import line_of

PREAMBLE, PREAMBLE_LINE = 64, 2**14  # lines at most before the names of the columns, and bytes of one
HEADINGS = 4  # lines of names at most below the first


@dataclass(frozen=True)
class Titles:
    """What stands before the rows."""

    names: list[str]  # of the columns, each once
    delimiter: str
    body: int  # byte at which the rows begin
    lines: tuple[list[str], ...]  # of names and units, as cells
    before: list[bytes]  # lines of a data logger
    comments: list[bytes]


def read_titles(file: BinaryIO, path: Path, encoding: str) -> Titles:
    """The names of the columns of a table, which is at its beginning, and where its rows begin.

    Names may stand in several lines, as spreadsheets and data frames have them: ``Force,,`` above ``x,y,z``. A line of
    units may follow. Columns without a name are called c0, c1, ... by their place.

    >>> _ = Path("a.csv").write_text("t,Force,\\n,x,y\\n[s],[N],[N]\\n0,1,2\\n0.1,1,2\\n")
    >>> with open("a.csv", "rb") as file:
    ...     titles = read_titles(file, Path("a.csv"), "utf-8")
    >>> titles.names
    ['t [s]', 'Force x [N]', 'Force y [N]']

    Raises:
        InputError: the file is empty or no text, or has too many columns.
    """
    before = _preamble(file)
    head, comment, comments = _head(file, path)
    start = file.tell()
    delimiter = _delimiter(head, file.readline(MAX_TABLE_LINE))
    file.seek(start)
    titles = cells.split(head, delimiter, encoding)
    if not titles:  # of control characters alone
        raise InputError(f"{path} begins with a line that holds nothing; expected a table.")
    following = _following(file, delimiter, encoding)
    # a delimiter at the end of every row makes an empty cell more than there are names
    below = [row[:-1] if len(row) == len(titles) + 1 and not row[-1] else row for row, _ in following]
    if before and below and titles[-1] == "Comment" and len(titles) == len(below[0]) + 1:
        del titles[-1]  # which LabVIEW writes whether or not rows have one
    if not (comment or cells.is_title(titles, below[0] if below else [])):
        names = _checked([f"c{number}" for number in range(len(titles))], path)
        return Titles(names, delimiter, start - len(head), (), before, comments)
    joined, used = _headings(titles, below)
    units = _units(below[used:], len(titles))
    if units:
        joined = [f"{title} [{unit}]" if unit and title else title for title, unit in zip(joined, units, strict=True)]
    passed = used + bool(units)
    body = following[passed - 1][1] if passed else start
    return Titles(_distinct(joined, path), delimiter, body, (titles, *below[:passed]), before, comments)


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
    while line := line_of(file, path):
        if mark := cells.COMMENT.match(line):
            comment = line[mark.end() :]
            comments = [*comments, line][:PREAMBLE]
        elif line.strip():
            line = _closed(file, line)
            # A comment is the line of names if it has as many of them as the first row has cells.
            row = cells.split(line, cells.delimiter_of(line))
            titles = cells.split(comment, cells.delimiter_of(comment)) if comment else []
            if len(titles) == len(row) and all(map(cells.is_number, row)):
                file.seek(file.tell() - len(line))
                return comment, True, comments
            return line, False, comments
    raise InputError(f"{path} is empty; expected a table.")


def _closed(file: BinaryIO, line: bytes) -> bytes:
    """The line, with the next ones while a quote is open in it: names may have line feeds, which become blanks."""
    start, whole = file.tell(), line
    for _ in range(PREAMBLE):
        if whole.count(b'"') % 2 == 0:
            return whole[:-1].translate(bytes.maketrans(b"\r\n", b"  ")) + whole[-1:]
        whole += file.readline(PREAMBLE_LINE)
    file.seek(start)
    return line


def _delimiter(head: bytes, below: bytes) -> str:
    """The mark between the cells of a line, that of the next one if both have as many cells then: names have commas."""
    own, other = cells.delimiter_of(head), cells.delimiter_of(below)
    return other if 1 < len(cells.split(head, other)) == len(cells.split(below, other)) else own


def _following(file: BinaryIO, delimiter: str, encoding: str) -> list[tuple[list[str], int]]:
    """The cells of the next lines, and where each line ends."""
    found = []
    for _ in range(HEADINGS + 2):
        if not (line := file.readline(MAX_TABLE_LINE)):
            break
        row = cells.split(line, delimiter, encoding)
        found += [(row, file.tell())] if any(row) else []  # a blank line may follow that of units
    return found


def _headings(titles: list[str], below: Sequence[list[str]]) -> tuple[list[str], int]:
    """The names with those of further lines, and the number of these lines."""
    used = 0
    while used < HEADINGS and _is_heading(below[used:], len(titles), used):
        row = below[used]
        used += 1
        filled = [name for name in row if name]
        if len(filled) < len(titles) / 2 and all(row[: len(filled)]):  # the names of an index
            titles = [name or title for name, title in zip(row, titles, strict=True)]
            continue
        alone = bool(wrenches(filled)) and len(set(filled)) == len(filled)
        spread: list[str] = []
        for title, name in zip(titles, row, strict=True):  # a name holds for empty cells to its right
            spread.append(title or (spread[-1] if name and spread else ""))
        pairs = zip(spread, row, strict=True)
        titles = [_joined(title, name, alone) for title, name in pairs]
    return titles, used


def _joined(title: str, name: str, alone: bool) -> str:
    """A name of two lines; ``alone``: the lower ones say enough, but where they are units."""
    if title and name and split_unit(f"x [{name}]")[1]:
        return f"{title} [{name}]"
    return name if name and alone else " ".join(filter(None, (title, name)))


def _is_heading(rows: Sequence[list[str]], width: int, used: int) -> bool:
    """Whether the first of these rows has names of as many columns: words alone, above a row of numbers."""
    if not rows or len(rows[0]) != width or cells.units(rows[0]):
        return False
    numbers = row_of_numbers(rows)
    filled = [name for name in rows[0] if name]
    if numbers is None or not filled or any(map(cells.is_number, filled)):
        return False
    most = 2 * sum(bool(name) for name in rows[0]) >= width
    index = used > 0 and all(rows[0][: len(filled)])
    return (most or index) and len(numbers) == width and 2 * cells.count_numbers(numbers) >= width


def _units(rows: Sequence[list[str]], width: int) -> list[str]:
    """The units in the first of these rows, if the columns of known ones hold numbers in the next; else none.

    Words such as "UTC" above a time or a text are no units.
    """
    units, first = cells.units(rows[0]) if rows else [], rows[1] if len(rows) > 1 else []
    if not len(first) == len(units) == width or not any(map(cells.is_number, first)):
        return []
    above = [unit for unit, cell in zip(units, first, strict=True) if not cells.is_number(cell)]
    if any(split_unit(f"x [{unit}]")[1] for unit in above):
        return []
    return [unit if cells.is_number(cell) else "" for unit, cell in zip(units, first, strict=True)]


def _distinct(titles: list[str], path: Path) -> list[str]:
    seen: dict[str, int] = {}
    names = []
    for number, title in enumerate(_checked(titles, path)):
        cell = title or f"c{number}"
        count = seen[cell] = seen.get(cell, 0) + 1
        names.append(cell if count == 1 else f"{cell}.{count}")
    return names


def _checked(titles: list[str], path: Path) -> list[str]:
    if len(titles) > MAX_COLUMNS:
        raise InputError(f"{path} has {len(titles)} columns; expected at most {MAX_COLUMNS}.")
    if any(not cell.isprintable() for cell in titles):
        raise InputError(
            f"{path} is not a table: its first line is not text. Unpack it if it is compressed, or save it as UTF-8."
        )
    return titles
