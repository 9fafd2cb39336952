"""``rcbht demo`` without data: the whole chain from simulated trials to a summary."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from rcbht_jax.cli import main
from rcbht_jax.io.store import read_simulation
from sim_mjx.cli import demo
from sim_mjx.cli.simulate import Simulate
from sim_mjx.plots import trial_overview
from sim_mjx.presets import HOOKED


def test_the_chain_runs_without_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "KERNELS", ("linear",))
    monkeypatch.setattr(demo, "COSTS", (1.0,))
    monkeypatch.setattr(demo, "REPEATS", 1)
    titles, headline = list[str](), trial_overview.headline
    monkeypatch.setattr(trial_overview, "headline", lambda *given: titles.append(headline(*given)) or titles[-1])
    # a session whose trials take 10 s in place of 20, and no jammed one waits for 40 s
    monkeypatch.setattr(demo, "PRESET", "hooked-C")
    monkeypatch.setattr(demo, "Simulate", partial(Simulate, max_seconds=10.5))
    out = tmp_path / "out"
    assert main.main(["demo", "--out", str(out), "--trials", "40", "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert [line[:5] for line in captured.err.splitlines() if line.startswith("[")] == [f"[{i}/5]" for i in range(1, 6)]
    faults = read_simulation(out / "trials.zarr")["fault"]
    assert result["simulated"]["faults"]["none"]["trials"] == (faults == "none").sum()
    assert 8 <= (faults == "none").sum() <= 32  # about half
    assert set(result["labels"]) == {"primitive", "mc", "llb"}
    for task in ("states", "outcome"):
        score = result["evaluation"][task]
        assert score["score"]["balanced_accuracy"]["mean"] > score["majority_baseline"]["balanced_accuracy"]["mean"]
        assert (out / f"{task}.model").exists()
    for picture in result["pictures"]:
        assert Path(picture).stat().st_size > 10_000
    assert any("(fault: none)" in title for title in titles)
    summary = (out / "summary.txt").read_text()
    assert f"{result['simulated']['seated']} of 40" in summary
    assert "duration alone" in summary


def test_it_simulates_parts_that_snap() -> None:
    assert demo.PRESET in HOOKED


def test_too_few_trials_are_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["demo", "--out", str(tmp_path / "out"), "--trials", "3"]) == 2
    assert "--trials is 3; expected at least 40" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["trials.zarr", "states.model", "summary.txt", "hiro.zarr"])
def test_files_that_no_demo_made_are_kept(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_text("mine")
    assert main.main(["demo", "-o", str(tmp_path)]) == 2
    assert "files of the same names that no demo made" in capsys.readouterr().err
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_an_interrupted_demo_is_begun_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        (tmp_path / "trials.zarr").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "Simulate", interrupted)
    assert main.main(["demo", "-o", str(tmp_path)]) == 130
    (tmp_path / "trials.zarr").rmdir()
    assert main.main(["demo", "-o", str(tmp_path)]) == 130


def test_a_folder_without_trials_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["demo", "--data", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "holds no trial" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["demo -o", "fidelity -o", "simulate"])
def test_a_store_is_no_folder_for_results(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "zarr.json").write_text("{}")
    assert main.main([*command.split(), str(tmp_path / "deep" / "out")]) == 2
    assert "is in the store" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 1
