"""Results are strict JSON: what any other program reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments._lib import results_io
from rcbht_jax._util.untrusted import parse_json

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("benchmarks", "conda", "docs", "examples", "experiments", "rcbht_jax", "sim_mjx", "tests", "tools")


def test_every_json_file_of_the_project_is_strict() -> None:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.json")]
    assert len(files) > 50
    for path in files:
        try:
            parse_json(path.read_text(encoding="utf-8"))
        except ValueError as error:
            pytest.fail(f"{path.relative_to(ROOT)}: {error}")


def test_a_result_that_is_not_a_number_is_refused_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results_io, "RESULTS", tmp_path)
    for wrong, said in (
        ({"rows": [1.0, {"a": float("nan")}]}, "result > rows > 1 > a is nan"),
        ((float("inf"),), "inf"),
    ):
        with pytest.raises(ValueError, match=said):
            results_io.write_result("x", "python -m experiments.x", wrong, show=False)
    assert not list(tmp_path.iterdir())
    path = results_io.write_result("x", "python -m experiments.x", {"rows": [None, 1.0]}, show=False)
    assert parse_json(path.read_text())["result"] == {"rows": [None, 1.0]}


def test_parts_that_other_options_made_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results_io, "RESULTS", tmp_path)
    results_io.write_result("x", "python -m experiments.x --trials 3", {"a": 1, "b": 2}, show=False)
    assert results_io.parts_of("x", "python -m experiments.x --trials 3", ("a", "c")) == {"a": 1}
    assert results_io.parts_of("x", "python -m experiments.x --trials 4", ("a", "c")) == {}
