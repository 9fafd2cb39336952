"""Numbers as people write them: decimal commas, and marks between thousands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_BETWEEN = ",.' \u00a0\u2009\u202f’"  # marks between thousands
_GROUPED = re.compile(rf"^([+-]?\d{{1,3}})([{_BETWEEN}])(\d{{3}}(?:\2\d{{3}})*)(?:([,.])(\d*))?$")
_DECIMAL = re.compile(r"^[+-]?(\d*)([,.])(\d+)(?:[eE][+-]?\d+)?$")
_WHOLE = re.compile(r"^[+-]?[1-9]\d{0,2}$")


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
    """Whether the only mark of a number may be a decimal one or one between thousands.

    >>> [_may_be_thousands(cell) for cell in ("1,234", "0,234", "1,23", "1,234.5")]
    [True, False, False, False]
    """
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
