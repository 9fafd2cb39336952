"""Files as tools and laboratories write them: what the store holds is what was measured."""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import zarr

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import Imported, read_source

N = 40
TIME = np.arange(N) * 0.01
WRENCH = np.random.default_rng(0).normal(size=(N, 6)).round(3) * 100
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N",) * 3 + ("Nm",) * 3
START = datetime.datetime(2026, 5, 1, 23, 59, 59)


def write(path: Path, times: list[str] | None = None, heads: tuple[str, ...] = AXES, step: int = 1) -> None:
    times = [f"{time:.2f}" for time in TIME] if times is None else times
    rows = [",".join([time, *(f"{value:.6g}" for value in row)]) for time, row in zip(times, WRENCH, strict=True)]
    path.write_text("\n".join([",".join(("time", *heads)), *rows[::step]]) + "\n")


def same(imported: Imported, note: str = "", units: tuple[str, ...] = ("",) * 6) -> None:
    recordings = imported.recordings
    assert (recordings.axes, recordings.note.tolist(), imported.mapping.units) == (AXES, [note], units)
    assert recordings.dt == pytest.approx(0.01, rel=1e-9)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, rtol=1e-5)


@pytest.mark.parametrize(
    "form",
    ["%Y%m%dT%H%M%S.%f", "%Y-%m-%d_%H-%M-%S.%f", "%Y-%m-%d %H-%M-%S.%f", "%Y/%m/%d/%H:%M:%S.%f", "%Y.%m.%d %H:%M:%S.%f",
     "%Y%m%d_%H%M%S.%fZ"],
)  # fmt: skip
def test_dates_as_programs_write_them(form: str, tmp_path: Path) -> None:
    write(tmp_path / "run.csv", [(START + datetime.timedelta(seconds=time)).strftime(form) for time in 4 * TIME])
    recordings = read_source(tmp_path).recordings
    assert recordings.dt == pytest.approx(0.04)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, rtol=1e-5)


def test_the_name_of_a_zone_is_no_part_of_the_time(tmp_path: Path) -> None:
    write(
        tmp_path / "run.csv", [f"{(START + datetime.timedelta(seconds=time))!s:0<23.23} UTC" for time in TIME + 0.001]
    )
    same(read_source(tmp_path))


@pytest.mark.parametrize("form", ["{:.2f} sec", "{:.2f} s", "{:.2f}s"])
def test_durations_with_their_unit_in_each_cell(form: str, tmp_path: Path) -> None:
    write(tmp_path / "run.csv", [form.format(time) for time in TIME])
    same(read_source(tmp_path))


@pytest.mark.parametrize("text", [False, True])
def test_what_is_exported_newest_first_is_turned(text: bool, tmp_path: Path) -> None:
    stamps = [(START + datetime.timedelta(seconds=time)).isoformat(timespec="milliseconds") for time in TIME]
    write(tmp_path / "run.csv", stamps if text else None, step=-1)
    same(read_source(tmp_path), "reversed")


def test_the_unit_of_stamps_that_come_newest_first_follows_from_their_steps(tmp_path: Path) -> None:
    rows = [f"{trial},{10 * k},{k % 7 + trial}" for trial in range(2) for k in reversed(range(N))]
    (tmp_path / "run.csv").write_text("\n".join(["trial,time,load", *rows]))
    recordings = read_source(tmp_path).recordings
    assert (recordings.dt, recordings.note.tolist()) == (0.01, ["reversed", "reversed"])
    np.testing.assert_array_equal(recordings.wrench[1, :, 0], np.arange(N) % 7 + 1)


LABELS = [("push", 0.1, 0.2), ("pull", 0.2, 0.35)]


def labelled(tmp_path: Path, rows: str, times: list[str] | None = None) -> None:
    write(tmp_path / "run.csv", times)
    (tmp_path / "run_labels.csv").write_text(rows)
    imported = read_source(tmp_path)
    annotations = imported.recordings.annotations
    found = zip(annotations.names().tolist(), annotations.start, annotations.end, strict=True)
    assert [(name, round(start, 6), round(end, 6)) for name, start, end in found] == LABELS
    assert imported.report.warnings == imported.report.skipped == []


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ("label,start,end\n", "{0},00:00:{1:06.3f},00:00:{2:06.3f}\n"),
        ("label,start,end\n", "{0},2026-05-01T23:59:59.{3:03},2026-05-01T23:59:59.{4:03}\n"),
        ("label,start,end\n", "{0},2026-05-01T21:59:59.{3:03}-02:00,2026-05-01T21:59:59.{4:03}-02:00\n"),
        ("Tier,Begin Time - ss.msec,End Time - ss.msec,Annotation\n", "phase,{1},{2},{0}\n"),
        ("Tier,Begin Time - msec,End Time - msec,Annotation\n", "phase,{3},{4},{0}\n"),
        ("Tier,Begin Time - hh:mm:ss.ms,End Time - hh:mm:ss.ms,Annotation\n",
         "phase,00:00:{1:06.3f},00:00:{2:06.3f},{0}\n"),
        ("", "{1}\t{2}\t{0}\n"),
    ],
)  # fmt: skip
def test_times_of_annotations_as_programs_write_them(head: str, form: str, tmp_path: Path) -> None:
    rows = "".join(form.format(*row, round(row[1] * 1000), round(row[2] * 1000)) for row in LABELS)
    stamps = [(START + datetime.timedelta(seconds=time)).isoformat(timespec="milliseconds") for time in TIME]
    labelled(tmp_path, head + rows, stamps)


def test_annotations_in_nanoseconds_since_1970(tmp_path: Path) -> None:
    def stamp(seconds: float) -> str:
        return str(1_700_000_000_000_000_000 + round(seconds * 1e9))

    rows = "".join(f"{label},{stamp(start)},{stamp(end)}\n" for label, start, end in LABELS)
    labelled(tmp_path, "label,start,end\n" + rows, [stamp(time) for time in TIME.tolist()])


@pytest.mark.parametrize("kind", ["hdf5", "zarr"])
def test_whole_numbers_are_scaled_as_attributes_state(kind: str, tmp_path: Path) -> None:
    packed = np.round((WRENCH - 0.5) * 1000).astype(np.int32)
    attributes = {"scale_factor": 0.001, "add_offset": 0.5, "_FillValue": -(2**31)}
    file = h5py.File(tmp_path / "run.h5", "w") if kind == "hdf5" else zarr.open_group(tmp_path / "run.zarr", mode="w")
    for number, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        file[axis] = packed[:, number]
        file[axis].attrs.update({**attributes, "units": unit})
    file["time"] = np.round(TIME * 1000).astype(np.int32)
    file["time"].attrs["units"] = "milliseconds since 2026-05-01 00:00:00"
    if isinstance(file, h5py.File):
        file.close()
    same(read_source(tmp_path), units=UNITS)


def test_the_unit_of_a_whole_wrench_is_not_that_of_its_moments(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["wrench"] = TIME, WRENCH
        file["wrench"].attrs["units"] = "N"
    same(read_source(tmp_path), units=("N",) * 3 + ("",) * 3)


@pytest.mark.parametrize("units", ["N, Nm", ["N", "Nm"], "N,N,N,Nm,Nm,Nm"])
@pytest.mark.parametrize("key", ["units", "Unit"])
def test_two_units_of_a_whole_wrench_are_of_its_forces_and_moments(key: str, units: Any, tmp_path: Path) -> None:
    """Fx was in N, and no unit was known of the other axes."""
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["wrench"] = TIME, WRENCH
        file["wrench"].attrs[key] = units
    same(read_source(tmp_path), units=("N",) * 3 + ("Nm",) * 3)


@pytest.mark.parametrize("form", ["('{}', '{}')", "/'{}'/'{}'"])
def test_names_of_several_levels_in_parquet(form: str, tmp_path: Path) -> None:
    names = [form.format(word, axis) for word in ("force", "torque") for axis in "xyz"]
    columns = {name: WRENCH[:, number] for number, name in enumerate(names)}
    pq.write_table(pa.table({"time": TIME, **columns}), tmp_path / "run.parquet")
    same(read_source(tmp_path))


def test_decimals_of_databases_are_numbers(tmp_path: Path) -> None:
    columns = {axis: pa.array(WRENCH[:, number]).cast(pa.decimal128(12, 4)) for number, axis in enumerate(AXES)}
    pq.write_table(pa.table({"time": pa.array(TIME).cast(pa.decimal128(12, 4)), **columns}), tmp_path / "run.parquet")
    same(read_source(tmp_path))


@pytest.mark.parametrize("form", ["{} {{{}}}", "{} <{}>", "{}（{}）", "{}【{}】"])
@pytest.mark.parametrize("product", ["Nm", "N*m", "N・m", "N⋅m"])
def test_units_in_other_brackets(form: str, product: str, tmp_path: Path) -> None:
    heads = (form.format(axis, "N" if axis[0] == "F" else product) for axis in AXES)
    write(tmp_path / "run.csv", heads=tuple(heads))
    same(read_source(tmp_path), units=UNITS)


@pytest.mark.parametrize("words", ["ms", "msec", "毫秒", "ミリ秒"])
def test_units_of_time_in_other_words(words: str, tmp_path: Path) -> None:
    rows = "".join(f"{10 * k},{k % 7}\n" for k in range(N))
    (tmp_path / "run.csv").write_text(f"A [{words}],load\n{rows}")
    assert read_source(tmp_path).recordings.dt == pytest.approx(0.01)


@pytest.mark.parametrize("save", [np.savez, lambda path, **arrays: scipy.io.savemat(path.with_suffix(".mat"), arrays)])
@pytest.mark.parametrize("turned", [False, True])
def test_a_list_of_names_beside_a_table_names_its_columns(
    save: Callable[..., None], turned: bool, tmp_path: Path
) -> None:
    table = np.column_stack([TIME, WRENCH])
    names = np.array(["time", *AXES], np.str_ if save is np.savez else object)
    save(tmp_path / "run.npz", data=table.T if turned else table, columns=names)
    same(read_source(tmp_path))


def test_an_attribute_names_the_columns_of_a_table(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["data"] = np.column_stack([TIME, WRENCH])
        file["data"].attrs["columns"] = ["time", *AXES]
    same(read_source(tmp_path))


def test_names_of_columns_beside_an_array_of_recordings(tmp_path: Path) -> None:
    both = np.stack([np.column_stack([TIME, WRENCH]), np.column_stack([TIME, -WRENCH])])
    np.savez(tmp_path / "run.npz", data=both, names=np.array(["time", *AXES]), label=np.array(["a", "b"]))
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.mapping.time) == (AXES, "time")
    np.testing.assert_allclose(imported.recordings.wrench[1], -WRENCH, rtol=1e-5)
    assert imported.recordings.columns["label"].tolist() == ["a", "b"]


@pytest.mark.parametrize("kind", ["datetime64[ms]", "timedelta64[us]"])
def test_times_of_numpy_are_times(kind: str, tmp_path: Path) -> None:
    steps = np.round(TIME * 1000).astype("timedelta64[ms]")
    stamps = np.datetime64(START) + steps if kind.startswith("date") else steps
    np.savez(tmp_path / "run.npz", timestamp_ns=stamps.astype(kind), wrench=WRENCH)
    imported = read_source(tmp_path)
    same(imported)
    assert imported.mapping.time_unit == "s"


def test_python_objects_beside_arrays_are_left_out_and_told(tmp_path: Path) -> None:
    arrays = {"time": TIME, "wrench": WRENCH}
    np.savez(tmp_path / "run.npz", **arrays, meta=np.array({"robot": "A"}, object))  # type: ignore[arg-type]
    imported = read_source(tmp_path)
    same(imported)
    assert imported.report.remarks[0] == "Arrays of another shape or kind were left out: 'meta'."
    np.savez(tmp_path / "run.npz", wrench=np.array([WRENCH, WRENCH[:9]], object))
    with pytest.raises(InputError, match="Python objects, which are never loaded"):
        read_source(tmp_path)
    np.savez(tmp_path / "run.npz", wrench=np.array([WRENCH, WRENCH[:9]], object), labels=np.array([0, 1, 0]))
    with pytest.raises(InputError, match=r"it has 'labels'\. Arrays of another shape .* left out: 'wrench'\."):
        read_source(tmp_path)


def test_a_note_of_the_file_makes_no_notes_of_the_import(tmp_path: Path) -> None:
    """What followed a semicolon was counted as a note of its own, here as a gap."""
    lines = [f"{time},{row[0]},slipped;gap:9" for time, row in zip(TIME, WRENCH, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz,note", *lines]))
    assert read_source(tmp_path).recordings.note.tolist() == ["slipped,gap:9"]


@pytest.mark.parametrize(
    "rate",
    [{"sampling_rate_hz": 100}, {"samplingRate": 100}, {"rate_kHz": 0.1}, {"dt_ms": 10}, {"config": {"dt": 0.01}}],
)
def test_a_document_states_units_and_the_rate(rate: dict[str, object], tmp_path: Path) -> None:
    columns = {axis: WRENCH[:, number].tolist() for number, axis in enumerate(AXES)}
    document = {**rate, "units": dict(zip(AXES, UNITS, strict=True)), "data": columns}
    (tmp_path / "run.json").write_text(json.dumps(document))
    imported = read_source(tmp_path)
    same(imported, units=UNITS)
    assert not imported.recordings.columns


@pytest.mark.parametrize(
    "line",
    ["Sampling rate: 0.1 kHz", "Sample Rate (kHz),0.1", "Abtastrate;100,0 Hz", "# sampling_rate_hz: 100", "dt = 10 ms",
     "Sample Interval [ms];10"],
)  # fmt: skip
def test_rates_in_other_units(line: str, tmp_path: Path) -> None:
    rows = "".join(f"{k % 7},{k % 5},{k % 3}\n" for k in range(N))
    (tmp_path / "run.csv").write_text(f"{line}\nload,grip,spin\n{rows}")
    assert read_source(tmp_path).recordings.dt == pytest.approx(0.01)


def test_what_is_one_number_in_every_recording_describes_it_and_is_no_channel(tmp_path: Path) -> None:
    for number in range(2):
        rows = "".join(f"{k / 100},3,{number},{k % (7 + number)},0,0,{number * (k % 2)}\n" for k in range(N))
        (tmp_path / f"run{number}.csv").write_text(f"t,operator_id,peg,load,grip [N],Fz,spin\n{rows}")
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert recordings.axes == ("load", "grip", "Fz", "spin")  # a sensor may be at rest
    assert {name: values.tolist() for name, values in recordings.columns.items()} == {
        "operator_id": ["3", "3"], "peg": ["0", "1"]
    }  # fmt: skip
    roles = {row["column"]: row["role"] for row in imported.report.understood}
    assert (roles["operator_id"], roles["peg"], roles["spin"]) == ("column operator_id", "column peg", "channel spin")
    assert [channel.column for channel in imported.mapping.channels] == ["load", "grip [N]", "Fz", "spin"]


def test_a_series_of_each_channel_in_long_form(tmp_path: Path) -> None:
    stamps = [(START + datetime.timedelta(seconds=time)).isoformat(timespec="milliseconds") for time in TIME]
    rows = [
        f",_result,{number},{stamp}Z,{value},{axis}"
        for number, axis in enumerate(AXES)
        for stamp, value in zip(stamps, WRENCH[:, number].tolist(), strict=True)
    ]
    head = ["#datatype,string,long,dateTime:RFC3339,double,string", ",result,table,_time,_value,_field"]
    (tmp_path / "run.csv").write_text("\n".join([*head, *rows]) + "\n")
    same(read_source(tmp_path))


@pytest.mark.parametrize("short", [False, True])
def test_annotations_of_label_studio(short: bool, tmp_path: Path) -> None:
    write(tmp_path / "run1.csv")
    write(tmp_path / "run2.csv", heads=("Fy", "Fx", *AXES[2:]))
    marks = [{"start": start, "end": end, "timeserieslabels": [label]} for label, start, end in LABELS]
    full = {"id": 1, "data": {"csv": "/data/upload/1/0a1b2c3d-run2.csv"}}
    task = {"csv": "run2.csv", "id": 1, "label": marks} if short else {
        **full, "annotations": [{"id": 7, "result": [{"value": mark, "type": "timeserieslabels"} for mark in marks]}]
    }  # fmt: skip
    (tmp_path / "project-1.json").write_text(json.dumps([task]))
    imported = read_source(tmp_path)
    annotations = imported.recordings.annotations
    assert imported.recordings.trial[annotations.recording].tolist() == ["run2", "run2"]
    assert list(zip(annotations.names(), annotations.start, annotations.end, strict=True)) == LABELS
    assert imported.report.warnings == []


def test_a_recording_in_other_units_than_one_other_is_told(tmp_path: Path) -> None:
    pairs = list(zip(AXES, UNITS, strict=True))
    write(tmp_path / "run1.csv", heads=tuple(f"{axis} [{unit}]" for axis, unit in pairs))
    write(tmp_path / "run2.csv", heads=tuple(f"{axis} [m{unit}]" for axis, unit in reversed(pairs)))
    [(name, reason)] = read_source(tmp_path).report.skipped
    assert (name, "; 1 other has Fx (N), Fy (N)" in reason) == ("run2.csv", True)
