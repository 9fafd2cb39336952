"""Rules of the house that no linter checks: the length of files, and where public names are explained."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rcbht_jax

ROOT = Path(__file__).resolve().parents[2]
MOST_LINES = 400


def test_no_file_is_longer_than_400_lines() -> None:
    folders = ("rcbht_jax", "sim_mjx", "experiments", "examples", "tests", "tools", ".ci")
    lines = {path: path.read_text().count("\n") for folder in folders for path in (ROOT / folder).rglob("*.py")}
    assert len(lines) > 200
    assert {str(path): count for path, count in lines.items() if count > MOST_LINES} == {}


@pytest.mark.parametrize("name", getattr(rcbht_jax, "__all__", ()))
def test_a_public_name_is_in_the_reference(name: str) -> None:
    pages = "\n".join(page.read_text() for page in (ROOT / "docs/reference").glob("*.md"))
    entries = set(re.findall(r"^::: (\S+)", pages, re.M))
    value = getattr(rcbht_jax, name)
    home = getattr(value, "__module__", None) or value.__name__  # of a module, its own name
    assert entries & {home, f"{home}.{name}", "rcbht_jax", f"rcbht_jax.{name}"}, f"{name} of {home}"
