"""The README: its recipes are short, its commands and links exist; test_docs runs its code, test_pages its tables."""

from __future__ import annotations

import re

from tests.support.pages import ROOT, python_blocks


def test_three_recipes_are_short() -> None:
    """Lines of code without imports and output: labels of an array, a classifier, a store."""
    recipes = (ROOT / "README.md").read_text().split("## Three recipes")[1]
    blocks = [code for code, _ in python_blocks(ROOT / "README.md") if code in recipes]
    lines = [
        [line for line in code.splitlines() if line and not line.startswith(("from ", "print("))] for code in blocks
    ]
    labels, _, classifier, store = map(len, lines)  # the second block makes the data
    assert labels <= 2
    assert classifier <= 5
    assert store <= 5


def test_commands_exist() -> None:
    from rcbht_jax.cli.main import command_name

    lines = re.findall(r"^rcbht (.*)$", (ROOT / "README.md").read_text(), re.M)
    assert lines
    for line in lines:
        assert command_name(line.split()), line


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / "README.md").read_text()):
        assert target.startswith("http") or (ROOT / target).exists(), target
