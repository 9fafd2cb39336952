"""Tables of results on the pages are those of the committed files, and no score is typed in by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from experiments import pages
from experiments.figures.all import FIGURES, PICTURES
from experiments.tables import TABLES
from rcbht_jax.errors import InputError
from rcbht_jax.learning.tasks import CONFOUNDS

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "experiments" / "results"
SCORE = re.compile(r"(?<![\d.])[01]?\.\d{2,}")
# Pages whose scores are all generated.
BY_HAND = (
    "README.md", "docs/evaluation.md", "docs/measurements/classification.md", "docs/sim_to_real.md", "docs/engines.md",
    "docs/howto/features.md", "docs/concepts.md", "docs/tutorial.md", "docs/calibration.md", "docs/online.md",
)  # fmt: skip


def test_every_table_is_shown_somewhere() -> None:
    assert {name for page in pages.pages() for name in pages.tables_of(page)} == set(TABLES)


@pytest.mark.parametrize("page", pages.pages(), ids=lambda page: page.stem)
def test_tables_and_numbers_are_those_of_the_committed_results(page: Path) -> None:
    assert pages.replaced(page) == page.read_text(encoding="utf-8"), "run python -m experiments.pages"


@pytest.mark.parametrize("name", TABLES)
def test_every_number_of_a_table_is_in_a_result(name: str) -> None:
    lines = TABLES[name]("").splitlines()
    assert len({line.count("|") for line in lines}) == 1
    held = {f"{abs(number) / unit:.{digits}f}" for number in all_numbers() for digits in (2, 3, 4) for unit in (1, 1e6)}
    found = re.findall(r"(?<![\d.])\d\.\d{2,4}(?!\d)", "\n".join(lines[2:]))
    assert found or name in ("experiments", "pictures", "synthesis")  # whose numbers are whole
    assert set(found) <= held


def all_numbers() -> list[float]:
    return [number for path in RESULTS.glob("*.json") for number in numbers(json.loads(path.read_text()))]


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return [number for part in parts for number in numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.parametrize("page", BY_HAND)
def test_no_score_is_typed_in_by_hand(page: str) -> None:
    assert not SCORE.findall(pages.by_hand(ROOT / page))


def test_no_score_is_typed_into_the_warnings_of_reports_and_data_cards() -> None:
    assert not SCORE.findall(" ".join(CONFOUNDS.values()))


def test_every_picture_has_a_command_that_draws_it() -> None:
    drawn = [*FIGURES, *PICTURES]
    assert sorted(drawn) == sorted(path.stem for path in (ROOT / "docs" / "images").glob("*.png"))


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
