"""``rcbht view``: a stored trial moves again as it did, and pictures, film and viewer show it."""

from __future__ import annotations

import json
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np
import pytest
import zarr
from PIL import Image
from scipy.spatial import ConvexHull

from rcbht_jax.cli import main
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.hiro import dat
from rcbht_jax.io.store import read_recordings
from rcbht_jax.plots.canvas import new_figure
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.scene import one_arm
from sim_mjx.assembly.two_arm_scene import two_arm
from sim_mjx.plots import animation, projection, trial_overview
from sim_mjx.validation import replay

TRIAL = "sim-C-000001"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three nominal trials of session C, to their end."""
    path = tmp_path_factory.mktemp("view") / "c.zarr"
    assert main.main(["simulate", str(path), "--preset", "C", "--trials", "3", "--nominal-share", "1"]) == 0
    return path


@pytest.fixture(scope="module")
def shown(simulated: Path) -> replay.Replay:
    return replay.simulated(simulated, read_recordings(simulated), 1)


@pytest.fixture
def at_once(shown: replay.Replay, monkeypatch: pytest.MonkeyPatch) -> None:
    """``rcbht view`` shows the trial as it was simulated again before, where that is not what is tested."""
    monkeypatch.setattr(replay, "simulated", lambda *_: shown)


def test_a_stored_trial_is_simulated_again_exactly(simulated: Path, shown: replay.Replay) -> None:
    recordings = read_recordings(simulated)
    assert shown.how == "simulated again; equal to the stored trial"
    assert shown.qpos.shape == (recordings.length[1], one_arm().model.nq)
    seated = zarr.open_group(simulated / "simulation", mode="r")["seated"][1]
    np.testing.assert_array_equal(shown.past[-1], seated)
    # a tab that is past its lip is below the height that counts, and stays part of the story
    assert (shown.height[shown.past] < 0).all()
    found = replay.moments(shown, recordings.starts(HARMONISED)[1])
    assert list(found.values()) == sorted(found.values())
    assert found["touch"] == recordings.starts(HARMONISED)[1, 1]
    assert {name for name in found if name.endswith(replay.PASSES)} == {
        f"{tab}{replay.PASSES}" for tab, seat in zip(("FR", "FL", "RR", "RL"), seated, strict=True) if seat
    }
    frames = trial_overview.choose(found)
    assert len(frames) <= trial_overview.FRAMES
    assert list(frames)[-1].endswith("end")


def test_an_event_with_the_name_of_a_state_is_its_start() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    still = replay.Replay(model, np.zeros((2001, 0)), 0.005, np.zeros((2001, 4), bool), np.zeros((2001, 4)), "made up")
    onset = {"approach": 0.0, "rotation": 3.0, "insertion": 7.0, "mating": 8.0}
    found = replay.moments(still, np.array(list(onset.values())))
    assert found["touch"] == onset["rotation"]
    assert found["mid-rotation"] == 5.0
    assert {name: found[name] for name in onset.keys() & found} == {"insertion": 7.0, "mating": 8.0}


def test_a_changed_trial_is_said_to_differ(simulated: Path, tmp_path: Path) -> None:
    recordings = read_recordings(simulated)
    recordings.wrench[1, 100, 2] += 3.0
    assert (
        "forces within 3 N of the stored trial, moments within 0 Nm" in replay.simulated(simulated, recordings, 1).how
    )
    recordings = read_recordings(simulated)
    recordings.wrench[1, 100, 4] += 0.5
    assert (
        "forces within 0 N of the stored trial, moments within 0.5 Nm" in replay.simulated(simulated, recordings, 1).how
    )
    recordings.length[1] -= 10
    assert "differs from the stored trial" in replay.simulated(simulated, recordings, 1).how


def test_pictures_and_films_are_written_whole(
    simulated: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    png, gif = tmp_path / "a.png", tmp_path / "a.gif"
    assert main.main(["view", str(simulated), TRIAL, "-o", str(png), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["picture"] == str(png)
    assert {"before touch", "touch", "mating", "end"} <= set(result["moments"])
    with Image.open(png) as picture:
        assert picture.size == (1600, 1450)
        assert len(picture.convert("RGB").resize((160, 145)).getcolors(160 * 145)) > 200  # not blank
    request.getfixturevalue("at_once")
    figures: list[Any] = []
    monkeypatch.setattr(animation, "new_figure", lambda *size: figures.append(new_figure(*size)) or figures[-1])
    assert main.main(["view", str(simulated), TRIAL, "-o", str(gif), "--speed", "20"]) == 0
    assert "SIM_MJX_C, success (fault: none); tabs past their lips" in figures[0].get_suptitle()  # as in a picture
    end = (read_recordings(simulated).length[1] - 1) * 0.005
    assert figures[0].axes[-1].lines[-1].get_xdata() == [end, end]  # the last picture
    with Image.open(gif) as film:
        assert film.n_frames == np.ceil(end / 20 * 10) + 1  # at twenty times the speed, ten pictures a second
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.png"]


def test_a_plotted_trial_names_its_fault(simulated: Path, tmp_path: Path) -> None:
    out = tmp_path / "t.svg"
    assert main.main(["plot", "trial", str(simulated), TRIAL, "-o", str(out)]) == 0
    assert "success (fault: none)" in out.read_text()  # texts are paths, and comments


@pytest.mark.usefixtures("at_once")
def test_without_a_display_a_picture_is_written(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    assert main.main(["view", str(simulated), TRIAL]) == 0
    assert (tmp_path / f"{TRIAL}.png").stat().st_size > 10_000


@pytest.mark.usefixtures("at_once")
def test_with_a_display_the_viewer_plays_it(
    simulated: Path, shown: replay.Replay, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[np.ndarray] = []

    class Window(nullcontext[None]):
        def __init__(self, data: mujoco.MjData) -> None:
            super().__init__()
            self._data = data

        def is_running(self) -> bool:
            return len(seen) < 3

        def sync(self) -> None:
            seen.append(self._data.qpos.copy())

    def launch(_: mujoco.MjModel, data: mujoco.MjData) -> Window:
        return Window(data)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("sim_mjx.cli.view.check_window", lambda: None)
    monkeypatch.setattr(mujoco.viewer, "launch_passive", launch)
    assert main.main(["view", str(simulated), TRIAL]) == 0
    assert len(seen) == 3
    assert min(np.abs(shown.qpos - seen[-1]).max(1)) == 0

    def fail(*_: object) -> None:
        raise RuntimeError("no window")

    monkeypatch.setattr(mujoco.viewer, "launch_passive", fail)
    assert main.main(["view", str(simulated), TRIAL]) == 2
    assert "viewer cannot be opened (no window)" in capsys.readouterr().err


def test_a_recorded_trial_follows_its_joint_angles(
    hiro_store: Path, hiro_dir: Path, hiro_recordings: Recordings, tmp_path: Path
) -> None:
    row = int(np.flatnonzero(hiro_recordings.session == "B")[0])
    found = replay.recorded(hiro_dir, hiro_recordings, row)
    folder = hiro_dir / str(hiro_recordings.source[row]) / str(hiro_recordings.trial[row])
    angles = dat.read_timed(folder / "R_Angles.dat", "joint angles").values
    common = min(len(angles), len(found.qpos))
    np.testing.assert_array_equal(found.qpos[:common, one_arm().joints], angles[:common, :6])
    out = tmp_path / "r.svg"
    words = ["view", str(hiro_store), str(hiro_recordings.trial[row]), "--data", str(hiro_dir), "-o", str(out)]
    assert main.main(words) == 0
    assert "<svg" in out.read_text()[:500]


def test_both_arms_of_a_two_arm_trial_move(
    hiro_dir: Path, hiro_recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    row = int(np.flatnonzero(hiro_recordings.arm == "L")[0])
    led = replay.recorded(hiro_dir, hiro_recordings, row)
    folder = hiro_dir / str(hiro_recordings.source[row]) / str(hiro_recordings.trial[row])
    both = [dat.read_timed(folder / f"{arm}_Angles.dat", "joint angles").values[50, :6] for arm in "RL"]
    np.testing.assert_array_equal(led.qpos[50, two_arm().joints], np.concatenate(both))
    path = tmp_path / "two.zarr"
    short = ["--preset", "two", "--trials", "1", "--max-seconds", "0.2", "--nominal-share", "1"]
    assert main.main(["simulate", str(path), *short]) == 0
    out = tmp_path / "two.png"
    assert main.main(["view", str(path), "sim-two-000000", "--arm", "L", "-o", str(out)]) == 0
    assert "equal to the stored trial" in capsys.readouterr().out
    assert out.stat().st_size > 10_000


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["-o", "nowhere/a.png"], "nowhere is not a folder"),
        (["-o", "a.txt"], "does not end in"),
        (["-o", "a.png", "--speed", "0"], "speed is 0"),
    ],
)
def test_mistakes_are_one_sentence(
    words: list[str],
    sentence: str,
    simulated: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main.main(["view", str(simulated), TRIAL, *words]) == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_wrong_stores_are_one_sentence(
    simulated: Path, hiro_store: Path, hiro_recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    real = str(hiro_recordings.trial[hiro_recordings.session == "A"][0])
    assert main.main(["view", str(hiro_store), real, "-o", str(tmp_path / "a.png")]) == 2
    assert "needs its joint angles" in capsys.readouterr().err
    assert main.main(["view", str(hiro_store), real, "--data", str(tmp_path), "-o", str(tmp_path / "a.png")]) == 2
    assert "holds no trial" in capsys.readouterr().err
    two_arms = str(hiro_recordings.trial[hiro_recordings.arm == "L"][0])
    out = ["--source", "SIM_HIRO_TWO", "--data", str(tmp_path), "-o", str(tmp_path / "a.png")]
    (tmp_path / two_arms).mkdir()
    assert main.main(["view", str(hiro_store), two_arms, *out]) == 2
    assert "holds no R_Angles.dat" in capsys.readouterr().err
    other = tmp_path / "other.zarr"
    shutil.copytree(simulated, other)
    attributes = zarr.open_group(other, mode="r+", use_consolidated=False)
    job = dict(attributes.attrs["simulated"])
    job["job"] = {**job["job"], "spec": {"colour": [1, 2]}}
    attributes.attrs["simulated"] = job
    zarr_io.consolidate(other)
    assert main.main(["view", str(other), TRIAL, "-o", str(tmp_path / "a.png")]) == 2
    assert "another version" in capsys.readouterr().err


def test_outlines_are_silhouettes() -> None:
    """Against convex hulls by SciPy, for random turns."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(quat=(0.3, -0.5, 0.7, 0.2))
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.2, 0.3), pos=(0.4, 0.5, 0.6), mass=1)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0, 0, 0, 0.3, 0.2, 0.1), size=(0.05, 0, 0), mass=1)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.07, 0, 0), pos=(-0.3, 0, 0), mass=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    box, capsule, sphere = (projection.outline(model, data, geom, projection.SIDE) for geom in range(3))
    corners = data.geom_xpos[0] + (projection.CORNERS * [0.1, 0.2, 0.3]) @ data.geom_xmat[0].reshape(3, 3).T
    expected = ConvexHull(corners[:, [0, 2]])
    assert ConvexHull(box).volume == pytest.approx(expected.volume)
    assert len(box) == len(expected.vertices)
    np.testing.assert_allclose(np.linalg.norm(sphere - data.geom_xpos[2][[0, 2]], axis=1), 0.07)
    length = np.linalg.norm((data.geom_xmat[1].reshape(3, 3)[:, 2] * 2 * model.geom_size[1][1])[[0, 2]])
    assert ConvexHull(capsule).volume == pytest.approx(length * 0.1 + np.pi * 0.05**2, rel=0.01)
