"""Lines of a table that are no samples: names that a program wrote again, comments, sums below the last row."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rcbht_jax.io.importing.cells import is_word

HELD, SUMS = 64, 16  # lines below the last row at most, and those of them with as many cells as a row
LISTED, LETTERS = 16, 40  # of what was left out
_HALF = re.compile(r"[+-]?\d*\.\d*[eE][+-]?")  # a number that ends within its exponent
Line = tuple[int, list[str]]  # its number and its cells


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
            self._words = is_word(row[0])
        if self._words is False and len(self._held) < HELD and is_word(row[0]):
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
