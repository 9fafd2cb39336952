"""A speed that has fallen is noticed, noise is not."""

from __future__ import annotations

import json
import shutil
import subprocess
from itertools import count
from pathlib import Path

import pytest

from tools import speed
from tools.speed import ROOT, Speeds, compare, measure, speeds_of

UNITS = {"encode": "samples/s", "step": "us", "encode/compile": "s", "encode/label": "bytes/slot"}


def _tree(folder: Path, **values: float) -> Path:
    """A tree whose benchmarks print these values."""
    package = folder / "rcbht_jax/cli"
    package.mkdir(parents=True)
    result = {"values": {name: {"value": value, "unit": UNITS[name]} for name, value in values.items()}}
    (package / "main.py").write_text(f"print({json.dumps(json.dumps(result))})")
    return folder


def test_a_tree_measures_itself_and_not_the_installed_package(tmp_path: Path) -> None:
    assert measure(_tree(tmp_path, encode=8.0, step=4.0)) == {"encode": 8.0, "step": 0.25}


def test_only_speeds_are_compared() -> None:
    assert speeds_of({name: {"value": 2.0, "unit": unit} for name, unit in UNITS.items()}) == {
        "encode": 2.0, "step": 0.5,
    }  # fmt: skip


@pytest.mark.parametrize(("slower", "rounds"), [(0.85, 2), (0.75, 6)])
def test_a_speed_that_seems_to_have_fallen_is_measured_again(slower: float, rounds: int) -> None:
    runs = count()

    def ours() -> Speeds:
        next(runs)
        return {"encode": slower, "step": 1.0}

    assert compare(ours, lambda: {"encode": 1.0, "step": 1.0}) == {"encode": slower, "step": 1.0}
    assert next(runs) == rounds


def test_one_run_without_disturbance_is_enough() -> None:
    disturbed = iter([0.5, 0.6, 0.7, 0.95])
    assert compare(lambda: {"encode": next(disturbed)}, lambda: {"encode": 1.0}) == {"encode": 0.95}
    assert next(disturbed, None) is None


def test_a_speed_that_is_no_longer_measured_has_fallen() -> None:
    assert compare(lambda: {"step": 1.0}, lambda: {"step": 1.0, "read": 1.0})["read"] == 0


@pytest.mark.parametrize(("ours", "status"), [(0.9, 0), (0.7, 1)])
def test_a_fall_is_the_exit_status(
    ours: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["speed"])
    monkeypatch.setattr(speed, "unpack", lambda commit, folder: True)
    monkeypatch.setattr(speed, "measure", lambda tree: {"encode": ours if tree == ROOT else 1.0})
    assert speed.main() == status
    assert ("fallen" in capsys.readouterr().out.splitlines()[1]) == bool(status)


def test_the_committed_baseline_is_a_commit_of_this_project(tmp_path: Path) -> None:
    asked = ["git", "rev-parse", "--is-shallow-repository"]
    git = shutil.which("git") and subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    if not git or git.stdout.strip() != "false":  # an archive of the sources or a shallow clone; CI's is neither
        pytest.skip("this is no clone with the project's history, in which the baseline could be found")
    assert speed.unpack((ROOT / "benchmarks/baseline").read_text().strip(), tmp_path)
    assert (tmp_path / "rcbht_jax/cli/bench.py").is_file()
    assert not speed.unpack("0" * 40, tmp_path)


def test_without_git_nothing_is_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not speed.unpack("HEAD", tmp_path)
