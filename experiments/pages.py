"""The tables of results on the README and in the documentation, read from the committed results.

A page holds a table between two lines, ``<!-- table NAME: python -m experiments.pages -->`` and
``<!-- end of table -->``; what stands between them is replaced. A test fails when a page differs.

Run: python -m experiments.pages
"""

from __future__ import annotations

import re
from pathlib import Path

from experiments.tables import TABLES
from rcbht_jax.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
_TABLE = re.compile(r"(<!-- table (.*?): python -m experiments\.pages -->\n).*?(<!-- end of table -->)", re.S)


def pages() -> list[Path]:
    """Every page with a table."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if _TABLE.search(page.read_text(encoding="utf-8"))]


def tables_of(page: Path) -> list[str]:
    """Names of the tables on a page."""
    return [match[2] for match in _TABLE.finditer(page.read_text(encoding="utf-8"))]


def replaced(page: Path) -> str:
    """A page with the tables of today in place of the old ones.

    Raises:
        InputError: it names a table that does not exist.
    """
    results = "../" * (len(page.relative_to(ROOT).parts) - 1) + "experiments/results/"

    def table(match: re.Match[str]) -> str:
        if match[2] not in TABLES:
            raise InputError(f"{page} has a table {match[2]!r}; there are {', '.join(TABLES)}.")
        return f"{match[1]}{TABLES[match[2]](results)}\n{match[3]}"

    return _TABLE.sub(table, page.read_text(encoding="utf-8"))


def without_tables(page: Path) -> str:
    """What is written by hand."""
    return _TABLE.sub("", page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    for path in pages():
        path.write_text(replaced(path), encoding="utf-8")
