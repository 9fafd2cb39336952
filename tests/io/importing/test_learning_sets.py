"""Files of data sets for robot learning: flags of success and of ends, rates of controllers, other sensors beside."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping, write_mapping
from rcbht_jax.labels import AXES

N = 60
WRENCH = np.random.default_rng(3).normal(size=(N, 6))


def _flags(folder: Path, name: str, flags: list[list[int]], kind: type = bool) -> Imported:
    for number, flag in enumerate(flags):
        set_at = np.array(flag, kind).repeat(N // len(flag))
        np.savez(folder / f"episode_{number}.npz", wrench=WRENCH + number, rate=100, done=set_at, **{name: set_at})
    return read_source(folder)


@pytest.mark.parametrize("kind", [bool, np.uint8])
@pytest.mark.parametrize("name", ["success", "next.success"])
def test_a_flag_that_is_set_is_the_outcome(name: str, kind: type, tmp_path: Path) -> None:
    """Where it is never set, it is constant; ``done`` says nothing but where a recording ends."""
    imported = _flags(tmp_path, name, [[0, 1], [0, 0], [0, 1, 1]], kind)
    assert imported.recordings.outcome.tolist() == ["success", "failure", "success"]
    assert imported.recordings.annotations.names().size == 0
    assert set(imported.recordings.columns) == {name}
    assert not any("outcome" in remark for remark in imported.report.remarks)


def test_a_flag_that_is_taken_back_is_annotated(tmp_path: Path) -> None:
    recordings = _flags(tmp_path, "success", [[0, 1, 0]]).recordings
    assert recordings.outcome.tolist() == ["unknown"]
    assert recordings.annotations.of("success").names().tolist() == ["False", "True", "False"]


def test_a_map_states_that_the_last_value_counts(tmp_path: Path) -> None:
    lines = [f"{row[0]},{'busy' if place < N - 1 else 'nok'}" for place, row in enumerate(WRENCH)]
    (tmp_path / "a.csv").write_text("\n".join(["Fz,result", *lines]))
    (tmp_path / "map.toml").write_text('source_rate = 100\n[columns.outcome]\ncolumn = "result"\nlast = true\n')
    mapping = read_mapping(tmp_path / "map.toml")
    assert read_source(tmp_path / "a.csv", mapping=mapping).recordings.outcome.tolist() == ["failure"]
    write_mapping(tmp_path / "again.toml", mapping)
    assert read_mapping(tmp_path / "again.toml") == mapping


@pytest.mark.parametrize("count", [1, 3])
def test_files_of_another_sensor_do_not_displace_the_wrench(count: int, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "run_wrench.csv", WRENCH, delimiter=",", header=",".join(AXES), comments="")
    for number in range(count):
        np.savetxt(tmp_path / f"a{number}.csv", WRENCH[:, :3] + number, delimiter=",", header="ax,ay,az", comments="")
    imported = read_source(tmp_path, mapping=Mapping(source_rate=100))
    assert (len(imported.recordings), imported.recordings.axes) == (1, AXES)
    assert [name for name, _ in imported.report.skipped] == [f"a{number}.csv" for number in range(count)]


@pytest.mark.parametrize(
    ("stated", "rate"), [({"control_freq": 20}, 20), ({"env_kwargs": {"control_freq": 12.5}}, 12.5)]
)
def test_the_rate_of_the_controller_is_that_of_the_samples(
    stated: dict[str, object], rate: float, tmp_path: Path
) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        file.create_group("data").attrs["env_args"] = json.dumps({"env_name": "Assembly", **stated})
        for number in range(2):
            for name, part in (("force", WRENCH[:, :3]), ("torque", WRENCH[:, 3:])):
                file[f"data/demo_{number}/obs/robot0_ee_{name}"] = part + number
    recordings = read_source(tmp_path).recordings
    assert (len(recordings), recordings.axes, 1 / recordings.dt) == (2, AXES, pytest.approx(rate))


def test_six_numbered_forces_are_a_wrench(tmp_path: Path) -> None:
    names = [f"effort_force_cartesian_{number}" for number in range(6)]
    np.savez(tmp_path / "a.npz", rate=100, setpoint_pos_0=WRENCH[:, 0], **dict(zip(names, WRENCH.T, strict=True)))
    assert read_source(tmp_path).recordings.axes == AXES


def test_an_array_of_forces_is_the_signal_though_it_is_no_whole_wrench(tmp_path: Path) -> None:
    """Of a sensor of two forces and a moment, with the time in the first column; poses have times of their own."""
    stamps = 1.45e9 + np.arange(N) / 250
    pose = np.column_stack([1.45e9 + np.arange(50) / 200, WRENCH[:50, :3]])
    np.savez(tmp_path / "a.npz", ft_wrench=np.column_stack([stamps, WRENCH[:, :3]]), tip_pose=pose, object_pose=pose)
    imported = read_source(tmp_path)
    assert imported.mapping.time == "ft_wrench_0"
    assert imported.recordings.axes == ("ft_wrench_1", "ft_wrench_2", "ft_wrench_3")
    assert 1 / imported.recordings.dt == pytest.approx(250, rel=1e-4)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_the_times_of_a_numbered_sensor_have_its_number(unit: float, tmp_path: Path) -> None:
    stamps = np.arange(N) / 500 * unit
    arrays = {"wrench_0": WRENCH, "wrench_time_stamps_0": stamps, "wrench_1": WRENCH, "wrench_time_stamps_1": stamps}
    np.savez(tmp_path / "a.npz", **arrays, robot_time_stamps_0=np.arange(9.0) * unit, ts_pose_fb_0=np.zeros((9, 7)))
    imported = read_source(tmp_path)
    assert imported.mapping.time == "wrench_time_stamps_0"
    assert (imported.recordings.axes, 1 / imported.recordings.dt) == (AXES, pytest.approx(500))


def test_a_grid_of_forces_is_no_wrench(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", rate=100, force_0=WRENCH[:, :3], force_1=WRENCH[:, 3:])
    assert read_source(tmp_path).recordings.axes == tuple(f"force_{row}_{k}" for row in range(2) for k in range(3))


def test_labels_in_a_column_each_are_named_with_the_map_that_reads_them(tmp_path: Path) -> None:
    names, which = ("reach", "push", "leave"), np.arange(N) * 3 // N
    rows = np.column_stack([np.arange(N) / 100, WRENCH, np.eye(3)[which]])
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(["t", *AXES, *names]), delimiter=",", comments="")
    [remark] = [text for text in read_source(tmp_path).report.remarks if "look like labels" in text]
    assert remark.startswith("'reach', 'push', 'leave' look like labels")
    for part in ('track = "label", column = "reach"', 'words = {"1" = "reach"}, ignore = ["0"]'):
        assert part in remark
    entries = (
        f'[[annotations]]\ntrack = "label"\ncolumn = "{name}"\nwords = {{"1" = "{name}"}}\nignore = ["0"]\n'
        for name in names
    )
    (tmp_path / "map.toml").write_text("\n".join(entries))
    imported = read_source(tmp_path / "a.csv", mapping=read_mapping(tmp_path / "map.toml"))
    assert imported.recordings.annotations.names().tolist() == list(names)
    np.testing.assert_allclose(imported.recordings.starts("label"), [[0.0, 0.2, 0.4]])
    assert not any("look like labels" in text for text in imported.report.remarks)


def test_flags_that_are_no_labels_are_not_named(tmp_path: Path) -> None:
    rows = np.column_stack([np.arange(N) / 100, WRENCH, np.eye(2)[np.arange(N) % 2], np.arange(N) > 9, np.ones(N)])
    names = ["t", *AXES, "a", "b", "closed", "on"]
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(names), delimiter=",", comments="")
    assert not any("look like labels" in text for text in read_source(tmp_path).report.remarks)
