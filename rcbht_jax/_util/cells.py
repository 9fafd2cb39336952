"""Cells of tables as text: a name from an untrusted file must not be a formula that a spreadsheet runs."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Any

# Signs before a word or number, such as "+x-y" or "-0.5", do nothing.
_FORMULA = re.compile(r"'*(?:[=@\t\r]|[+-](?![\w.+-]*\Z))")


def cell(value: Any) -> Any:
    """A value as it is written: an apostrophe before what a spreadsheet would run.

    >>> cell("=HYPERLINK(A1)"), cell("+x-y"), cell(1.5)
    ("'=HYPERLINK(A1)", '+x-y', 1.5)
    """
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def text_of(written: str) -> str:
    """The text that :func:`cell` was given.

    >>> text_of("'=HYPERLINK(A1)"), text_of("'tis")
    ('=HYPERLINK(A1)', "'tis")
    """
    return written[1:] if written.startswith("'") and _FORMULA.match(written) else written


def number_of(value: Any) -> float:
    """The number that a cell holds, NaN where it holds another text.

    >>> number_of("1.5"), number_of("")
    (1.5, nan)
    """
    try:
        return float(value)
    except ValueError:
        return float("nan")


def table_text(*rows: Iterable[Any]) -> str:
    r"""Rows of a table as CSV.

    >>> table_text(("name", "count"), ("=A1", 2))
    "name,count\n'=A1,2\n"
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(cell, row) for row in rows)
    return text.getvalue()
