"""The tables and numbers on the README and in the documentation, read from the committed results.

A page has a table between two lines, ``<!-- table NAME: python -m experiments.pages -->`` and
``<!-- end of table -->``, and a number inside a sentence between two marks:

    ``<!-- number FORMAT RESULT > KEY > ... -->0.981<!-- /number -->``

FORMAT is one of Python's for numbers (``.3f``, ``.0%``, ``,``), or ``s`` for text; ``.1f/1e9`` divides by 1e9 first.
RESULT is a file in experiments/results; the keys lead to one value of its "result", and count from 0 in lists. A line
may end wherever there is a space inside a mark, but none may begin with one: that would end the paragraph. The text
between the marks is replaced. A test fails when a page differs.

Run: python -m experiments.pages
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from experiments._lib.report_rows import NAME, report_rows
from experiments._lib.results_io import COMMITTED
from experiments.tables import TABLES
from rcbht_jax.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
_TABLE = re.compile(r"(<!-- table (.*?): python -m experiments\.pages -->\n).*?(<!-- end of table -->)", re.S)
_NUMBER = re.compile(r"(<!--\s+number\s+(\S+)\s+(.+?)\s+-->)[^<]*(<!-- /number -->)", re.S)
_FIRST = re.compile(r"^[ \t]*<!--\s+/?number", re.M)


def pages() -> list[Path]:
    """Every page with a table or a number."""
    paths = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    texts = {page: page.read_text(encoding="utf-8") for page in paths}
    return [page for page, text in texts.items() if _TABLE.search(text) or _NUMBER.search(text)]


def tables_of(page: Path) -> list[str]:
    """Names of the tables on a page."""
    return [match[2] for match in _TABLE.finditer(page.read_text(encoding="utf-8"))]


def value_of(place: str) -> Any:
    """The value at ``RESULT > KEY > ...``.

    Raises:
        InputError: there is none, or several.
    """
    place = " ".join(place.split())
    name, *keys = place.split(" > ")
    path = COMMITTED / f"{name}.json"
    if not path.is_file():
        raise InputError(f"There is no result {name!r} for the number {place!r}.")
    record = json.loads(path.read_text(encoding="utf-8"))
    value: Any = record.get("result", record)
    for key in keys:
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, ValueError, TypeError):
            known = ", ".join(map(str, value)) if isinstance(value, dict) else type(value).__name__
            raise InputError(f"{name}.json has no {key!r} at {place!r}; there is: {known}.") from None
    if isinstance(value, dict | list):
        raise InputError(f"{place!r} is not one value; add one of {', '.join(map(str, value))}.")
    return value


def number(wanted: str, place: str) -> str:
    """The value at a place as it is shown.

    Raises:
        InputError: no such value, or the format does not fit it.
    """
    form, _, unit = wanted.partition("/")
    value = value_of(place)
    try:
        return format(value / float(unit) if unit else value, form)
    except (TypeError, ValueError) as error:
        raise InputError(f"The number {place!r}, {value!r}, cannot be shown as {wanted!r}: {error}.") from error


def replaced(page: Path) -> str:
    """A page with the tables and numbers of today in place of the old ones.

    Raises:
        InputError: it names a table or a number that does not exist, or a line begins with the mark of a number.
    """
    results = "../" * (len(page.relative_to(ROOT).parts) - 1) + "experiments/results/"

    def table(match: re.Match[str]) -> str:
        if match[2] not in TABLES:
            raise InputError(f"{page} has a table {match[2]!r}; there are {', '.join(TABLES)}.")
        return f"{match[1]}{TABLES[match[2]](results)}\n{match[3]}"

    text = _TABLE.sub(table, page.read_text(encoding="utf-8"))
    if mark := _FIRST.search(text):
        line = text.count("\n", 0, mark.end()) + 1
        raise InputError(f"{page}, line {line}: the mark of a number must not begin a line; move a word before it.")
    return _NUMBER.sub(lambda match: f"{match[1]}{number(match[2], match[3])}{match[4]}", text)


def by_hand(page: Path) -> str:
    """The text written by hand: without tables, generated numbers, code and addresses of links."""
    text = _NUMBER.sub("", _TABLE.sub("", page.read_text(encoding="utf-8")))
    return re.sub(r"```.*?```|\]\([^)]*\)", "", text, flags=re.S)


if __name__ == "__main__":
    text = json.dumps(report_rows(), indent=1, ensure_ascii=False)
    (COMMITTED / f"{NAME}.json").write_text(text + "\n", encoding="utf-8")
    for path in pages():
        path.write_text(replaced(path), encoding="utf-8")
