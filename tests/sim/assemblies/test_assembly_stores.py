"""From the command line to a store with annotated phases, labels and faults, resumed and shown again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import list_tracks
from rcbht_jax.io.store import read_recordings, read_simulation
from sim_mjx.assemblies.clip import CLIP as CLIP_PARTS
from sim_mjx.assemblies.clip import LEAD
from sim_mjx.assemblies.latch import HOOK
from sim_mjx.registry import get_scenario, pair
from sim_mjx.robots.ur5e import UR5E
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.passes import TRACK
from sim_mjx.validation import replay
from tests.support.fake_simulation import tree

CLIP = ["--assembly", "clip", "--robot", "ur5e"]
SHORT = [*CLIP, "--trials", "5", "--shard", "2", "--max-seconds", "0.3"]


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clips") / "clips.zarr"
    assert main.main(["simulate", str(path), *CLIP, "--trials", "4", "--seed", "4", "--window", "5"]) == 0
    return path


def test_a_store_has_phases_faults_labels_and_numbers(clips: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recordings, known = read_recordings(clips), read_simulation(clips)
    scenario = get_scenario("clip@ur5e")
    assert recordings.annotations.labels == {"phase": scenario.states, "passing": ("LATCH",)}
    assert recordings.annotations.choose() == "phase"
    starts = recordings.starts("phase")
    done = recordings.outcome == "success"
    assert 0 < done.sum() < len(recordings)
    np.testing.assert_array_equal(done, known["seated"].all(1))
    assert np.isfinite(starts[done]).all()
    assert (np.diff(starts[done], axis=1) > 0).all()
    assert recordings.trial[3] == "sim-clip-ur5e-000003"
    for row in range(len(recordings)):
        params, fault = scenario.draw(4, row, scenario.spec())
        assert (recordings.column("fault")[row], known["fault"][row]) == (fault.kind, fault.kind)
        assert recordings.column("deviation_x")[row] == fault.deviation[0]
        assert known["own_clearance"][row] == params.parts.own.clearance
        assert known["task_press"][row] == params.task.press
        assert known["mount_turn"][row] == params.parts.mount.turn
        np.testing.assert_array_equal(known["hand"][row], params.hand)
    failed = [name for name in known["failed_in"] if name]
    assert set(failed) <= set(scenario.states)
    assert len(failed) == (~done).sum()
    # the contact is where the phases say: nothing is felt before the touch, the press after it
    row = int(np.flatnonzero(done)[0])
    first = int(starts[row, 1] / 0.005)
    force = np.abs(recordings.wrench[row, : recordings.length[row], 2])
    assert force[: first - 20].max() < 2.0
    assert force[first:].max() > 8.0
    assert list_tracks(clips) == ["online-W5"]
    assert main.main(["info", str(clips)]) == 0
    shown = capsys.readouterr().out
    assert "task phase: approach" in shown
    assert "annotations passing: LATCH" in shown


def test_the_passes_of_a_store_are_those_of_its_motions(clips: Path) -> None:
    recordings = read_recordings(clips)
    for row, length in enumerate(recordings.length.tolist()):
        past = replay.simulated(clips, recordings, row).past[:, 0]
        edges = np.flatnonzero(np.diff(past.astype(int), append=0))  # out, in, and out or over again
        assert not past[0]
        passes = recordings.annotations.of_recording(row).of(TRACK)
        np.testing.assert_array_equal(np.rint(np.stack([passes.start, passes.end], 1) / 0.005).ravel(), edges + 1)
        assert len(past) == length
    assert len(recordings.annotations.of(TRACK)) > 0


def test_a_peg_passes_no_lip(tmp_path: Path) -> None:
    words = ["--assembly", "peg-in-hole", "--robot", "panda", "--trials", "2", "--max-seconds", "0.2"]
    assert main.main(["simulate", str(tmp_path / "pegs.zarr"), *words]) == 0
    assert read_recordings(tmp_path / "pegs.zarr").annotations.tracks == ("phase",)


def test_tabs_are_named_all_or_none() -> None:
    with pytest.raises(InputError, match="clip names 2 tabs and 1 marks"):
        pair(replace(CLIP_PARTS, tabs=("FRONT", "REAR")), UR5E)


def test_interrupted_and_called_again_it_gives_the_same_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Draft.write

    def stop_at_second(self: Draft, shard: int, *of_it: Any) -> None:
        if shard == 1:
            raise KeyboardInterrupt
        real(self, shard, *of_it)

    with monkeypatch.context() as patch:
        patch.setattr(Draft, "write", stop_at_second)
        assert main.main(["simulate", str(tmp_path / "again.zarr"), *SHORT]) == 130
    assert main.main(["simulate", str(tmp_path / "again.zarr"), *SHORT]) == 0
    assert main.main(["simulate", str(tmp_path / "once.zarr"), *SHORT]) == 0
    assert tree(tmp_path / "once.zarr") == tree(tmp_path / "again.zarr")


def test_a_trial_is_simulated_again_and_shown(clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "one.png"
    assert main.main(["view", str(clips), "sim-clip-ur5e-000000", "-o", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["how"] == "simulated again; equal to the stored trial"
    assert list(result["moments"])[:2] == ["approach", "press"]
    again = replay.simulated(clips, read_recordings(clips), 0)
    np.testing.assert_array_equal(again.past[-1], read_simulation(clips)["seated"][0])
    # at first the hook's tip is 15 mm and the lead of the corners above the lip; caught, it is just below
    assert 15e-3 + LEAD < again.height[0, 0] < 16e-3 + LEAD + HOOK.overlap + HOOK.tip_radius
    assert -2e-3 < again.height[-1, 0] < 0
    with Image.open(out) as picture:
        assert len(picture.convert("RGB").resize((160, 145)).getcolors(160 * 145)) > 200  # not blank


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--assembly", "bolt"], "There is no assembly 'bolt'"),
        (["--assembly", "clip", "--robot", "pr2"], "There is no robot 'pr2'"),
        (["--assembly", "clip", "--preset", "B"], "--preset and --physical belong to the assembly camera-snap"),
        (["--robot", "panda"], "camera-snap cannot use the robot 'panda'; expected 'hiro'"),
        (["--assembly", "nowhere.py:PIN"], "There is no Python file nowhere.py"),
    ],
)
def test_mistakes_are_named(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["simulate", str(tmp_path / "x.zarr"), "--trials", "1", *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
