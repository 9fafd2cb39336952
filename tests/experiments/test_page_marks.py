"""Marks of numbers and tables in the text of a page."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from experiments import pages
from rcbht_jax.errors import InputError


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page beside one result."""
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "COMMITTED", tmp_path)
    result = {"rows": {"A -> B | words, 10 %": [{"mean": 0.98765}, "12 of 13", 4.7e9]}}
    (tmp_path / "some.json").write_text(json.dumps({"seed": 0, "result": result}))
    return tmp_path / "page.md"


def shown(page: Path, mark: str) -> str:
    page.write_text(f"It is <!-- number {mark} -->old<!-- /number --> here.")
    text = pages.replaced(page)
    assert text.startswith(f"It is <!-- number {mark} -->")
    assert pages.by_hand(page) == "It is  here."
    page.write_text(text)
    assert pages.replaced(page) == text
    return re.sub(r"<!--.*?-->", "", text, flags=re.S).removeprefix("It is ").removesuffix(" here.")


def test_numbers_in_sentences(page: Path) -> None:
    row = "some > rows > A -> B | words, 10 % > "
    assert shown(page, f".3f {row}0 > mean") == "0.988"
    assert shown(page, f".0% {row}0 > mean") == "99%"
    assert shown(page, f"s {row}1") == "12 of 13"
    assert shown(page, f".1f/1e9 {row}2") == "4.7"
    assert shown(page, ".2f some\n> rows > A -> B |\nwords, 10 % > 0 > mean") == "0.99"  # a line may end anywhere


def test_a_mark_does_not_begin_a_line(page: Path) -> None:
    for text in (
        "It is\n<!-- number d some > rows -->1<!-- /number -->",
        "* It is\n  <!--\nnumber d some > rows -->1<!-- /number -->",
    ):
        page.write_text(text)
        with pytest.raises(InputError, match=r"page.md, line \d: .* must not begin a line"):
            pages.replaced(page)


@pytest.mark.parametrize(
    ("mark", "why"),
    [
        (".2f none > rows", "no result 'none'"),
        (".2f some > row", "there is: rows"),
        (".2f some > rows > A -> B | words, 10 % > 7", "has no '7'"),
        (".2f some > rows", "not one value"),
        (".2f some > rows > A -> B | words, 10 % > 1", "cannot be shown"),
        (".2f/none some > rows > A -> B | words, 10 % > 2", "cannot be shown"),
    ],
)
def test_a_wrong_number_is_one_sentence(page: Path, mark: str, why: str) -> None:
    page.write_text(f"It is <!-- number {mark} -->old<!-- /number -->")
    with pytest.raises(InputError, match=re.escape(why)):
        pages.replaced(page)


def test_an_unknown_table_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("<!-- table nothing: python -m experiments.pages -->\nold\n<!-- end of table -->\n")
    with pytest.raises(InputError, match="nothing"):
        pages.replaced(page)
