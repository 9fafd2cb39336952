"""Files as public data sets and loggers of force and torque lay them out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.labels import AXES

N, DT = 400, 0.002
TIME = np.arange(N) * DT
WRENCH = np.random.default_rng(5).normal(size=(N, 6))


def test_sensors_of_other_rates_with_times_and_annotations_of_their_own(tmp_path: Path) -> None:
    """The wrench is rarer than positions of joints, and its times lie in another group, on a clock since 1970."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        start = 1736772569.25
        for name, count, width in (("joint_positions", 100, 7), ("pose", 100, 7), ("velocity", 100, 6)):
            file[f"robot_state/{name}"] = np.zeros((count, width))
            file[f"timestamps/{name}"] = start + np.arange(count) * 0.008
        file["robot_state/measured_force"], file["robot_state/measured_torque"] = WRENCH[:, :3], WRENCH[:, 3:]
        file["timestamps/arrival"] = start + 5 + TIME
        for name in ("measured_force", "measured_torque"):
            file[f"timestamps/{name}"] = start + TIME
        for number, (begin, end, text) in enumerate([(-0.01, 0.3, "pick"), (0.3, 0.7, "insert")]):
            group = file.create_group(f"segments_info/{number}")
            group["start"], group["end"], group["text"], group["success"] = (
                start + begin,
                start + end,
                text,
                number == 0,
            )
            low = group.create_group("low_level/0")
            low["start"], low["end"], low["text"] = start + begin, start + begin + 0.1, "approach"
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert (recordings.axes, recordings.dt) == (AXES, pytest.approx(DT))
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)
    assert imported.mapping.time == "timestamps/measured_force"
    np.testing.assert_allclose(recordings.starts("segments_info"), [[0, 0.3]], atol=1e-6)
    assert recordings.annotations.of("segments_info").names().tolist() == ["pick", "insert"]
    assert recordings.annotations.of("segments_info_success").names().tolist() == ["success", "failure"]
    assert recordings.annotations.of("segments_info_low_level").names().tolist() == ["approach", "approach"]
    assert not recordings.columns
    assert recordings.note.tolist() == ["other-arrays:6"]
    assert "'robot_state/joint_positions'" in imported.report.remarks[0]


def test_a_matrix_for_every_sample_makes_no_recordings(tmp_path: Path) -> None:
    names = ("obs/tcp_force", "obs/tcp_torque")
    arrays = {"obs/jacobian": np.zeros((N, 6, 7)), names[0]: WRENCH[:, :3], names[1]: WRENCH[:, 3:]}
    np.savez(tmp_path / "run.npz", **arrays, rate=500)
    recordings = read_source(tmp_path).recordings
    assert (len(recordings), recordings.axes) == (1, AXES)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


@pytest.mark.parametrize("first", [0.0, 1.45e9])
def test_an_array_whose_first_row_is_the_time(first: float, tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", ans=np.vstack([first + TIME, WRENCH.T]))
    imported = read_source(tmp_path)
    assert imported.mapping.time == "ans_0"
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH, atol=1e-4)


def test_a_ramp_beside_others_is_no_time(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", q=np.stack([TIME, TIME, TIME], 1), wrench=WRENCH)
    with pytest.raises(InputError, match="has no column of time"):
        read_source(tmp_path)


def test_elements_of_a_structure_with_signals_and_single_values_are_recordings(tmp_path: Path) -> None:
    fields = {
        f"mill.{k}.{name}": value for k in range(3) for name, value in (("case", k // 2), ("force", WRENCH[:, k]))
    }
    np.savez(tmp_path / "mill.npz", **fields, fs=500)
    recordings = read_source(tmp_path).recordings
    assert (len(recordings), recordings.axes) == (3, ("force",))
    assert recordings.columns["case"].tolist() == [0, 0, 1]


@pytest.mark.parametrize("fact", ["data.success", "meta/outcome"])
def test_an_outcome_within_a_structure_counts(fact: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", t=TIME, F=WRENCH[:, :3], **{fact: "success" if "outcome" in fact else True})
    assert read_source(tmp_path).recordings.outcome.tolist() == ["success"]


def rows(values: np.ndarray) -> str:
    return "\n".join(",".join(map(repr, row)) for row in values.tolist())


def test_counts_of_a_sensor_are_divided_by_those_of_a_unit(tmp_path: Path) -> None:
    about = ["Start Time:,Mon Mar 04", "RDT Sample Rate:,500", "Force Units:,N", "Counts per Unit Force:,1000000.0",
             "Torque Units:,N-mm", "Counts per Unit Torque:,1000.0"]  # fmt: skip
    counts = np.round(WRENCH * ([1e6] * 3 + [1e3] * 3))
    stamps = [f"10:11:{k * DT // 0.016 * 0.016:06.3f} AM" for k in range(N)]  # of a slow clock
    lines = [f"{k + 1},{row},{stamp}" for k, (row, stamp) in enumerate(zip(rows(counts).split(), stamps, strict=True))]
    names = "RDT Sequence,Fx,Fy,Fz,Tx,Ty,Tz,Time"
    (tmp_path / "run.csv").write_text("\n".join([*about, names, *lines]) + "\n")
    recordings = read_source(tmp_path).recordings
    assert (recordings.dt, recordings.units) == (DT, ("N",) * 3 + ("Nmm",) * 3)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-3)
    assert recordings.note.tolist() == ["preamble:6;counts"]


def test_a_logger_states_something_about_every_column(tmp_path: Path) -> None:
    about = ["LabVIEW Measurement\t", "Operator\tlab", "***End_of_Header***\t", "Channels\t2\t\t",
             "Samples\t400\t400\t", "Date\t2019/07/22\t2019/07/22\t", "Delta_X\t0,002\t0,002\t",
             "***End_of_Header***\t\t\t", "X_Value\tFx\tFz\tComment"]  # fmt: skip
    lines = [f"{k * DT:.3f}\t{WRENCH[k, 0]:.6f}\t{WRENCH[k, 2]:.6f}\t".replace(".", ",") for k in range(N)]
    (tmp_path / "run.lvm").write_text("\n".join([*about, *lines]) + "\n")
    recordings = read_source(tmp_path, "csv").recordings
    assert (recordings.axes, recordings.dt) == (("Fx", "Fz"), pytest.approx(DT))
    np.testing.assert_allclose(recordings.wrench[0], WRENCH[:, [0, 2]], atol=1e-5)


def test_labview_names_a_comment_that_no_row_has(tmp_path: Path) -> None:
    about = ["LabVIEW Measurement\t", "Separator\tTab", "***End_of_Header***\t", "\t", "Channels\t6",
             "Samples" + "\t400" * 6, "Y_Unit_Label" + "\tN" * 3 + "\tNm" * 3, "X_Dimension\tTime", "X0\t0",
             "Delta_X\t0.002", "***End_of_Header***", "\t".join(["X_Value", *AXES, "Comment"])]  # fmt: skip
    lines = ["\t".join(map(repr, row)) for row in np.column_stack([TIME, WRENCH]).tolist()]
    (tmp_path / "run.lvm").write_text("\n".join([*about, *lines]) + "\n")
    recordings = read_source(tmp_path, "csv").recordings
    assert (recordings.axes, recordings.units) == (AXES, ("N",) * 3 + ("Nm",) * 3)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


def test_of_windows_of_the_last_samples_the_newest_is_taken(tmp_path: Path) -> None:
    """As robots that learn by imitation store their sensors."""
    padded = np.concatenate([np.repeat(WRENCH[:1], 7, 0), WRENCH])
    windows = np.stack([padded[k : k + N] for k in range(8)], 1)
    np.savez(tmp_path / "demo.npz", ee_forces_continuous=windows, actions=np.zeros((N, 7)), rate=500)
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.note.tolist()) == (AXES, ["windows:8"])
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


@pytest.mark.parametrize("stacked", [True, False])
def test_a_table_in_long_form_has_a_column_per_channel(stacked: bool, tmp_path: Path) -> None:
    cells = [(TIME[k], axis, WRENCH[k, place], "N" if place < 3 else "Nm", "free" if k < 200 else "push")
             for k in range(N) for place, axis in enumerate(AXES)]  # fmt: skip
    lines = [",".join(map(str, row)) for row in (sorted(cells, key=lambda row: row[1]) if stacked else cells)]
    (tmp_path / "log.csv").write_text("\n".join(["time,channel,value,unit,phase", *lines]) + "\n")
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert (recordings.axes, recordings.units) == (AXES, ("N",) * 3 + ("Nm",) * 3)
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)
    np.testing.assert_allclose(recordings.starts("phase"), [[0, 0.4]], atol=1e-9)
    again = read_source(tmp_path, mapping=imported.mapping).recordings
    np.testing.assert_array_equal(again.wrench, recordings.wrench)


def test_in_long_form_a_missing_row_is_a_missing_value(tmp_path: Path) -> None:
    cells = [(k, axis, place) for k in range(20) for place, axis in enumerate(AXES) if (k, axis) != (7, "Fy")]
    lines = [f"{trial},{k},{axis},{k + place + trial},N" for trial in (0, 1) for k, axis, place in cells]
    (tmp_path / "log.csv").write_text("\n".join(["trial,time,channel,value,unit", *lines]) + "\n")
    recordings = read_source(tmp_path).recordings
    assert recordings.note.tolist() == ["missing:1"] * 2
    assert set(recordings.units[:3]) == {"N"}
    np.testing.assert_allclose(recordings.wrench, np.add.outer([0, 1], np.add.outer(np.arange(20), np.arange(6))))
    (tmp_path / "log.csv").write_text("\n".join(["trial,time,channel,value,unit", *lines, lines[0]]) + "\n")
    with pytest.raises(InputError, match="time starts anew"):
        read_source(tmp_path)


def test_a_time_that_starts_anew_separates_recordings(tmp_path: Path) -> None:
    table = np.column_stack([np.tile(TIME[:100], 4) + np.repeat([0, 0.001, 0.002, 0], 100), WRENCH])
    np.savetxt(tmp_path / "log.csv", table, header=",".join(["t", *AXES]), delimiter=",", comments="")
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert (recordings.trial.tolist(), recordings.note.tolist()) == (
        [f"log-{k}" for k in range(1, 5)],
        ["restarts:3"] * 4,
    )
    np.testing.assert_allclose(recordings.wrench, WRENCH.reshape(4, 100, 6), atol=1e-6)
    assert "4 recordings are from tables in which the time starts anew." in imported.report.remarks


def test_a_last_row_without_values_need_not_have_a_time(tmp_path: Path) -> None:
    lines = [f"2024-05-01T12:00:00.{2 * k:03},{row}" for k, row in enumerate(rows(WRENCH).split())]
    (tmp_path / "log.csv").write_text("\n".join([",".join(["time", *AXES]), *lines, "end" + "," * 6]) + "\n")
    recordings = read_source(tmp_path).recordings
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)
    assert recordings.note.tolist() == ["lines:1"]


@pytest.mark.parametrize("unit", ["ms", "h"])
def test_a_rate_that_no_sensor_has_is_told(unit: str, tmp_path: Path) -> None:
    names = ",".join([f"t [{unit}]", *AXES])
    np.savetxt(tmp_path / "run.csv", np.column_stack([TIME, WRENCH]), header=names, delimiter=",", comments="")
    [(_, warning)] = read_source(tmp_path).report.warnings
    assert warning.endswith("samples per second. Is the unit of time right?")


def test_a_first_row_with_a_word_is_no_line_of_names(tmp_path: Path) -> None:
    """As ``ros2 topic echo --csv`` writes a wrench."""
    lines = [f"{1700000000 + k // 500},{k % 500 * 2_000_000},tool0,{row}" for k, row in enumerate(rows(WRENCH).split())]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.dt) == (tuple(f"c{k}" for k in range(3, 9)), pytest.approx(DT))
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


@pytest.mark.parametrize("first", ["", "0"])
def test_names_that_count_the_columns_are_no_row(first: str, tmp_path: Path) -> None:
    """As pandas writes an array, with or without its index."""
    table = np.column_stack([np.arange(N), WRENCH]) if not first else WRENCH
    names = ",".join(([""] if not first else []) + [str(k) for k in range(6)])
    (tmp_path / "run.csv").write_text(f"{names}\n{rows(table)}\n")
    recordings = read_source(tmp_path, mapping=Mapping(source_rate=500)).recordings
    assert recordings.axes == tuple("012345")
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


@pytest.mark.parametrize(("name", "said"), [("lp1.data", "rcbht import csv"), ("a.xlsx", "save their sheets as CSV")])
def test_what_to_do_with_files_of_another_kind(name: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("x")
    with pytest.raises(InputError, match=said):
        read_source(tmp_path)


def test_numbers_that_are_constant_in_each_file_describe_the_recordings(tmp_path: Path) -> None:
    """If they differ, and are constant in every file: a joint that rests in one file is a signal."""
    for number in range(3):
        table = np.column_stack([TIME, WRENCH + number, np.full(N, 8.0 + number % 2), np.full(N, 0.7), TIME * number])
        (tmp_path / f"run{number}.csv").write_text(f"t,{','.join(AXES)},peg_diameter,mass,q_0\n{rows(table)}\n")
    imported = read_source(tmp_path)
    assert imported.recordings.columns.keys() == {"peg_diameter"}
    assert imported.recordings.columns["peg_diameter"].tolist() == ["8", "9", "8"]
    roles = {row["column"]: row["role"] for row in imported.report.understood}
    assert (roles["peg_diameter"], roles["mass"], roles["q_0"]) == ("column peg_diameter", "left out", "left out")
    again = read_source(tmp_path, mapping=imported.mapping).recordings
    assert again.columns["peg_diameter"].tolist() == ["8", "9", "8"]


def test_groups_with_one_wrench_are_recordings_though_one_has_more(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "all.h5", "w") as file:
        for number in range(3):
            file[f"2023-01-0{number + 1}_run/time"], file[f"2023-01-0{number + 1}_run/ft"] = TIME, WRENCH + number
        file["2023-01-02_run/remark"] = "slipped"
    recordings = read_source(tmp_path).recordings
    assert (len(recordings), recordings.axes) == (3, AXES)
    assert recordings.columns["remark"].tolist() == ["", "slipped", ""]


def test_fields_of_structured_arrays_are_columns(tmp_path: Path) -> None:
    rows = [(time, *row) for time, row in zip(TIME.tolist(), WRENCH.tolist(), strict=True)]
    np.save(tmp_path / "run.npy", np.array(rows, [("t", "f8"), *((axis, "f4") for axis in AXES)]))
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.dt) == (AXES, pytest.approx(DT))
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


def test_fields_of_parquet_structures_are_columns(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parts = {"force": WRENCH[:, :3], "torque": WRENCH[:, 3:]}
    fields = {name: pa.StructArray.from_arrays(list(part.T.copy()), list("xyz")) for name, part in parts.items()}
    wrench = pa.StructArray.from_arrays(list(fields.values()), list(fields))
    nothing = pa.StructArray.from_arrays([pa.nulls(N)], ["empty"])
    pq.write_table(pa.table({"t": TIME, "wrench": wrench, "nothing": nothing}), tmp_path / "run.parquet")
    recordings = read_source(tmp_path).recordings
    assert recordings.axes == AXES
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


def test_a_first_column_that_counts_the_stated_period_is_the_time(tmp_path: Path) -> None:
    trials = {f"trial_{number}": np.column_stack([TIME, WRENCH + number]) for number in range(2)}
    np.savez(tmp_path / "a.npz", **trials, fs=500)
    assert read_source(tmp_path).recordings.axes == tuple(f"values_{k}" for k in range(1, 7))


def test_recordings_may_be_the_last_dimension(tmp_path: Path) -> None:
    cube = np.stack([WRENCH + number for number in range(5)], 2)
    np.savez(tmp_path / "a.npz", X=cube, Y=np.arange(5) % 2, t=TIME)
    recordings = read_source(tmp_path).recordings
    assert len(recordings) == 5
    assert recordings.columns["Y"].tolist() == [0, 1, 0, 1, 0]
    np.testing.assert_allclose(recordings.wrench[4], WRENCH + 4, atol=1e-6)


def test_comments_state_the_rate(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(f"# sample_rate: 500 Hz\n# operator: Ann\n{','.join(AXES)}\n{rows(WRENCH)}\n")
    assert read_source(tmp_path).recordings.dt == DT


@pytest.mark.parametrize(
    "heads",
    ["label,start_time,end_time", "Phase,onset_ms,offset_ms", "label,start,end", "Phase,Begin (s),Finish (s)",
     "label,start,duration"],
)  # fmt: skip
def test_annotations_of_other_names(heads: str, tmp_path: Path) -> None:
    scale, last = 1000 if "ms" in heads else 1, 0.1 if "duration" in heads else 0.2
    (tmp_path / "run.csv").write_text(f"t,{','.join(AXES)}\n{rows(np.column_stack([TIME, WRENCH]))}\n")
    (tmp_path / "marks.csv").write_text(f"file_name,{heads}\nrun.csv,push,{0.1 * scale},{last * scale}\n")
    imported = read_source(tmp_path)
    annotations = imported.recordings.annotations
    assert (annotations.start.tolist(), annotations.end.tolist()) == ([0.1], [0.2])
    assert annotations.names().tolist() == ["push"]
    assert not imported.report.skipped


def test_a_wrench_of_other_columns_than_most_is_told(tmp_path: Path) -> None:
    """Where a file lacks the columns of a sensor, those of another would stand for it."""
    for number in range(3):
        names = [f"{side}.{axis}" for side in (["left", "right"] if number else ["right"]) for axis in AXES]
        table = np.column_stack([TIME, WRENCH + number, *([WRENCH - number] if number else [])])
        (tmp_path / f"run{number}.csv").write_text(f"t,{','.join(names)}\n{rows(table)}\n")
    warnings = read_source(tmp_path).report.warnings
    text = (
        "its axes are the columns 'right.Fx', ...; those of most recordings are '{arm}.Fx', .... Is it the same sensor?"
    )
    assert warnings == [("run0.csv", text)]
    named = read_source(tmp_path, mapping=Mapping(arms=("left", "right")))
    assert not named.report.warnings
    assert named.recordings.arm.tolist() == ["right", "left", "right", "left", "right"]
    assert named.recordings.trial.tolist() == ["run0", "run1", "run1", "run2", "run2"]


def test_the_file_whose_reason_is_told_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "scene.npy", {"035622060973": [{"timestamp": 1, "zeroed": WRENCH[0]}]}, allow_pickle=True)
    with pytest.raises(InputError, match=r"scene\.npy.*Python objects.*numpy\.savez"):
        read_source(tmp_path)


@pytest.mark.parametrize("form", ["[{}, {}, {}]", "({},{},{})", "[{} {}  {}]"])
def test_lists_in_cells_are_columns(form: str, tmp_path: Path) -> None:
    cells = ['"' + form.format(*row) + '"' for row in WRENCH[:, :3].tolist()]
    lines = [f"{time!r},{cell},7" for time, cell in zip(TIME.tolist(), cells, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["timestamp,actual_TCP_force,robot_mode", *lines]) + "\n")
    recordings = read_source(tmp_path).recordings
    assert recordings.axes == AXES[:3]
    np.testing.assert_allclose(recordings.wrench[0], WRENCH[:, :3], atol=1e-6)


def test_a_wrench_that_is_text_is_not_left_out(tmp_path: Path) -> None:
    lines = [f"{time!r},x={force};,0" for time, force in zip(TIME.tolist(), WRENCH[:, 0].tolist(), strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["t,force,z", *lines]) + "\n")
    with pytest.raises(InputError, match="column 'force' holds 'x="):
        read_source(tmp_path)


def test_arrays_beside_recordings_are_not_left_out_in_silence(tmp_path: Path) -> None:
    """They may show that the first dimension is time."""
    np.savez(tmp_path / "run.npz", history=WRENCH.reshape(50, 8, 6), qpos=np.zeros((50, 7)), reward=np.zeros(50), fs=50)
    imported = read_source(tmp_path)
    assert imported.report.remarks[0] == "Arrays of another shape or kind were left out: 'qpos'."
    assert set(imported.recordings.note.tolist()) == {"other-arrays:1"}


def test_groups_of_two_sides_are_arms_of_one_trial(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    for number in range(2):
        with h5py.File(tmp_path / f"run{number}.h5", "w") as file:
            for side, sign in (("left_arm", 1), ("right_arm", -1)):
                file[f"{side}/time"], file[f"{side}/wrench"] = TIME, sign * WRENCH + number
    recordings = read_source(tmp_path).recordings
    assert recordings.arm.tolist() == ["left_arm", "right_arm"] * 2
    assert recordings.trial.tolist() == ["run0", "run0", "run1", "run1"]


def test_times_of_other_signals_are_no_channels(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", **{f"out.F_{axis}.{key}": TIME if key == "Time" else WRENCH[:, place]
                                      for place, axis in enumerate("xyz") for key in ("Time", "Data")})  # fmt: skip
    assert read_source(tmp_path).recordings.axes == AXES[:3]
    np.savez(tmp_path / "run.npz", **{"level/time": TIME, "level/value": WRENCH[:, 0], "gap/time": TIME + 1})
    assert read_source(tmp_path).recordings.axes == ("level/value",)


def test_brackets_around_rows_are_no_part_of_their_cells(tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_text("".join(f"( {row.replace(',', ' , ')} )\n" for row in rows(WRENCH).split()))
    recordings = read_source(tmp_path, "csv", Mapping(source_rate=500)).recordings
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, atol=1e-6)


@pytest.mark.parametrize(
    ("folders", "sessions"),
    [
        (("day1/trial1", "day1/trial2", "day2/trial3"), ["day1", "day1", "day2"]),
        (("day1/trial1", "day1/trial1", "day2/trial3"), ["day1/trial1", "day1/trial1", "day2/trial3"]),
        (("day1", "day2", "day3"), ["day1", "day2", "day3"]),
    ],
)
def test_a_folder_of_one_trial_is_no_session(folders: tuple[str, ...], sessions: list[str], tmp_path: Path) -> None:
    for number, folder in enumerate(folders):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        table = np.column_stack([TIME, WRENCH + number])
        (tmp_path / folder / f"ft{number}.csv").write_text(f"t,{','.join(AXES)}\n{rows(table)}\n")
    assert read_source(tmp_path).recordings.session.tolist() == sessions
