"""``rcbht view``: what cannot be shown is said before the trial is simulated again."""

from __future__ import annotations

from pathlib import Path

import pytest

from rcbht_jax.cli import main
from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings
from sim_mjx.synthesis.pipeline import synthesise
from tests.support.fake_simulation import SMALL, fake_engine
from tests.support.store_cases import simple


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main.main(["view", *words]) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    return sentence


def test_a_picture_of_no_format_is_refused_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "trial.txt"
    said = refused(capsys, str(tmp_path), "t", "-o", str(file))  # no store: reading it is the work
    assert "trial.txt does not end in .png, .svg, .pdf, .gif, .mp4;" in said


def test_tracks_that_are_not_there_are_refused_before_the_simulation(
    hiro_store: Path, hiro_recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(hiro_store), str(hiro_recordings.trial[0]), "-o", str(tmp_path / "trial.png"), "--tracks", "NOPE"]
    assert "has no label tracks" in refused(capsys, *words, "--data", str(tmp_path))
    assert "needs its joint angles" in refused(capsys, *words)  # before anything is read


def test_a_joined_store_says_what_it_does_not_keep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated, recorded, joined = (tmp_path / f"{name}.zarr" for name in ("simulated", "recorded", "joined"))
    synthesise(simulated, SMALL, simulate=fake_engine)
    write_recordings(recorded, simple(), {})
    assert main.main(["join", str(recorded), str(simulated), "-o", str(joined)]) == 0
    capsys.readouterr()
    said = refused(capsys, str(joined), "sim-B-000000", "-o", str(tmp_path / "t.png"))
    assert "view a simulated trial in the store that simulated it" in said


def test_a_simulated_trial_has_no_folder_of_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    synthesise(tmp_path / "simulated.zarr", SMALL, simulate=fake_engine)
    said = refused(
        capsys, str(tmp_path / "simulated.zarr"), "sim-B-000000", "--data", str(tmp_path), "-o", str(tmp_path / "t.png")
    )
    assert "needs no recorded joint angles; leave out --data" in said


def test_a_display_that_is_not_there_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("glfw")
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "The display cannot be opened" in refused(capsys, str(tmp_path), "t")


def test_a_default_name_that_no_file_can_have_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    assert "File name too long" in refused(capsys, str(tmp_path), "x" * 300)
    (tmp_path / "zarr.json").write_text("{}")
    assert "is in the store" in refused(capsys, str(tmp_path), "t")
