"""Lines of a table as text: its delimiter, its cells, and numbers as people write them, with commas and thousands."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax._util.untrusted import MAX_RATIO, MAX_TEXT_BYTES
from rcbht_jax.errors import InputError

COMMENT = re.compile(  # what begins one, but not the names that "rostopic echo -p" writes; a mark of UTF-8 aside
    rb"^(?:\xef\xbb\xbf)?(?!%time)(?:[#%]|//)(?:[#% ]|//)*"
)
NAN = {"", "nan", "na", "n/a", "null", "-nan", "#n/a", "-", "--"}
FAULTS = {  # words that programs, sensors and spreadsheets write for a number that they lack
    "none", "nil", "missing", "invalid", "bad", "err", "error", "#error", "ovf", "ovl", "ovr", "overflow", "overload",
    "overrange", "over range", "underflow", "#value!", "#div/0!", "#num!", "#ref!", "#name?", "#null!", "---", "----",
    "?", "nan(ind)", "-nan(ind)", "nan(snan)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf", "inf",
    "-inf", "+inf", "infinity", "-infinity", "∞", "-∞",
}  # fmt: skip
_BLANKS = re.compile(r"\s+(?![\[(][^\W\d][^\s\])]*[\])])")  # but before a unit: Time (s)
_QUOTED = re.compile(r'"([^"]*)"|([^\s"]+)')  # between blanks
_OF_DAY = re.compile(r"\d:\d\d,\d+$")  # the end of a time with a decimal comma
_COMMA = re.compile(r"^([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)$")
_BETWEEN = ",.' \u00a0\u2009\u202f’"  # marks between thousands
_GROUPED = re.compile(rf"^([+-]?\d{{1,3}})([{_BETWEEN}])(\d{{3}}(?:\2\d{{3}})*)(?:([,.])(\d*))?$")
_DECIMAL = re.compile(r"^[+-]?(\d*)([,.])(\d+)(?:[eE][+-]?\d+)?$")
_DOUBLE = re.compile(r"^([+-]?\d*\.\d*)D([+-]\d\d+)$")  # as Fortran prints it; 1.5D3 may be a serial number
_WHOLE = re.compile(r"^[+-]?[1-9]\d{0,2}$")
_BETWEEN_BLANKS = re.compile(r"[+-]?\d+(?:,\d+(?:[eE][+-]?\d+)?)?")  # numbers, some with decimal commas


def delimiter_of(line: bytes) -> str:
    """The mark between the cells of a line; " " = blanks.

    >>> delimiter_of(b"1,5;2,5"), delimiter_of(b"t,Fz"), delimiter_of(b"t Fz")
    (';', ',', ' ')
    >>> delimiter_of(b"0,5 1,5"), delimiter_of(b"0, 1,5"), delimiter_of(b"12:00:00,5;1,5;2,5")
    (' ', ',', ';')
    """
    for mark in ";\t|":
        if mark.encode() in line and b"," in line:
            cells = [cell.strip() for cell in _cells(line.decode("utf-8", "replace").strip("\r\n"), mark)]
            if all(is_number(plain(cell, mark)) or _OF_DAY.search(cell) for cell in cells if "," in cell):
                return mark  # its commas are those of numbers and times
    words = line.decode("utf-8", "replace").split()
    if len(words) > 1 and b"," in line and all(map(_BETWEEN_BLANKS.fullmatch, words)):
        return "\t" if b"\t" in line else " "
    counts = {mark: line.count(mark.encode()) for mark in ";\t|,"}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] else " "


def split(line: bytes, delimiter: str, encoding: str = "utf-8-sig") -> list[str]:
    """The cells of a line, with points for decimal commas, which stand in quotes between commas.

    >>> split(b"1,5; push", ";"), split(b'"1,5",push', ",")
    (['1.5', 'push'], ['1.5', 'push'])
    """
    text = line.decode(encoding, "replace").strip("\r\n")
    if delimiter == " ":
        words = between_blanks(text)
        if '"' not in text and not all(word.startswith(("[", "(", "-")) for word in words):  # units alone
            words = _BLANKS.split(text.strip())
        return [plain(cell, delimiter) for cell in words]
    return [plain(cell.strip(), ";") for cell in _cells(text, delimiter)]


def between_blanks(line: str) -> list[str]:
    """The cells of a line between blanks, some perhaps in quotes.

    >>> between_blanks('0.5 "free air" ""'), between_blanks("0.5  free ")
    (['0.5', 'free air', ''], ['0.5', 'free'])
    """
    return [quoted or word for quoted, word in _QUOTED.findall(line)] if '"' in line else line.split()


def _cells(text: str, delimiter: str) -> list[str]:
    """Cells as they stand; the whole text where it is no line of a table, such as one with a carriage return in it."""
    try:
        return next(csv.reader([text], delimiter=delimiter), [])
    except csv.Error:
        return [text]


def is_number(cell: str) -> bool:
    """Whether a cell is a number or missing.

    >>> is_number("1e3"), is_number(""), is_number("push")
    (True, True, False)
    """
    try:
        float(cell)
    except ValueError:
        return cell.lower() in NAN
    return "_" not in cell


def plain(cell: str, delimiter: str) -> str:
    """A cell with a point where a table without commas between cells has a decimal one, and without brackets of a row.

    An exponent may be one of double precision in Fortran.

    >>> plain("1,5", ";"), plain("1,5", ","), plain("( 1.5", ","), plain("1.5D+02", " ")
    ('1.5', '1,5', '1.5', '1.5e+02')
    """
    if "D" in cell:
        return _DOUBLE.sub(r"\1e\2", cell)
    if cell[:1] in ("(", "[") or cell[-1:] in (")", "]"):
        inner = cell.strip("()[] ")
        return inner if inner and is_number(inner) else cell
    return _COMMA.sub(r"\1.\2", ungrouped(cell)) if delimiter and delimiter in ";\t| " and "," in cell else cell


def count_numbers(cells: Sequence[str]) -> int:
    """How many cells hold a number, missing values and empty cells aside.

    >>> count_numbers(["1.5", "", "nan", "push"])
    1
    """
    return sum(is_number(cell) and cell.lower() not in NAN for cell in cells)


def is_word(cell: str) -> bool:
    """Whether a cell is neither a number, nor begins like one or a date, nor empty.

    >>> is_word("mean"), is_word("2026-05-01"), is_word("-1.5"), is_word("nan"), is_word("")
    (True, False, False, False, False)
    """
    return not re.match(r"[+-]?[.,]?\d", cell) and not is_number(cell)


def is_title(cells: list[str], below: list[str]) -> bool:
    """Whether a line holds the names of the columns, and is no row like the next one.

    Words that stand in the same cells of both, among more numbers, are no names; 0, 1, 2, ... above other numbers are.

    >>> is_title(["t", "Fz", "phase"], ["0", "1.5", "free"]), is_title(["0", "tool0", "1.5"], ["1", "tool0", "1.7"])
    (True, False)
    >>> is_title(["", "0", "1", "2", "3"], ["0", "1.5", "1.7", "1.1", "0.2"])
    True
    """
    numbers = [is_number(cell) for cell in cells]
    counted, first = ([cell for cell in row if cell and is_number(cell)] for row in (cells, below))
    if len(counted) > 3 and any(counted == [str(k + low) for k in range(len(counted))] for low in (0, 1)):
        return any(not cell.lstrip("+-").isdecimal() for cell in first)
    return not all(numbers) and (numbers != [is_number(cell) for cell in below] or 2 * sum(numbers) <= len(cells))


def units(cells: list[str]) -> list[str]:
    """The units in a line below that of names, none where a cell has none; [] = it is no such line.

    >>> units(["[s]", "[N]"]), units(["0", "1"])
    (['s', 'N'], [])
    """
    bare = [cell.strip("[]()- ") for cell in cells]
    known = [split_unit(f"x [{unit}]")[1] for unit in bare]
    numbers = any(map(is_number, filter(None, bare)))
    return bare if any(known) and not numbers and 2 * sum(map(bool, known)) >= sum(map(bool, bare)) else []


def texts(values: Sequence[str], what: str) -> NDArray[np.str_]:
    """A column of text, whose cells all take the memory of the longest.

    >>> texts(["free", "touch"], "a.csv, column phase").tolist()
    ['free', 'touch']

    Raises:
        InputError: the longest cell makes it far larger than what it holds.
    """
    check_texts(max(map(len, values), default=0), sum(map(len, values)), len(values), what)
    return np.array(values, np.str_)


def check_texts(longest: int, letters: int, count: int, what: str) -> None:
    """InputError: the longest of so many cells, which hold so many letters, is too long for a column of text."""
    if 4 * longest * count > max(MAX_TEXT_BYTES, MAX_RATIO * (letters + count)):
        raise InputError(f"{what} has a text of {longest} letters among {count}; labels are shorter.")


def ungrouped(cell: str) -> str:
    """A number without the marks between its thousands, where these can be nothing else; any other text as it is.

    >>> ungrouped("1,234.5"), ungrouped("1.234,5"), ungrouped("1'234"), ungrouped("1,234,567"), ungrouped("1,234")
    ('1234.5', '1234.5', '1234', '1234567', '1,234')
    """
    found = _GROUPED.match(cell)
    if not found:
        return cell
    head, between, groups, mark, tail = found.groups()
    sure = between not in ",." or (mark and mark != between) or (not mark and between == "," and len(groups) > 3)
    if not sure or mark == between:
        return cell
    return head + groups.replace(between, "") + (f".{tail}" if tail else "")


class Numerals:
    """How the numbers of a column are written, as far as the cells show that were read."""

    def __init__(self, delimiter: str) -> None:
        """Take the mark between cells: between commas, a comma alone is a decimal one only if the table shows it."""
        self._commas = delimiter != ","
        self._points = delimiter == ","  # whether a point is a decimal one where nothing else shows it
        self._marks: set[str] = set()  # decimal ones, without doubt

    def assume(self, mark: str) -> None:
        """Other columns of the table have that decimal mark, commas perhaps in quotes: this one has no other."""
        self._points, self._commas = self._points or mark == ".", self._commas or mark == ","
        if mark == "," or not self._commas:
            self._marks.add(mark)

    def read(self, cells: Sequence[str]) -> list[str]:
        """The cells, numbers with a point for the decimals and without marks between thousands.

        A mark before three digits stands between thousands if other numbers of the column show that it cannot be a
        decimal one.

        >>> Numerals(";").read(["999,5", "1.000", "push"]), Numerals(",").read(["999.5", "1,000"])
        (['999.5', '1000', 'push'], ['999.5', '1000'])

        Raises:
            ValueError: a number may mean two; its message is that number.
        """
        whole = "".join(cells)
        marks = _BETWEEN if not self._points else _BETWEEN.replace(".", "")
        if not (self._marks - {"."}) and not any(mark in whole for mark in marks):
            return list(cells)
        self._marks |= {mark for cell in cells if (mark := self._mark(cell))}
        whole_ones = any(map(_WHOLE.match, cells))
        return [self._plain(cell, whole_ones) for cell in cells]

    def _mark(self, cell: str) -> str:
        """The decimal mark of a number; "" = it shows none, or one that may stand between thousands."""
        if (found := _GROUPED.match(cell)) and ungrouped(cell) != cell:
            return found[4] or (".,"[found[2] == "."] if found[2] in ",." else "")
        decimal = _DECIMAL.match(cell)
        if not decimal or (decimal[2] == "," and not self._commas) or _may_be_thousands(cell):
            return ""
        return decimal[2]

    def _plain(self, cell: str, whole_ones: bool) -> str:
        if _may_be_thousands(cell):
            mark = "," if "," in cell else "."
            if self._marks == {"." if mark == "," else ","}:
                return cell.replace(mark, "")
            unknown = self._commas if mark == "," else not self._points
            if unknown and whole_ones and not self._marks:
                raise ValueError(cell)  # 12,345 or 12.345 beside 998
        cell = ungrouped(cell)
        decimal = _DECIMAL.match(cell)
        commas = self._commas or self._marks == {","}
        return cell.replace(",", ".") if decimal and decimal[2] == "," and commas else cell


def _may_be_thousands(cell: str) -> bool:
    """Whether the only mark of a number may be a decimal one or one between thousands."""
    found = _GROUPED.match(cell)
    return bool(found and not found[4] and found[2] in ",." and len(found[3]) == 3 and found[1].lstrip("+-")[0] != "0")


def shows(rows: Iterable[Sequence[str]], mark: str) -> bool:
    """Whether a number in these rows has that decimal mark without doubt.

    >>> shows([["1,000", "0.5"]], "."), shows([["1,000", "1.500"]], "."), shows([["1,000", "0,5"]], ",")
    (True, False, True)
    """
    numbers = (cell for row in rows for cell in row if mark in cell and _DECIMAL.match(cell))
    return any(not _may_be_thousands(cell) for cell in numbers)


def two_meanings(cell: str) -> str:
    """The end of a sentence about a number that may mean two; "" = it does not.

    >>> two_meanings("12,345"), two_meanings("push")
    (' It may mean 12345 or 12.345; write numbers without marks between thousands.', '')
    """
    if not _may_be_thousands(cell):
        return ""
    plain = re.sub("[,.]", "", cell), re.sub("[,.]", ".", cell)
    return f" It may mean {plain[0]} or {plain[1]}; write numbers without marks between thousands."
