"""Names of columns as robots and programs write them: the axes of a wrench, whatever stands before or behind them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util.columns import split_unit
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.names import wrenches
from rcbht_jax.labels import AXES

N = 60
WRENCH = np.random.default_rng(0).normal(size=(N, 12)).round(3)


def write(path: Path, names: list[str]) -> None:
    rows = [",".join(map(str, [round(k * 0.01, 2), *WRENCH[k, : len(names)]])) for k in range(N)]
    path.write_text("\n".join([",".join(["t", *names]), *rows]))


@pytest.mark.parametrize(
    "head",
    [
        "force_torque",
        "observation.force_torque",
        "robot/force_torque",
        "tcp_force_torque",
        "obs/ft_sensor",
        "$FORCE_TORQUE",
    ],
)
def test_an_array_of_forces_and_torques_is_a_wrench_wherever_it_lies(head: str) -> None:
    """Behind a path, "force_" was part of it, and "torque" the array: no wrench was found."""
    names = [f"{head}_{number}" for number in range(6)]
    assert wrenches(names) == [dict(zip(AXES, names, strict=True))]


@pytest.mark.parametrize("form", ["{axis}{arm}", "{axis} [{arm}]", "{axis} ({arm})", "{axis} {arm}"])
def test_arms_behind_axes_leave_no_mark_in_their_names(form: str, tmp_path: Path) -> None:
    """The axes were called "Fx{arm}"."""
    write(tmp_path / "a.csv", [form.format(axis=axis, arm=arm) for arm in ("L", "R") for axis in AXES])
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.arm.tolist()) == (AXES, ["l", "r"])
    np.testing.assert_allclose(recordings.wrench, [WRENCH[:, :6], WRENCH[:, 6:]], rtol=1e-6)


def test_a_mark_between_a_name_and_its_unit_is_part_of_neither() -> None:
    found = [split_unit(name) for name in ("Fx_[N]", "Time_[s]", "Fx/[N]", "Fx: (N)", "Fx - [N]", "_[N]")]
    assert found == [("Fx", "N"), ("Time", "s"), ("Fx", "N"), ("Fx", "N"), ("Fx", "N"), ("_", "N")]


@pytest.mark.parametrize("form", ["{}_TCP_{}", "{} base {} [N]", "ft.{}.tool.{}", "left_{}_world_{}"])
def test_a_frame_may_stand_between_a_force_and_its_axis(form: str) -> None:
    names = [form.format(kind, axis) for kind in ("Force", "Torque") for axis in "XYZ"]
    names = [name.replace("[N]", "[Nm]") if "Torque" in name else name for name in names]
    assert wrenches(names) == [dict(zip(AXES, names, strict=True))]


@pytest.mark.parametrize("form", ["{} {}{} [N]", "{}/{}{}", "robot.{}.{}{}", "{}{}{}"])
def test_a_quantity_before_an_axis_separates_no_moments_from_forces(form: str) -> None:
    """The moments were left out."""
    names = [form.format(word, letter, axis) for word, letter in (("Force", "F"), ("Torque", "T")) for axis in "xyz"]
    names = [name.replace("[N]", "[Nm]") if "Torque" in name else name for name in names]
    assert wrenches(names) == [dict(zip(AXES, names, strict=True))]


@pytest.mark.parametrize("unit", ["", " [mm]"])
@pytest.mark.parametrize("turn", [["rx", "ry", "rz"], ["qx", "qy", "qz", "qw"]])
def test_translations_of_a_pose_are_no_moments(unit: str, turn: list[str]) -> None:
    """They were imported as Mx, My and Mz, without a remark."""
    pose = [f"tcp/{name}" for name in ("tx", "ty", "tz")]
    forces, turns = [f"tcp/f{axis}" for axis in "xyz"], [f"tcp/{name}" for name in turn]
    assert wrenches([*(name + unit for name in pose), *turns, *forces]) == [dict(zip(AXES, forces, strict=False))]
    for position in ("", "p"):  # beside which t is a torque
        both = [f"tcp/{position}{axis}" for axis in "xyz"]
        assert wrenches([*forces, *pose, *turns, *both]) == [dict(zip(AXES, [*forces, *pose], strict=True))]


def test_a_magnetometer_measures_no_moments(tmp_path: Path) -> None:
    """Beside Tx, Ty and Tz it was imported in their place."""
    inertial = [f"{letter}{axis}" for letter in "agm" for axis in "xyz"]
    write(tmp_path / "a.csv", ["Fx", "Fy", "Fz", *inertial])
    assert read_source(tmp_path).recordings.axes == AXES[:3]
    for letters in ("FTgm", "FMag"):  # the second is a sensor of forces and accelerations
        write(tmp_path / "a.csv", [f"{letter}{axis}" for letter in letters for axis in "xyz"])
        np.testing.assert_allclose(read_source(tmp_path).recordings.wrench[0], WRENCH[:, :6], rtol=1e-6)


def test_a_wrench_without_a_frame_goes_before_those_in_one() -> None:
    """Where its columns came later, the wrench in the frame was imported instead."""
    names = [f"{kind}_{frame}{axis}" for frame in ("base_", "") for kind in "FT" for axis in "xyz"]
    assert wrenches(names) == [dict(zip(AXES, rows, strict=True)) for rows in (names[6:], names[:6])]


def test_wrenches_in_two_frames_are_not_mixed(tmp_path: Path) -> None:
    names = [f"{kind}_{frame}_{axis}" for frame in ("tcp", "base") for kind in "FM" for axis in "xyz"]
    assert wrenches(names) == [dict(zip(AXES, names[:6], strict=True)), dict(zip(AXES, names[6:], strict=True))]
    write(
        tmp_path / "a.csv",
        [f"{kind}_{arm}_{axis}" for arm in ("left", "right") for kind in ("force", "torque") for axis in "xyz"],
    )
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.arm.tolist()) == (AXES, ["left", "right"])
    np.testing.assert_allclose(recordings.wrench, [WRENCH[:, :6], WRENCH[:, 6:]], rtol=1e-6)


def test_a_position_between_forces_and_a_rotation_is_remarked(tmp_path: Path) -> None:
    titles = ["t", *(f"{what}{axis}" for what in ("f", "t", "r") for axis in "xyz")]
    rows = np.column_stack([np.arange(60) / 100, np.random.default_rng(0).normal(size=(60, 9))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(titles), comments="")
    imported = read_source(tmp_path / "a.csv")
    assert imported.recordings.axes == ("Fx", "Fy", "Fz")
    assert any(remark.startswith("tx ... tz are read as a position, since rx") for remark in imported.report.remarks)
