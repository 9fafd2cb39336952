"""Files as tools export messages and arrays: the wrench, its time, and how many recordings there are."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import matlab
from rcbht_jax.io.importing.importer import read_source

N = 40
TIME = np.arange(N) * 0.01
WRENCH = np.random.default_rng(0).normal(size=(N, 6)).round(3)
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def message(topic: str, number: int, data: dict[str, object]) -> str:
    stamp = {"sec": 1650000000, "nsec": number * 10_000_000}
    return json.dumps({"topic": topic, "sequence": number, "data": {"header": {"stamp": stamp}, **data}})


def test_messages_of_mcap_as_json_are_one_recording(tmp_path: Path) -> None:
    lines = []
    for number, row in enumerate(WRENCH.tolist()):
        force, torque = (dict(zip("xyz", part, strict=True)) for part in (row[:3], row[3:]))
        lines += [message("/ft", number, {"wrench": {"force": force, "torque": torque}})]
        lines += [message("/joints", number, {"position": [0.1, 0.2]})] if number % 2 else []
    (tmp_path / "run.jsonl").write_text("\n".join(lines))
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.recordings.note.tolist()) == (AXES, [f"padded:1;between:{N // 2 - 1}"])
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH, rtol=1e-6)
    assert {row["role"] for row in imported.report.understood if row["column"] == "topic"} == {"left out"}


@pytest.mark.parametrize("lengths", [(N, N, N), (N, N - 3, N - 1)])
@pytest.mark.parametrize("form", ["run{}_{}", "logs/run{}/{}", "trial_{}_{}", "demo-{}-{}"])
def test_arrays_that_begin_with_the_number_of_a_recording(form: str, lengths: tuple[int, ...], tmp_path: Path) -> None:
    arrays = {}
    for number, length in enumerate(lengths):
        arrays |= {form.format(number, "time"): TIME[:length], form.format(number, "wrench"): number + WRENCH[:length]}
    np.savez(tmp_path / "all.npz", **arrays)  # type: ignore[arg-type]  # its stub takes no names
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, tuple(recordings.length.tolist())) == (AXES, lengths)
    np.testing.assert_allclose(recordings.wrench[2, : lengths[2]], 2 + WRENCH[: lengths[2]], rtol=1e-5)


def test_an_empty_column_that_is_called_like_a_time_is_none(tmp_path: Path) -> None:
    rows = [f",{k},,1650000000,{10_000_000 * k},{row[0]},{row[2]}" for k, row in enumerate(WRENCH)]
    (tmp_path / "run.csv").write_text("\n".join(["header,seq,stamp,secs,nsecs,fx,fz", *rows]))
    imported = read_source(tmp_path)
    assert (imported.mapping.time, imported.recordings.dt) == ("secs", 0.01)


def table(path: Path, head: str, cells: dict[tuple[int, int], str] | None = None, time: str = "time") -> None:
    """A CSV of the wrench with that head, and other words in some cells ``(row, column)``."""
    rows = [[f"{t:.2f}", *map(str, row)] for t, row in zip(TIME.tolist(), WRENCH.tolist(), strict=True)]
    for (row, column), word in (cells or {}).items():
        rows[row][column] = word
    path.write_text("\n".join([f"{time},{head}", *map(",".join, rows)]))


@pytest.mark.parametrize(
    "word", ["ERR", "Error", "OVF", "#DIV/0!", "-nan(ind)", "1.#QNAN", "---", "None", "inf", "-Inf"]
)
def test_words_for_missing_numbers_are_counted_and_quoted(word: str, tmp_path: Path) -> None:
    table(tmp_path / "run.csv", ",".join(AXES), {(7, 3): word, (20, 1): word})
    imported = read_source(tmp_path)
    assert imported.recordings.note.tolist() == ["missing:2"]
    assert f"Words in columns of numbers were read as missing values: {word!r}." in imported.report.remarks
    np.testing.assert_allclose(imported.recordings.wrench[0, 8:20], WRENCH[8:20], rtol=1e-6)


def test_the_same_words_stay_labels_in_a_column_of_text(tmp_path: Path) -> None:
    rows = [
        f"{t},{row[0]},{'push' if k < 20 else 'error'}" for k, (t, row) in enumerate(zip(TIME, WRENCH, strict=True))
    ]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz,phase", *rows]))
    assert read_source(tmp_path).recordings.annotations.labels == {"phase": ("push", "error")}


def test_units_of_axes_in_small_letters(tmp_path: Path) -> None:
    table(tmp_path / "run.csv", "force_x_n,force_y_n,force_z_n,torque_x_nm,torque_y_nm,torque_z_nm")
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.mapping.units) == (AXES, ("N",) * 3 + ("Nm",) * 3)


@pytest.mark.parametrize("line", ["Units: N, Nm", "# units = [N, Nm]", "Units:\tN; Nm", "Unit: N/Nm"])
def test_a_line_of_both_units_before_the_names(line: str, tmp_path: Path) -> None:
    head = [line] if line.startswith("#") else ["Sensor: A", line, ""]
    rows = ["\t".join([f"{t:.2f}", *map(str, row)]) for t, row in zip(TIME.tolist(), WRENCH.tolist(), strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([*head, "\t".join(("time", *AXES)), *rows]))
    assert read_source(tmp_path).mapping.units == ("N",) * 3 + ("Nm",) * 3


@pytest.mark.parametrize("head", ["", "sec,nanosec,frame_id,a,b,c,d,e,f\n"])
def test_channels_without_names_are_to_be_named(head: str, tmp_path: Path) -> None:
    rows = [",".join(["1650000000", f"{10_000_000 * k + 3}", "ft", *map(str, row)]) for k, row in enumerate(WRENCH)]
    (tmp_path / "run.csv").write_text(head + "\n".join(rows))
    remarks = read_source(tmp_path).report.remarks
    assert any(remark.startswith("Columns have no names") for remark in remarks) == (not head)


@pytest.mark.parametrize(
    ("folders", "stated"),
    [(("success", "fail"), 'folder = 1 and words = {"fail" = "failure", "success" = "success"}.'),
     (("day1/OK", "day2/NOK"), 'folder = 2 and words = {"NOK" = "failure", "OK" = "success"}.'),
     (("day1", "day2"), "")],
)  # fmt: skip
def test_folders_that_may_be_outcomes_are_named(folders: tuple[str, ...], stated: str, tmp_path: Path) -> None:
    for number, folder in enumerate(folders):
        (tmp_path / folder).mkdir(parents=True)
        table(tmp_path / folder / "run.csv", ",".join(AXES), {(0, 1): str(number)})
    imported = read_source(tmp_path)
    assert imported.recordings.outcome.tolist() == ["unknown", "unknown"]
    found = [remark for remark in imported.report.remarks if "may be outcomes" in remark]
    assert [remark.endswith(stated) for remark in found] == [True] * bool(stated)


def test_a_time_without_samples_is_said(tmp_path: Path) -> None:
    table(tmp_path / "run.csv", ",".join(AXES), {(k, 0): f"{2 + 0.01 * k:.2f}" for k in range(20, N)})
    imported = read_source(tmp_path)
    assert imported.recordings.note.tolist() == ["gap:2.01;uneven"]
    assert any("the longest of 2.01 s; straight lines stand there" in one for one in imported.report.remarks)


def test_a_clock_that_was_set_back_is_to_be_replaced(tmp_path: Path) -> None:
    table(tmp_path / "run.csv", ",".join(AXES), {(k, 0): f"{0.01 * k - 0.1:.2f}" for k in range(20, N)})
    with pytest.raises(InputError, match="if its clock was set back, give --source-rate"):
        read_source(tmp_path)


def test_the_variables_of_a_timetable_are_its_wrench(tmp_path: Path) -> None:
    savemat(tmp_path / "run.mat", {"ft": {"Time": TIME[:, None], "Variables": WRENCH}})
    assert read_source(tmp_path).recordings.axes == AXES


def opaque(name: str, kind: str) -> bytes:
    """A variable of a MATLAB file of version 5 that is an object of a class."""

    def element(code: int, data: bytes) -> bytes:
        return struct.pack("<II", code, len(data)) + data + b"\0" * (-len(data) % 8)

    handle = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    handle = element(14, handle + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    texts = b"".join(element(1, text.encode()) for text in (name, "MCOS", kind))
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + handle)


def objects(path: Path, version: str, beside: bool) -> None:
    """A timetable, perhaps beside arrays."""
    arrays = {"t": TIME[:, None], "wrench": WRENCH} if beside else {}
    if version == "5":
        savemat(path, arrays, do_compression=False)
        with path.open("ab") as file:
            file.write(opaque("ft", "timetable"))
        return
    with h5py.File(path, "w", userblock_size=512) as content:
        for name, array in arrays.items():
            content[name] = array.T
        content["ft"] = np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32)
        content["ft"].attrs["MATLAB_class"] = np.bytes_("timetable")
        content["ft"].attrs["MATLAB_object_decode"] = np.int32(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_timetables_of_matlab_are_to_be_saved_as_structures(version: str, tmp_path: Path) -> None:
    objects(tmp_path / "run.mat", version, beside=False)
    with pytest.raises(InputError, match=r"objects of MATLAB, which are not read: ft \(timetable\); save numbers in a"):
        read_source(tmp_path)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_objects_of_matlab_beside_arrays_are_named(version: str, tmp_path: Path) -> None:
    objects(tmp_path / "run.mat", version, beside=True)
    imported = read_source(tmp_path)
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH, rtol=1e-6)
    assert "Arrays of another shape or kind were left out: 'ft (timetable)'." in imported.report.remarks


def test_objects_of_matlab_as_newer_versions_of_scipy_show_them() -> None:
    fields = [("_TypeSystem", object), ("_Class", object), ("_ObjectMetadata", object)]  # from scipy 1.18 on
    found: dict[str, Any] = {}
    matlab._flatten("ft", np.array([("MCOS", "timetable", np.zeros((6, 1), np.uint32))], fields), found)
    assert list(found) == ["ft (timetable)"]
    assert found["ft (timetable)"].dtype == object


def test_attributes_of_the_group_around_recordings_describe_them(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        data = file.create_group("data")
        data.attrs["fs"], data.attrs["operator"] = 100.0, "Ann"
        for number in range(2):
            data[f"demo_{number}/obs/ee_force"] = WRENCH + number
    recordings = read_source(tmp_path).recordings
    assert (recordings.dt, recordings.column("operator").tolist()) == (0.01, ["Ann", "Ann"])
