"""Rules of the house that no linter checks: the length of files, and where public names are explained."""

from __future__ import annotations

import re
from pathlib import Path

import rcbht_jax

ROOT = Path(__file__).resolve().parents[2]
MOST_LINES = 400


def test_no_file_is_longer_than_400_lines() -> None:
    folders = ("rcbht_jax", "sim_mjx", "experiments", "examples", "tests", "tools", ".ci")
    lines = {path: path.read_text().count("\n") for folder in folders for path in (ROOT / folder).rglob("*.py")}
    assert len(lines) > 200
    assert {str(path): count for path, count in lines.items() if count > MOST_LINES} == {}


def test_every_public_name_is_in_the_reference() -> None:
    pages = "\n".join(page.read_text() for page in (ROOT / "docs/reference").glob("*.md"))
    entries = re.findall(r"^::: rcbht_jax\.(\w+)$", pages, re.M)
    assert set(rcbht_jax.__all__) <= set(entries)
