"""What commands print: counts in words, tables that a terminal can show, types of options."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from rcbht_jax.cli import main
from rcbht_jax.cli.learning import WIDEST, Evaluate, _table
from tests.support.command_line import CommandLine

ROOT = Path(__file__).resolve().parents[2]
COUNTED = "axes|cores|events|files|folds|recordings|results|sessions|shards|trials"


@pytest.mark.parametrize("folder", ["rcbht_jax/cli", "sim_mjx/cli"])
def test_what_is_counted_is_worded_by_plural(folder: str) -> None:
    found = {
        f"{path.name}: {match}"
        for path in (ROOT / folder).glob("*.py")
        for match in re.findall(rf"\}} (?:{COUNTED})\b(?!/)", path.read_text())
    }
    assert found == set()


def test_one_fold_and_one_trial_are_singular() -> None:
    result = {
        "task": {"task": "states"}, "tracks": "online-W5", "trials": 1, "items": {"a": 1}, "dropped": {},
        "untrained": [], "tested": 1, "protocol": {"group": "trial"}, "chosen": {"linear": 1}, "classes": ["a", "b"],
        "confusion": [[1, 0], [0, 1]], "confounds": "",
    }  # fmt: skip
    score = {"mean": 0.5}
    rows = dict.fromkeys(
        ("score", "duration_baseline", "majority_baseline"), {"accuracy": score} | {"balanced_accuracy": score}
    )
    text = Evaluate(Path("x.zarr")).text(result | rows)
    assert "1 trial; a 1" in text
    assert "(1 of 1 fold)" in text


def test_a_confusion_matrix_keeps_the_names_of_its_classes() -> None:
    short = _table(["approach", "insertion", "insertions"], [[100, 0, 2], [0, 3, 0], [0, 0, 123456789012]])
    assert short[0].split() == ["approach", "insertion", "insertions"]
    assert [line.split() for line in short[1:]] == [
        ["approach", "100", "0", "2"], ["insertion", "0", "3", "0"], ["insertions", "0", "0", "123456789012"],
    ]  # fmt: skip
    assert len(set(map(len, short))) == 1


def test_a_wide_confusion_matrix_numbers_its_columns() -> None:
    names = [f"failure of kind {kind}" for kind in "abcdefghijklm"]
    table = _table(names, [[int(row == column) for column in range(13)] for row in range(13)])
    assert table[0].split() == [str(number) for number in range(1, 14)]
    assert table[1].startswith(" 1 failure of kind a  1  0")
    assert table[13].startswith("13 failure of kind m  0")
    assert max(map(len, table)) <= WIDEST


@pytest.mark.parametrize("name", list(main.all_commands()))
def test_help_fits_into_the_terminal(name: str, rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what is copied: the usage and the example."""
    monkeypatch.setenv("COLUMNS", "60")
    lines = rcbht(*name.split(), "--help").splitlines()
    assert [line for line in lines if len(line) > 60 and not line.startswith(("usage: ", "Example: "))] == []


def test_only_what_is_left_out_is_none(rcbht: CommandLine) -> None:
    given = main.parse("plot trial", ["x", "t", "-o", "t.png", "--seconds", "1", "2.5"])
    assert vars(given)["seconds"] == (1.0, 2.5)
    left = main.parse("plot trial", ["x", "t", "-o", "t.png"])
    assert vars(left)["seconds"] is None
    rcbht.refused("stream", "x", "--rate", "None")
    rcbht.refused("encode", "x", "--robot", "None")
