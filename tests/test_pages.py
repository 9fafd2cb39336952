"""Tables of results on the pages are those of the committed files, and no score is typed in by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from experiments import pages
from experiments.tables import TABLES
from rcbht_jax.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments" / "results"
SCORE = re.compile(r"(?<![\d.])[01]?\.\d{2,}")
# Pages of scores.
BY_HAND = ("README.md", "docs/evaluation.md", "docs/measurements/classification.md", "docs/sim_to_real.md")


def test_every_table_is_shown_somewhere() -> None:
    assert {name for page in pages.pages() for name in pages.tables_of(page)} == set(TABLES)


@pytest.mark.parametrize("page", pages.pages(), ids=lambda page: page.stem)
def test_tables_are_those_of_the_committed_results(page: Path) -> None:
    assert pages.replaced(page) == page.read_text(encoding="utf-8"), "run python -m experiments.pages"


@pytest.mark.parametrize("name", TABLES)
def test_every_number_of_a_table_is_in_a_result(name: str) -> None:
    lines = TABLES[name]("").splitlines()
    assert len({line.count("|") for line in lines}) == 1
    held = {f"{number / unit:.{digits}f}" for number in all_numbers() for digits in (2, 3, 4) for unit in (1, 1e6)}
    found = re.findall(r"(?<![\d.])\d\.\d{2,4}(?!\d)", "\n".join(lines[2:]))
    assert found or name in ("experiments", "synthesis")  # whose numbers are whole
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
    prose = re.sub(r"```.*?```", "", pages.without_tables(ROOT / page), flags=re.S)
    assert not SCORE.findall(prose)


def test_an_unknown_table_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("<!-- table nothing: python -m experiments.pages -->\nold\n<!-- end of table -->\n")
    with pytest.raises(InputError, match="nothing"):
        pages.replaced(page)
