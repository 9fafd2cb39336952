"""Files of arrays in the layouts that people give them."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.arrays import hdf5_tables
from rcbht_jax.io.importing.importer import read_source
from tests.io.importing.test_readers import AXES, DT, TIME, WRENCH, N, same


def test_hdf5_groups_of_recordings_beside_one_of_splits_need_not_be_alike(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        for number in range(3):
            demo = file.create_group(f"data/demo_{number}")
            demo["obs/ft"], demo.attrs["dt"], demo.attrs["success"] = WRENCH + number, DT, number < 2
            if number:
                demo["rewards"] = np.zeros(N)
        file["mask/train"] = np.array(["demo_0"], "S")
    recordings = read_source(tmp_path / "demos.hdf5").recordings
    assert recordings.trial.tolist() == [f"demos-demo_{number}" for number in range(3)]
    assert recordings.columns["success"].tolist() == [1, 1, 0]
    assert recordings.outcome.tolist() == ["success", "success", "failure"]


def test_npy_of_time_and_axes_and_of_recordings_whose_rows_are_axes(tmp_path: Path) -> None:
    np.save(tmp_path / "run.npy", np.column_stack([TIME, WRENCH]))
    recordings = read_source(tmp_path / "run.npy").recordings
    assert (recordings.dt, len(recordings.axes)) == (DT, 6)
    cube = np.random.default_rng(0).normal(size=(4, 2, 80))
    np.savez(tmp_path / "cube.npz", X=cube, y=[0, 1, 0, 1], dt=DT)
    recordings = read_source(tmp_path / "cube.npz").recordings
    np.testing.assert_allclose(recordings.wrench, cube.swapaxes(1, 2), rtol=1e-6)


@pytest.mark.parametrize(
    ("beside", "shape", "count"),
    [({"time": np.arange(200) * DT}, (200, 6, 10), 10), ({"time": np.arange(200) * DT}, (200, 6, 6), 6),
     ({"rate": 200.0}, (200, 6, 10), 10), ({"rate": 200.0}, (10, 200, 6), 10), ({"rate": 200.0}, (7, 6, 6), 7),
     ({"time": np.arange(6) * DT}, (20, 6, 10), 20), ({"rate": 200.0, "outcome": np.arange(20)}, (20, 8, 10), 20)],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_recordings_may_be_the_last_dimension_of_a_wrench(
    beside: dict[str, Any], shape: tuple[int, ...], count: int, kind: str, tmp_path: Path
) -> None:
    wrench = np.random.default_rng(0).normal(size=shape)
    arrays = {"wrench": wrench, "torque": wrench, **beside}
    np.savez(tmp_path / "run.npz", **arrays) if kind == "npz" else scipy.io.savemat(tmp_path / "run.mat", arrays)
    recordings = read_source(tmp_path).recordings
    whole = wrench if count == shape[0] else np.moveaxis(wrench, 2, 0)
    np.testing.assert_allclose(recordings.wrench[..., :6], whole[..., :6], rtol=1e-6)


def test_matrices_beside_a_time_make_no_recordings(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", time=np.arange(200) * DT, pose=np.random.default_rng(0).normal(size=(200, 4, 4)))
    with pytest.raises(InputError, match="no column of numbers"):
        read_source(tmp_path)


@pytest.mark.parametrize(
    ("beside", "left"),
    [
        ({"a_joints": (3, 50, 7)}, "a_joints"),
        ({"a_image": (3, 8, 9), "b_image": (3, 8, 9)}, "a_image"),
        ({"pose": (3, 4, 4)}, "pose"),
        ({"time": (3,)}, ""),  # of the beginning of each
    ],
)
@pytest.mark.parametrize("name", ["force", "wrench"])
def test_of_arrays_of_recordings_those_of_a_wrench_are_read(
    name: str, beside: dict[str, tuple[int, ...]], left: str, tmp_path: Path
) -> None:
    """The first array was read, and the wrench was left out without a word."""
    random = np.random.default_rng(0)
    wrench = random.normal(size=(3, 100, 6 if name == "wrench" else 3))
    others = {key: random.normal(size=shape) for key, shape in beside.items()}
    np.savez(tmp_path / "a.npz", **others, **{name: wrench}, dt=DT)
    imported = read_source(tmp_path / "a.npz")
    np.testing.assert_allclose(imported.recordings.wrench, wrench, rtol=1e-6)
    assert any(f"left out: {left!r}" in remark for remark in imported.report.remarks) == bool(left)


def test_rows_of_recordings_may_be_axes_beside_another_array(tmp_path: Path) -> None:
    """Each sample was a recording of three."""
    random = np.random.default_rng(0)
    force = random.normal(size=(3, 3, 100))
    np.savez(tmp_path / "a.npz", force=force, image=random.normal(size=(3, 8, 9)), dt=DT)
    np.testing.assert_allclose(read_source(tmp_path / "a.npz").recordings.wrench, force.swapaxes(1, 2), rtol=1e-6)


@pytest.mark.parametrize(
    "beside", [{}, {"gravity": np.arange(3.0)}, {"time": np.arange(80) * DT}, {"class": np.arange(5)}]
)
@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
@pytest.mark.parametrize("count", [3, 6])
def test_an_array_of_forces_lies_as_its_axes_do(
    count: int, axes: tuple[int, int], beside: dict[str, Any], tmp_path: Path
) -> None:
    """Beside a vector in space, samples became axes: 30 samples of three were three of 30 channels."""
    rate = {} if "time" in beside else {"dt": DT}
    name = "force" if count == 3 else "wrench"
    for rows in (30, 80):
        wrench = np.random.default_rng(0).normal(size=(5, rows, count))
        times = {key: array[:rows] for key, array in beside.items()}
        np.savez(tmp_path / "one.npz", **{name: wrench[0].transpose(axes)}, **times, **rate)
        np.testing.assert_allclose(read_source(tmp_path / "one.npz").recordings.wrench, wrench[:1], rtol=1e-6)
        several = wrench.transpose(0, axes[0] + 1, axes[1] + 1)
        np.savez(tmp_path / "five.npz", **{name: several}, **times, **rate)
        np.testing.assert_allclose(read_source(tmp_path / "five.npz").recordings.wrench, wrench, rtol=1e-6)


@pytest.mark.parametrize("head", ["trial", "wrench"])
def test_numbers_of_trials_or_of_forces_separate_recordings_rather_than_others(head: str, tmp_path: Path) -> None:
    """Every trial was in the file five times, and twelve copies were reported."""
    random = np.random.default_rng(0)
    several = {f"{head}_{number}": random.normal(size=(100 - 10 * number, 6)) for number in range(3)}
    others = {f"mask_{number}": random.normal(size=(7 + number, 2)) for number in range(5)}
    np.savez(tmp_path / "a.npz", **others, **several, dt=DT)
    imported = read_source(tmp_path / "a.npz")
    assert imported.recordings.trial.tolist() == ["a-0", "a-1", "a-2"]
    assert imported.report.duplicates == []


def test_an_array_of_recordings_beside_a_wrench_of_one_is_left_out(tmp_path: Path) -> None:
    """Its first two dimensions became recordings, and the wrench was none."""
    np.savez(tmp_path / "a.npz", features=np.random.default_rng(0).normal(size=(3, 50, 7)), wrench=WRENCH, dt=DT)
    np.testing.assert_allclose(read_source(tmp_path / "a.npz").recordings.wrench[0], WRENCH, rtol=1e-6)


def test_hdf5_tables_of_pandas_and_of_records_keep_the_names_of_columns(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    names = ["time", *AXES]
    with h5py.File(tmp_path / "pandas.h5", "w") as file:  # as DataFrame.to_hdf writes it
        frame = file.create_group("runs")
        frame["axis0"], frame["axis1"] = np.array([*names, "trial"], "S"), np.arange(2 * N)
        frame["block0_items"], frame["block1_items"] = np.array(names, "S"), np.array(["trial"], "S")
        frame["block0_values"] = np.tile(np.column_stack([TIME, WRENCH]), (2, 1)) + np.repeat([[0], [0.5]], N, 0)
        frame["block1_values"] = np.repeat([[3], [8]], N, 0)
    imported = read_source(tmp_path / "pandas.h5")
    assert imported.recordings.trial.tolist() == ["pandas-3", "pandas-8"]
    np.testing.assert_allclose(imported.recordings.wrench[1], WRENCH + 0.5, atol=1e-6)
    with h5py.File(tmp_path / "records.h5", "w") as file:
        file["log"] = np.rec.fromarrays([TIME, *WRENCH.T], names=names)
    same(read_source(tmp_path / "records.h5"))


def numbered(kind: str, path: Path) -> None:
    """A file of three recordings of different lengths, as people number them."""
    parts = {k: (TIME[: N - 5 * k], WRENCH[: N - 5 * k] + k) for k in range(3)}
    if kind == "npz":
        np.savez(
            path, **{f"trial_{k}/{key}": one for k in parts for key, one in zip(("t", "ft"), parts[k], strict=True)}
        )
    elif kind == "npz bare":
        np.savez(path, dt=DT, **{f"x{k}": wrench for k, (_, wrench) in parts.items()})
    elif kind == "matlab structures":
        rows = np.zeros(3, [("time", "O"), ("ft", "O"), ("result", "O")])
        for k, (time, wrench) in parts.items():
            rows[k] = time, wrench, f"r{k}"
        scipy.io.savemat(path, {"demos": rows})
    elif kind == "matlab cells":
        cells = np.empty((2, 3), object)
        for k, (_, wrench) in parts.items():
            cells[:, k] = wrench, f"r{k}"
        scipy.io.savemat(path, {"ft": cells[0], "result": cells[1], "Ts": DT})
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w", userblock_size=512) as file:
            demos = file.create_group("demos")
            demos.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in ("time", "ft", "result"):
                rows = []
                for k, (time, wrench) in parts.items():
                    text = np.array([[ord(letter)] for letter in f"r{k}"], np.uint16)
                    one = file.create_dataset(
                        f"#refs#/{key}{k}", data={"time": time[None], "ft": wrench.T}.get(key, text)
                    )
                    one.attrs["MATLAB_class"] = np.bytes_("char" if key == "result" else "double")
                    rows.append(one.ref)
                demos.create_dataset(key, data=np.array(rows, object)[:, None], dtype=h5py.ref_dtype)
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("kind", ["npz", "npz bare", "matlab structures", "matlab cells", "matlab 7.3"])
def test_arrays_that_are_numbered_are_recordings(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("a.npz" if kind.startswith("npz") else "a.mat")
    numbered(kind, path)
    recordings = read_source(path).recordings
    assert recordings.trial.tolist() == ["a-0", "a-1", "a-2"]
    assert recordings.length.tolist() == [N, N - 5, N - 10]
    np.testing.assert_allclose(recordings.wrench[2, : N - 10], WRENCH[: N - 10] + 2, atol=1e-6)
    if "matlab" in kind:
        assert recordings.columns["result"].tolist() == ["r0", "r1", "r2"]


def test_arrays_that_number_columns_are_one_recording_and_a_broken_one_leaves_the_others(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, **{f"joint{k}.torque": WRENCH[:, k] for k in range(3)})
    assert len(read_source(tmp_path / "a.npz").recordings) == 1
    np.savez(tmp_path / "b.npz", dt=DT, trial_0=WRENCH, trial_1=np.zeros((0, 6)), trial_2=WRENCH + 1)
    imported = read_source(tmp_path / "b.npz")
    assert (imported.report.imported, len(imported.report.skipped)) == (["b.npz#0", "b.npz#2"], 1)


def test_rows_without_any_value_at_the_end_are_padding(tmp_path: Path) -> None:
    cube = np.random.default_rng(0).normal(size=(3, 80, 2))
    cube[1, 50:], cube[2, 60:] = np.nan, 0
    np.savez(tmp_path / "a.npz", x=cube, dt=DT)
    imported = read_source(tmp_path)
    assert imported.recordings.length.tolist() == [80, 50, 80]
    assert imported.recordings.note.tolist() == ["", "padded:30", "zeros:20"]
    np.savez(tmp_path / "a.npz", x=cube, dt=DT, lengths=[80, 50, 60])
    assert read_source(tmp_path).recordings.length.tolist() == [80, 50, 60]


@pytest.mark.parametrize("units", ["N, N, N, Nmm, Nmm, Nmm", ["N", "N", "N", "N mm", "N mm", "N mm"]])
def test_hdf5_units_of_an_attribute(units: str | list[str], tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["stamps"], file["wrench"], file["speed"] = np.arange(N) * DT * 1000, WRENCH, TIME
        for name, attribute, unit in (
            ("stamps", "unit", "ms"),
            ("wrench", "units", units),
            ("speed", "unit", "furlong"),
        ):
            file[name].attrs[attribute] = unit
    recordings = read_source(tmp_path / "run.h5").recordings
    assert recordings.units == ("N", "N", "N", "Nmm", "Nmm", "Nmm")
    assert recordings.dt == pytest.approx(DT)


def test_hdf5_groups_of_many_recordings_are_read_in_linear_time(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    spent = []
    for count in (25, 200):
        with h5py.File(tmp_path / "demos.hdf5", "w") as file:
            for number in range(count):
                for key in ("force", "obs/joints", "obs/pose", "obs/gripper", "obs/image", "actions"):
                    file[f"data/demo_{number}/{key}"] = np.zeros((9, 3))
        start = time.process_time()
        tables = list(hdf5_tables(tmp_path / "demos.hdf5", "demos.hdf5"))
        spent.append(time.process_time() - start)
        assert [table.columns["obs/pose_2"].shape for table in tables] == [(9,)] * count
    assert spent[1] < 16 * spent[0]  # of 8


@pytest.mark.parametrize("segments", [1, 2, 3])
def test_hdf5_groups_of_segments_are_no_recordings(segments: int, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["wrench"] = TIME, WRENCH
        for number in range(segments):
            for key, value in {"start": number / 10, "end": number / 10 + 0.05, "label": "abc"[number]}.items():
                file[f"segments/{number}/{key}"] = value
    recordings = read_source(tmp_path).recordings
    assert len(recordings) == 1
    assert recordings.annotations.names().tolist() == list("abc")[:segments]


def test_recordings_of_one_file_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    numbers = range(1, 12)
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        for number in numbers:
            demo = file.create_group(f"data/demo_{number}")
            demo["obs/ft"], demo.attrs["dt"] = WRENCH + number, DT
    rows = [f"run_{k},{t},{t + k},{t},{t}" for k in numbers for t in TIME.tolist()]
    (tmp_path / "runs.csv").write_text("\n".join(["run,t,Fx,Fy,Fz", *rows]))
    arms = [f"robot{k}_f{axis}" for k in numbers for axis in "xyz"]
    rows = [",".join([str(t), *(str(k + t) for k, _ in enumerate(arms))]) for t in TIME.tolist()]
    (tmp_path / "arms.csv").write_text("\n".join([",".join(["t", *arms]), *rows]))
    for file, word in {"demos.hdf5": "demo_", "runs.csv": "run_", "arms.csv": "robot"}.items():
        assert read_source(tmp_path / file).report.imported == [f"{file}#{word}{number}" for number in numbers]


def test_what_stands_beside_hdf5_groups_is_of_all(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["operator"], file["splits/train"] = TIME, "ann", [0, 1]
        for number in range(2):
            file[f"trial_{number}/force"] = WRENCH[:, :3] * (number + 1)
    recordings = read_source(tmp_path / "run.h5").recordings
    assert recordings.dt == pytest.approx(DT)
    assert recordings.columns["operator"].tolist() == ["ann", "ann"]
    np.testing.assert_allclose(recordings.wrench[1], 2 * WRENCH[:, :3], rtol=1e-6)


@pytest.mark.parametrize("groups", [("cam0", "cam1"), ("left", "right"), ("pose", "joints")])
def test_hdf5_groups_beside_a_wrench_are_no_recordings(groups: tuple[str, str], tmp_path: Path) -> None:
    """The wrench was lost, and each group was a recording of the time beside it."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["wrench"] = TIME, WRENCH
        for number, group in enumerate(groups):
            file[f"{group}/values"] = np.random.default_rng(number).normal(size=(len(TIME), 4))
    np.testing.assert_allclose(read_source(tmp_path / "run.h5").recordings.wrench[0], WRENCH, rtol=1e-6)


@pytest.mark.parametrize("kind", ["npz", "mat", "h5", "zarr"])
def test_groups_with_a_wrench_and_times_of_their_own_are_recordings_in_every_format(kind: str, tmp_path: Path) -> None:
    path, runs = tmp_path / f"a.{kind}", {"remove": WRENCH, "insert": WRENCH[:-5]}
    arrays = {f"{name}/{key}": one for name, run in runs.items() for key, one in (("t", TIME[: len(run)]), ("ft", run))}
    if kind == "npz":
        np.savez(path, **arrays)
    elif kind == "mat":
        scipy.io.savemat(path, {name: {"t": TIME[: len(run)], "ft": run} for name, run in runs.items()})
    elif kind == "h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            for key, one in arrays.items():
                file[key] = one
    else:
        group = pytest.importorskip("zarr").open_group(path, mode="w")
        for key, one in arrays.items():
            group.create_array(key, data=one)
    imported = read_source(path)
    assert imported.recordings.trial.tolist() == ["a-insert", "a-remove"]
    assert imported.recordings.length.tolist() == [N - 5, N]
    assert imported.report.warnings == []


def test_groups_of_what_was_done_to_a_wrench_are_one_recording(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        for name, force in {"raw": WRENCH - 9, "compensated": WRENCH}.items():
            file[f"{name}/t"], file[f"{name}/ft"] = TIME, force
    recordings = read_source(tmp_path / "a.h5").recordings
    np.testing.assert_array_equal(recordings.wrench, WRENCH[None].astype(np.float32))


def test_arms_of_other_lengths_are_both_imported(tmp_path: Path) -> None:
    arrays = {"left/t": TIME, "left/ft": WRENCH, "right/t": TIME[:-5], "right/ft": WRENCH[:-5]}
    np.savez(tmp_path / "a.npz", **arrays)
    recordings = read_source(tmp_path / "a.npz").recordings
    assert (recordings.arm.tolist(), recordings.length.tolist()) == (["left", "right"], [N, N - 5])


def test_hdf5_with_dimensions_as_xarray_writes_them_is_read(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        for name, values in {"time": TIME, "axis": np.array(AXES, "S"), "wrench": WRENCH}.items():
            file[name] = values
        for number, name in enumerate(("time", "axis")):
            file[name].make_scale(name)
            file["wrench"].dims[number].attach_scale(file[name])
    same(read_source(tmp_path / "a.h5"))


@pytest.mark.parametrize("other", ["torque", "position"])
@pytest.mark.parametrize("kind", ["h5", "json"])
def test_groups_of_quantities_are_no_recordings(kind: str, other: str, tmp_path: Path) -> None:
    wrench = np.tile(WRENCH, (9, 1))  # a short list in JSON may be a vector
    time = np.arange(len(wrench)) * DT
    groups = {name: dict(zip("xyz", wrench.T[first:], strict=False)) for name, first in (("force", 0), (other, 3))}
    if kind == "h5":
        with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
            file["time"] = time
            for name, axes in groups.items():
                for axis, values in axes.items():
                    file[f"{name}/{axis}"] = values
    else:
        lists = {name: {axis: values.tolist() for axis, values in axes.items()} for name, axes in groups.items()}
        (tmp_path / "a.json").write_text(json.dumps({"time": time.tolist(), **lists}))
    recordings = read_source(tmp_path / f"a.{kind}").recordings
    assert recordings.axes == AXES[: 6 if other == "torque" else 3]
    np.testing.assert_array_equal(recordings.wrench[0], wrench[:, : len(recordings.axes)].astype(np.float32))


def test_a_list_of_units_among_the_attributes_of_a_group_is_understood(tmp_path: Path) -> None:
    units = ["N", "N", "N", "Nmm", "Nmm", "Nmm"]
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        file["t"], file["wrench"], file.attrs["units"] = TIME, WRENCH, units
    assert read_source(tmp_path / "a.h5").recordings.units == tuple(units)


def test_groups_of_sensors_within_a_recording_stay_in_it(tmp_path: Path) -> None:
    arrays = {f"trial_{k}/{name}/t": TIME for k in range(2) for name in ("wrist", "base")}
    arrays |= {f"trial_{k}/{name}/ft": WRENCH + k for k in range(2) for name in ("wrist", "base")}
    np.savez(tmp_path / "a.npz", **arrays)
    assert len(read_source(tmp_path / "a.npz").recordings) == 2
