"""Every format: a small file written by somebody else's library comes back as the columns that were put in."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rcbht_jax.cli.commands import COMMANDS
from rcbht_jax.cli.main import command_class
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.find import KINDS
from rcbht_jax.io.importing.importer import Imported, read_source
from rcbht_jax.io.importing.text import read_csv

N, DT = 40, 0.01
TIME = np.arange(N) * DT
WRENCH = np.random.default_rng(3).normal(size=(N, 6)).astype(np.float32)
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def same(imported: Imported, count: int = 1) -> None:
    recordings = imported.recordings
    assert len(recordings) == count
    assert recordings.axes == AXES
    assert recordings.dt == DT
    for wrench in recordings.wrench:
        np.testing.assert_array_equal(wrench, WRENCH)


@pytest.mark.parametrize(
    ("delimiter", "end", "head"), [(",", "\n", ""), (";", "\r\n", ""), ("\t", "\n", "# "), (" ", "\n", "% ")]
)
def test_text_tables(tmp_path: Path, delimiter: str, end: str, head: str) -> None:
    lines = [head + delimiter.join(["time", *AXES])]
    lines += [delimiter.join(map(repr, [t, *map(float, row)])) for t, row in zip(TIME.tolist(), WRENCH, strict=True)]
    (tmp_path / "run.csv").write_bytes((end.join(lines) + end).encode("utf-8-sig" if delimiter == "," else "ascii"))
    same(read_source(tmp_path / "run.csv"))


def rows_of(lines: list[str]) -> list[str]:
    rows = [",".join(map(repr, [t, *map(float, row)])) for t, row in zip(TIME.tolist(), WRENCH, strict=True)]
    return [*lines, ",".join(["time", *AXES]), *rows]


@pytest.mark.parametrize(
    "lines",
    [
        ["Serial,FT12345", "Start Time,5/1/2024 12:00", "", "Force Units,N", "Torque Units,N-m"],
        ["Wrist sensor of the left arm"],
        ["rate,500", "gains,1,1,1"],
    ],
)
def test_lines_of_a_data_logger_before_the_names_are_left_out_and_noted(tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "run.csv").write_text("\n".join(rows_of(lines)))
    imported = read_source(tmp_path / "run.csv")
    same(imported)
    assert imported.recordings.note.tolist() == [f"preamble:{len(lines)}"]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda lines: [lines[0] + ",Mw", *lines[1:]], "line 2: 7 cells; expected 8"),  # a name too many
        (lambda lines: [lines[0][:-3], *lines[1:]], "line 2: 7 cells; expected 6"),  # a name too few
        (lambda lines: [*lines[:5], "0.04,1.0", *lines[6:]], "line 6: 2 cells; expected 7"),  # a row that is cut off
        (lambda lines: ["Serial,FT1", *lines[1:]], "line 2: 7 cells; expected 2"),  # names that are not there
    ],
)
def test_other_lines_of_another_length_remain_mistakes(tmp_path: Path, edit: Callable, message: str) -> None:
    (tmp_path / "run.csv").write_text("\n".join(edit(rows_of([]))))
    with pytest.raises(InputError, match=message):
        read_source(tmp_path / "run.csv")


@pytest.mark.parametrize(("between", "ending"), [(";", "csv"), ("\t", "tsv")])
def test_decimal_commas(between: str, ending: str, tmp_path: Path) -> None:
    numbers = np.column_stack([TIME, WRENCH]).astype(float).tolist()
    rows = [between.join(repr(value).replace(".", ",") for value in row) for row in numbers]
    (tmp_path / f"run.{ending}").write_text("\n".join([between.join(["time", *AXES]), *rows]))
    same(read_source(tmp_path / f"run.{ending}"))
    (tmp_path / f"bare.{ending}").write_text("\n".join(rows))
    assert read_source(tmp_path / f"bare.{ending}").recordings.wrench.shape == (1, N, 6)


def test_a_table_of_a_spreadsheet_need_not_be_utf8(tmp_path: Path) -> None:
    text = "Zeit [s];Temperatur [°C];Zustand\n0,0;20,5;Fügen\n0,1;21;Fügen\n"
    (tmp_path / "a.csv").write_bytes(text.encode("cp1252"))
    [table] = read_csv(tmp_path / "a.csv", "a.csv")
    assert list(table.columns) == ["Zeit [s]", "Temperatur [°C]", "Zustand"]
    assert table.columns["Zustand"].tolist() == ["Fügen"] * 2
    assert table.notes == ("cp1252",)


@pytest.mark.parametrize("rows", [["a,Ann,1", "b,Bob,2"], ["a,N"], ["s,m", "v,n"], ["s,", "n,"]])
def test_a_row_of_words_that_are_units_too_is_no_line_of_units(tmp_path: Path, rows: list[str]) -> None:
    head = ["file", "operator", "day"][: rows[0].count(",") + 1]
    (tmp_path / "a.csv").write_text("\n".join([",".join(head), *rows]) + "\n")
    [table] = read_csv(tmp_path / "a.csv", "a.csv")
    assert list(table.columns) == head
    assert table.columns["file"].tolist() == [row[0] for row in rows]


@pytest.mark.parametrize("before", ["", "Logger 7\nSerial;12\n"])
def test_a_line_of_units_below_the_names(tmp_path: Path, before: str) -> None:
    rows = ["Zeit;Kraft_x;Kraft_y;Kraft_z;Takt", "[ms];[N];[N];[N];", *(f"{5 * k};{k},5;0;1;{k % 3}" for k in range(9))]
    (tmp_path / "a.csv").write_text(before + "\n".join(rows))
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.recordings.units) == (("Fx", "Fy", "Fz"), ("N",) * 3)
    assert imported.recordings.dt == 0.005
    np.testing.assert_array_equal(imported.recordings.wrench[0, :, 0], np.arange(9) + 0.5)


def test_a_table_without_names_has_the_time_first(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "run.txt", np.column_stack([TIME, WRENCH]))
    imported = read_source(tmp_path / "run.txt", "csv")
    assert imported.recordings.axes == ("c1", "c2", "c3", "c4", "c5", "c6")
    assert imported.recordings.dt == DT


def test_text_quotes_empty_cells_and_words(tmp_path: Path) -> None:
    rows = ["t,Fz,phase,who", *(f"{k / 10},{'' if k == 3 else k},{phase(k)},ann" for k in range(9))]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    recordings = read_source(tmp_path / "a.csv").recordings
    assert recordings.annotations.labels == {"phase": ("free", "push, hard")}
    np.testing.assert_allclose(recordings.annotations.end, [0.5, 0.9])
    assert recordings.columns["who"].tolist() == ["ann"]
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], np.arange(9))  # the empty cell is interpolated
    assert recordings.note[0] == "missing:1"


def phase(row: int) -> str:
    return '"push, hard"' if row > 4 else "free"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("t,Fz\n0,1\n1\n", "line 3: 1 cells; expected 2"),
        ("t,Fz\n0,1\n1,2\n2,x\n", "line 4, column Fz: 'x' is not a number"),
        ("t,Fz\n0,1\n1,1_0\n2,3\n", "line 3, column Fz: '1_0' is not a number"),
        ("t,Fz\n", "has no rows"),
        ("\n\n", "is empty"),
        ("", "is empty"),
        ("t,Fz\n" + "".join(f"{k},1\n" for k in [0, 1, 2, 3] * 5), "time runs backwards 4 times.*--group"),
        ("t,Fz\n" + "".join(f"{k},{'' if 2 < k < 10 else k}\n" for k in range(20)), "7 values in a row are missing"),
        ("Fz\n" + "1\n" * 9, "no column of time"),
        ("t,phase\n0,a\n1,b\n", "no column of numbers"),
    ],
)
def test_a_bad_table_is_one_sentence(tmp_path: Path, content: str, sentence: str) -> None:
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(InputError, match=sentence):
        read_source(tmp_path / "a.csv")


def test_parquet_with_lists_and_dictionaries(tmp_path: Path) -> None:
    lists = pa.FixedSizeListArray.from_arrays(pa.array(WRENCH.ravel()), 6)
    words = pa.array(["free"] * 20 + ["push"] * 20).dictionary_encode()
    stamps = pa.array((TIME * 1e9).round().astype(np.int64) + 10**18, pa.timestamp("ns"))
    pq.write_table(pa.table({"stamp": stamps, "wrench": lists, "phase": words}), tmp_path / "a.parquet")
    imported = read_source(tmp_path / "a.parquet")
    same(imported)
    assert imported.recordings.annotations.names().tolist() == ["free", "push"]


@pytest.mark.parametrize("name", ["timestamp_ns", "__index_level_0__"])
def test_parquet_knows_the_unit_of_a_typed_time(tmp_path: Path, name: str) -> None:
    """A name with a unit scaled it again; the index that pandas writes without a name was no time."""
    stamps = pa.array((TIME * 1e9).round().astype(np.int64) + 10**18, pa.timestamp("ns"))
    table = pa.table({name: stamps, **{axis: WRENCH[:, number] for number, axis in enumerate(AXES)}})
    pq.write_table(table, tmp_path / "a.parquet")
    same(read_source(tmp_path / "a.parquet"))


def test_npz_of_one_recording_and_of_many(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, wrench=WRENCH, quat=np.zeros((N, 4)))
    same(read_source(tmp_path / "a.npz"))
    np.savez(
        tmp_path / "b.npz", force_torque=np.stack([WRENCH] * 3), rate=1 / DT, outcome=np.array(["ok", "ok", "bad"])
    )
    imported = read_source(tmp_path / "b.npz")
    assert imported.recordings.outcome.tolist() == ["ok", "bad"]  # the second is a copy of the first
    assert imported.report.duplicates == [("b.npz#1", "exact copy of b.npz#0; imported once.")]
    np.save(tmp_path / "c.npy", WRENCH)
    with pytest.raises(InputError, match="--source-rate"):
        read_source(tmp_path / "c.npy")


def test_hdf5_flat_and_with_a_group_per_recording(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "flat.h5", "w") as file:
        file["time"], file["sensor/wrench"] = TIME, WRENCH
        file["images"] = np.zeros((3, 4, 4, 3), np.uint8)
    same(read_source(tmp_path / "flat.h5"))
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        for number in range(3):
            demo = file.create_group(f"data/demo_{number}")
            demo["obs/ft"], demo.attrs["dt"] = WRENCH + number, DT
            demo.attrs["operator"] = "ann"
    imported = read_source(tmp_path / "demos.hdf5")
    assert imported.recordings.trial.tolist() == [f"demos-demo_{number}" for number in range(3)]
    assert imported.recordings.columns["operator"].tolist() == ["ann"] * 3
    np.testing.assert_allclose(imported.recordings.wrench[2], WRENCH + 2)


def test_matlab_arrays_structures_and_version_7_3(tmp_path: Path) -> None:
    for compressed in (False, True):
        path = tmp_path / f"{compressed}.mat"
        scipy.io.savemat(path, {"t": TIME[None], "log": {"wrench": WRENCH, "who": "ann"}}, do_compression=compressed)
        imported = read_source(path)
        same(imported)
        assert imported.recordings.columns["log.who"].tolist() == ["ann"]
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        file["t"], file["wrench"] = TIME[None], WRENCH.T  # MATLAB stores columns first
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with (tmp_path / "new.mat").open("r+b") as raw:
        raw.write(head)
    assert read_source(tmp_path / "new.mat").recordings.wrench.shape == (1, N, 6)


def wrench_message(store, stamp: float, row: np.ndarray):
    types = store.types
    nanoseconds = round(stamp * 1e9)
    time = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    more = {"seq": 0} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="ft", **more)
    vector = types["geometry_msgs/msg/Vector3"]
    force, torque = (vector(**dict(zip("xyz", part, strict=True))) for part in (row[:3].tolist(), row[3:].tolist()))
    wrench = types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
    return types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=wrench)


def write_ros1(path: Path, topics: tuple[str, ...] = ("/ft",), renamed: tuple[str, str] = ("", "")) -> None:
    """A bag, in whose definitions of messages a field may have another name."""
    store, kind = get_typestore(Stores.ROS1_NOETIC), "geometry_msgs/msg/WrenchStamped"
    with Writer1(path) as writer:

        def connect(topic: str, kind: str):
            others = get_typestore(Stores.EMPTY)
            others.register(get_types_from_msg(store.generate_msgdef(kind)[0].replace(*renamed), kind))
            return writer.add_connection(topic, kind, typestore=others)

        connections = [connect(topic, kind) for topic in topics]
        spoken = connect("/phase", "std_msgs/msg/String")
        for number, row in enumerate(WRENCH):
            stamp = 100 + number * DT
            if number in (0, 20):
                text = store.types["std_msgs/msg/String"](data="push" if number else "free")
                writer.write(spoken, round(stamp * 1e9), store.serialize_ros1(text, "std_msgs/msg/String"))
            for connection in connections:
                raw = store.serialize_ros1(wrench_message(store, stamp, row), kind)
                writer.write(connection, round(stamp * 1e9), raw)


@pytest.mark.parametrize("storage", ["ros1", "sqlite", "mcap"])
def test_bags_are_recorded_with_units_and_words(tmp_path: Path, storage: str) -> None:
    path = tmp_path / ("run.bag" if storage == "ros1" else "run")
    if storage == "ros1":
        write_ros1(path)
    else:
        store, kind = get_typestore(Stores.ROS2_HUMBLE), "geometry_msgs/msg/WrenchStamped"
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        with Writer(path, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/ft", kind, typestore=store)
            spoken = writer.add_connection("/phase", "std_msgs/msg/String", typestore=store)
            for number, row in enumerate(WRENCH):
                stamp = 100 + number * DT
                if number in (0, 20):
                    text = store.types["std_msgs/msg/String"](data="push" if number else "free")
                    writer.write(spoken, round(stamp * 1e9), store.serialize_cdr(text, "std_msgs/msg/String"))
                raw = store.serialize_cdr(wrench_message(store, stamp, row), kind)
                writer.write(connection, round(stamp * 1e9), raw)
    for kind in ("auto", "bag"):
        imported = read_source(path, kind)
        same(imported)
        assert imported.recordings.units == ("N",) * 3 + ("Nm",) * 3
        assert imported.recordings.annotations.names().tolist() == ["free", "push"]
        np.testing.assert_allclose(imported.recordings.annotations.start, [0, 0.2], atol=1e-6)
        np.testing.assert_allclose(imported.recordings.annotations.end, [0.2, N * DT], atol=1e-6)
    inside = tmp_path / "folder"
    inside.mkdir()
    path.rename(inside / path.name)
    same(read_source(inside))


def test_every_topic_of_wrenches_is_an_arm(tmp_path: Path) -> None:
    write_ros1(tmp_path / "run.bag", ("/left/ft", "/right/ft"))
    recordings = read_source(tmp_path / "run.bag").recordings
    # The two arms carry equal values: a copy.
    assert recordings.arm.tolist() == ["/left/ft"]
    assert recordings.trial.tolist() == ["run"]


@pytest.mark.parametrize(
    ("renamed", "column", "units", "said"),
    [
        (("Vector3 force", "Vector3 push"), "wrench.push.x", ("",) * 3 + ("Nm",) * 3, ["free", "push"]),
        (("string data", "string text"), "Fx", ("N",) * 3 + ("Nm",) * 3, []),
        (("time stamp", "time moment"), "Fx", ("N",) * 3 + ("Nm",) * 3, ["free", "push"]),
    ],
)
def test_a_bag_may_define_messages_otherwise(tmp_path: Path, renamed, column, units, said) -> None:
    write_ros1(tmp_path / "run.bag", renamed=renamed)
    recordings = read_source(tmp_path / "run.bag").recordings
    assert recordings.axes[0] == column
    assert recordings.units == units
    np.testing.assert_array_equal(recordings.wrench[0], WRENCH)
    assert recordings.annotations.names().tolist() == said


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_lerobot(version: str, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 100, "features": {"observation.wrench": {"names": list(AXES)}}}
    (folder / "meta/info.json").write_text(json.dumps(info))
    episodes = {
        "episode_index": [0, 1],
        "tasks": [["plug"], ["unplug"]],
        "length": [N, N],
        "stats/x/min": [[0.0], [0.0]],
    }
    if version == "v3.0":
        pq.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
    else:
        lines = [{"episode_index": number, "tasks": episodes["tasks"][number], "length": N} for number in range(2)]
        (folder / "meta/episodes.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")
    flat = np.concatenate([WRENCH, WRENCH + 1])
    frames = {
        "observation.wrench": pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), 6),
        "episode_index": np.repeat([0, 1], N), "frame_index": np.tile(np.arange(N), 2), "index": np.arange(2 * N),
        "timestamp": np.tile(TIME, 2).astype(np.float32), "task_index": np.repeat([0, 1], N),
    }  # fmt: skip
    pq.write_table(pa.table(frames), folder / "data/chunk-000/file-000.parquet")
    for kind in ("lerobot", "auto"):
        imported = read_source(folder, kind)
        assert imported.recordings.columns["task"].tolist() == ["plug", "unplug"]
        np.testing.assert_array_equal(imported.recordings.wrench, flat.reshape(2, N, 6))
        assert imported.recordings.axes == AXES
        assert set(imported.recordings.columns) == {"task"}
    (folder / "meta/info.json").write_text(json.dumps(info | {"codebase_version": "v1.6"}))
    with pytest.raises(InputError, match=r"version v1\.6; expected v2\.0 to v3\.0"):
        read_source(folder)


def test_a_broken_line_of_lerobot_episodes_is_named(tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v2.1", "fps": 100}))
    for line in ("{", "[]", '{"tasks": []}'):
        (tmp_path / "meta/episodes.jsonl").write_text('{"episode_index": 0}\n' + line)
        with pytest.raises(InputError, match="line 2 is not"):
            read_source(tmp_path)


def test_every_kind_has_a_command() -> None:
    named = {words.split()[1] for words in COMMANDS if words.startswith("import ")}
    assert named == {*KINDS, "hiro"}
    assert {command_class(f"import {kind}").KIND for kind in KINDS} == set(KINDS)


def test_texts_of_other_encodings_are_read_refused_or_questioned(tmp_path: Path) -> None:
    table = "t,Fz,状態\n0,1.0,接近\n0.1,2.0,接触\n0.2,3.0,接触\n"
    (tmp_path / "wide.csv").write_text(table, "utf-16")
    assert read_source(tmp_path / "wide.csv").recordings.annotations.labels == {"状態": ("接近", "接触")}
    (tmp_path / "cut.csv").write_bytes(table.encode("utf-16")[:-1])
    with pytest.raises(InputError, match=r"cut\.csv begins as UTF-16 does and is damaged; save it as UTF-8\.$"):
        read_source(tmp_path / "cut.csv")
    (tmp_path / "undefined.csv").write_bytes(b"t,Fz,phase\n0,1.0,\x81 a\n0.1,2.0,b\n")
    with pytest.raises(InputError, match=r"neither UTF-8 nor Windows-1252; save it as UTF-8\.$"):
        read_source(tmp_path / "undefined.csv")
    (tmp_path / "german.csv").write_text("t,Fz,Größe\n0,1.0,a\n0.1,2.0,a\n0.2,3.0,b\n", "cp1252")
    [remark, _] = read_source(tmp_path / "german.csv").report.remarks
    assert remark.endswith("read as Windows-1252; if names are garbled, save it as UTF-8.")


@pytest.mark.filterwarnings("default")  # as a command has them
def test_a_table_without_rows_is_told_in_one_sentence(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    (tmp_path / "run.csv").write_text("t,Fx,Fy,Fz\n\n")
    with pytest.raises(InputError, match=r"run\.csv has no rows; expected a table\.$"):
        list(read_csv(tmp_path / "run.csv", "run.csv"))
    assert not recwarn.list


def test_the_row_without_a_time_is_named(tmp_path: Path) -> None:
    rows = [f"{'' if k == 20 else k / 100},{k % 7}" for k in range(50)]
    (tmp_path / "run.csv").write_text("\n".join(["t,Fz", *rows]))
    with pytest.raises(InputError, match=r"sample 20 has no time\.$"):
        read_source(tmp_path / "run.csv")
