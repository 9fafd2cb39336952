"""The README: its example runs, its commands exist, its numbers are those of the committed results."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from experiments.readme import BEGIN, END, replaced, table

ROOT = Path(__file__).resolve().parents[1]


def test_python_examples_run() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})


def test_commands_exist() -> None:
    from rcbht_jax.cli import COMMANDS

    lines = re.findall(r"^rcbht (.*)$", (ROOT / "README.md").read_text(), re.M)
    assert lines
    for line in lines:
        assert any(line.startswith(name + " ") or line == name for name in COMMANDS), line


def test_results_are_those_of_the_committed_files() -> None:
    text = (ROOT / "README.md").read_text()
    assert replaced(text) == text, "run python -m experiments.readme"
    rows = [line for line in table().splitlines() if "experiments/results/" in line]
    assert len(rows) >= 5
    for row in rows:
        source, *_ = re.findall(r"experiments/results/\w+\.json", row)
        held = {f"{number:.3f}" for number in numbers(json.loads((ROOT / source).read_text())["result"])}
        assert set(re.findall(r"\d\.\d{3}", row)) <= held


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return [number for part in parts for number in numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []


def test_no_score_is_typed_in_by_hand() -> None:
    text = (ROOT / "README.md").read_text()
    outside = text[: text.index(BEGIN)] + text[text.index(END) :]
    prose = re.sub(r"```.*?```", "", outside, flags=re.S)
    assert not re.findall(r"(?<![\d.])[01]?\.\d{2,}", prose)


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / "README.md").read_text()):
        assert target.startswith("http") or (ROOT / target).exists(), target
