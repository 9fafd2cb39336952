"""Recorded tool poses against those of the model: which samples are compared, by what measure, and what holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from rcbht_jax.io.hiro import dat
from sim_mjx.assembly.scene import one_arm
from sim_mjx.presets import preset
from sim_mjx.validation import fidelity


class TrialName(NamedTuple):
    """What the name of a recorded trial says."""

    session: str
    outcome: str


@pytest.mark.parametrize(("lag", "marks", "rows"), [(0, 60, 55), (2, 60, 55), (2, 17, None), (2, 18, 13), (2, 500, 90)])
def test_poses_are_compared_until_shortly_before_contact(
    monkeypatch: pytest.MonkeyPatch, lag: int, marks: int, rows: int | None
) -> None:
    """Each row holds its number; angles are those of ``lag`` samples before the pose."""
    lines = {"Angles": 100, "CartPos": 90}

    def numbered(path: Path, _: str) -> dat.TimedTable:
        time = np.arange(float(lines[path.name]))
        return dat.TimedTable(0.005 * time, np.tile(time[:, None], 6), 0.005)

    monkeypatch.setattr(fidelity, "data_file", lambda _trial, _side, kind: Path(kind))
    monkeypatch.setattr(dat, "read_timed", numbered)
    monkeypatch.setattr(dat, "read_state_times", lambda _: np.array([0.0, 0.005 * marks]))
    found = fidelity._approach(Path(), replace(preset("C"), pose_lag=lag, last_joint_offset=0.25))
    assert (found is None) == (rows is None)
    if found is not None and rows is not None:
        joints, poses = found
        np.testing.assert_array_equal(joints[:, 0], np.arange(rows - lag))
        np.testing.assert_array_equal(joints[:, 5], np.arange(rows - lag) - 0.25)
        np.testing.assert_array_equal(poses[:, 3], np.arange(lag, rows))
    monkeypatch.setattr(dat, "read_state_times", lambda _: np.zeros(1))
    assert fidelity._approach(Path(), preset("C")) is None


def test_errors_of_poses_are_millimetres_and_degrees() -> None:
    scene = one_arm()
    data, site = mujoco.MjData(scene.model), scene.model.site("RARM_TCP").id
    joints = np.tile(np.linspace(-0.4, 0.5, 6), (4, 1))
    data.qpos[scene.joints] = joints[0]
    mujoco.mj_kinematics(scene.model, data)
    turn = data.site_xmat[site].reshape(3, 3)
    rpy = np.arctan2(turn[2, 1], turn[2, 2]), -np.arcsin(turn[2, 0]), np.arctan2(turn[1, 0], turn[0, 0])
    poses = np.tile(np.concatenate([data.site_xpos[site] + [0.003, -0.004, 0], rpy]), (4, 1))
    yaw = np.array([0.0, 1e-3, 10.0, 170.0])
    poses[:, 5] += np.radians(yaw)
    found = fidelity._pose_errors(scene.model, data, site, scene.joints, joints, poses)
    np.testing.assert_allclose(found, np.stack([np.full(4, 5.0), yaw], 1), atol=1e-6)


@pytest.mark.parametrize(
    ("errors", "holds"), [((0.01, 0.001), True), ((0.02, 0.001), False), ((0.01, 0.01), False), ((0.014, 0.0), True)]
)
def test_poses_hold_within_both_limits(
    monkeypatch: pytest.MonkeyPatch, errors: tuple[float, float], holds: bool
) -> None:
    """The second half of the samples are exact; recorded failures of the simulation, and other poses, do not count."""
    names = {
        "good": TrialName(preset("C").recorded_as, "success"),
        "ERROR-14": TrialName(preset("C").recorded_as, "success"),
        "failed": TrialName(preset("openhrp").recorded_as, "failure"),
        "other": TrialName("none", "success"),
    }
    monkeypatch.setattr(fidelity, "find_trials", lambda _: [("source", Path(name)) for name in names])
    monkeypatch.setattr(fidelity, "parse_trial", lambda _, name: names[name])
    monkeypatch.setattr(fidelity, "_approach", lambda *_: (np.zeros((2, 6)), np.zeros((2, 6))))
    monkeypatch.setattr(fidelity, "_pose_errors", lambda *_: np.array([errors, (0.0, 0.0)]))
    found = fidelity.kinematics(Path())
    assert set(found) == {"C"}
    assert (found["C"]["trials"], found["C"]["holds"]) == (1, holds)
    assert (found["C"]["rms_mm"], found["C"]["rms_degrees"]) == pytest.approx(tuple(np.array(errors) / 2**0.5))
