"""What ``rcbht export`` writes comes back equal."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from pyarrow import parquet
from rosbags.highlevel import AnyReader

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.export import FORMATS, DataSet, export, load, write
from rcbht_jax.io.export.card import card
from rcbht_jax.io.export.tables import COLUMNS
from rcbht_jax.io.importing.importer import import_source, read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.label_store import read_tracks_attrs
from rcbht_jax.io.rosbags import open_bag
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.labels import AXES, UNITS
from rcbht_jax.types import Recordings
from tests.support.store_cases import same


def recordings() -> Recordings:
    rng = np.random.default_rng(0)
    rows = [
        (0, "phase", "free", 0.0, 0.1), (0, "phase", "push", 0.1, float("nan")), (2, "phase", "push", 0.05, 0.2),
        (2, "who", "ann, or bob", 0.0, 0.3),
    ]  # fmt: skip
    made = Recordings.from_arrays(
        [rng.normal(size=(count, 6)) for count in (80, 50, 60)], 200.0, annotations=rows,
        outcome=["good", "bad", "unknown"], session=["1", "1", "2"], part=["peg", "", "peg, long"],
        depth=np.array([0.1, np.nan, 1 / 3]), tries=np.array([1, 2, 3]),
        trial=["a", "b", "c"], note=["", "x;y", ""], slow=np.array([True, False, True]), few=np.int8([1, -2, 3]),
        stamp=np.array([2**60 + 1, 0, -1]), most=np.array([2**63 + 5, 0, 1], np.uint64),
        third=np.float32([1 / 3, np.nan, 2]), samples=np.array([3.0, 2.0, 1.0]),
        seconds=["?", "", "9"], length_mm=np.array([1.5, 2.5, 3.5]), task=["x", "", "z"],
    )  # fmt: skip
    named = dict.fromkeys(["rate", "label"], np.array([1.0, 2.0, 3.0]))  # as a parameter and a column of annotations
    return replace(made, columns={**made.columns, **named})


@pytest.fixture(params=sorted(FORMATS))
def exported(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    write_recordings(tmp_path / "a.zarr", recordings(), {})
    export(load(tmp_path / "a.zarr"), tmp_path / request.param, request.param)
    return tmp_path / request.param


def test_labels_that_no_recording_has_come_back(tmp_path: Path) -> None:
    made = replace(recordings(), annotations=Annotations(labels={"phase": ("free", "push")}))
    export(DataSet.of(made), tmp_path / "out", "csv")
    assert read_source(tmp_path / "out").recordings.annotations.labels == made.annotations.labels


def test_an_export_comes_back_equal(exported: Path, tmp_path: Path) -> None:
    kind = exported.name
    report = import_source(exported, tmp_path / "back.zarr", kind).report
    back, made = read_recordings(tmp_path / "back.zarr"), recordings()
    assert report.imported == ["a/R", "b/R", "c/R"]
    assert (back.dt, back.axes, back.units) == (made.dt, made.axes, made.units)
    np.testing.assert_array_equal(back.wrench, made.wrench)
    np.testing.assert_array_equal(back.length, made.length)
    assert set(back.columns) == set(made.columns)
    for name in ("trial", "arm", "source", "session", "outcome", "note", *made.columns):
        np.testing.assert_array_equal(back.column(name), made.column(name), err_msg=name)
        assert back.column(name).dtype.kind == made.column(name).dtype.kind
    assert back.annotations.labels == made.annotations.labels
    for name in ("recording", "track", "code", "start", "end"):
        np.testing.assert_array_equal(getattr(back.annotations, name), getattr(made.annotations, name))


@pytest.mark.parametrize("axes", [("force norm", "torque"), tuple(f"taxel {k}" for k in range(256))], ids=len)
@pytest.mark.parametrize("kind", sorted(FORMATS))
def test_channels_of_any_name_and_number_come_back(kind: str, axes: tuple[str, ...], tmp_path: Path) -> None:
    values = [np.random.default_rng(0).normal(size=(30, len(axes)))]
    made = Recordings.from_arrays(values, 20.0, axes=axes, units=["N", ""] * (len(axes) // 2))
    write_recordings(tmp_path / "a.zarr", made, {})
    export(load(tmp_path / "a.zarr"), tmp_path / "out", kind)
    back = read_source(tmp_path / "out").recordings
    assert (back.axes, back.units, back.dt) == (made.axes, made.units, made.dt)
    np.testing.assert_array_equal(back.wrench, made.wrench)


@pytest.mark.parametrize(("kind", "name"), [("csv", "recording"), ("lerobot", "tasks"), ("lerobot", "length")])
def test_a_column_that_would_take_the_place_of_another_is_refused(kind: str, name: str, tmp_path: Path) -> None:
    made = Recordings.from_arrays([np.ones((30, 6))], **{name: ["x"]})
    with pytest.raises(InputError, match=f"column {name} would take the place of one that {kind} files have"):
        export(DataSet.of(made), tmp_path / "out", kind)
    assert not (tmp_path / "out").exists()


def test_own_columns_are_not_described_as_the_computed_ones(exported: Path) -> None:
    described = json.loads((exported / "dataset.json").read_text())["columns"]
    assert described["seconds"] == described["samples"] != COLUMNS["samples"]


@pytest.mark.parametrize("kind", ["csv", "mcap"])
def test_a_long_recording_is_written_in_slices(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The texts of all samples were in memory at the same time."""
    made = Recordings.from_arrays([np.random.default_rng(0).normal(size=(2000, 6))], 200.0)
    peaks = []
    for rows in (2000, 125):
        monkeypatch.setattr(write, "ROWS", rows)
        tracemalloc.start()
        export(DataSet.of(made), tmp_path / str(rows), kind)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    whole, sliced = (
        sorted(path for path in folder.rglob("*") if path.is_file()) for folder in sorted(tmp_path.iterdir())
    )
    assert [path.read_bytes() for path in whole] == [path.read_bytes() for path in sliced]
    assert peaks[1] < 0.8 * peaks[0]


@pytest.mark.parametrize(("kind", "axis"), [("csv", "time"), ("parquet", "recording"), ("parquet", "sample")])
def test_an_axis_that_would_take_the_place_of_a_column_is_refused(kind: str, axis: str, tmp_path: Path) -> None:
    made = Recordings.from_arrays([np.ones((30, 2))], 100.0, axes=["grip", axis])
    with pytest.raises(InputError, match=f"axis {axis} would take the place of a column of {kind} files"):
        export(DataSet.of(made), tmp_path / "out", kind)
    assert not (tmp_path / "out").exists()


def test_an_export_is_read_as_it_is(exported: Path) -> None:
    with pytest.raises(InputError, match="leave out --map"):
        read_source(exported, mapping=Mapping(rate=100.0))


def test_a_damaged_export_is_one_sentence(exported: Path) -> None:
    about = json.loads((exported / "dataset.json").read_text())
    for change, sentence in (
        ({"dt": "x"}, "dt is 'x'"),
        ({"axes": None}, "names no axes"),
        ({"axes": {"Qx": "N"}}, "Qx|no topic"),
        ({"annotations": {"phase": [["free"]]}}, "no table of lists of texts"),
        ({"annotations": {"phase": {"free": 0}}}, "no table of lists of texts"),
        ({"column_types": {"depth": 1e308}}, "column depth is of the type '1e[+]308'; expected text or numbers"),
        ({"column_types": {"depth": "O"}}, "column depth is of the type 'O'"),
    ):
        (exported / "dataset.json").write_text(json.dumps(about | change))
        with pytest.raises(InputError, match=sentence):
            read_source(exported)
    (exported / "dataset.json").write_text("[")
    with pytest.raises(InputError, match="is not JSON"):
        read_source(exported)


@pytest.mark.parametrize(
    ("letters", "units", "topic"),
    [("FFFTTT", UNITS, "/wrench"), ("FFFTTT", [""] * 6, "/signal"), ("jjjjjj", [""] * 6, "/signal")],
)
def test_six_axes_are_a_wrench_in_mcap_only_by_their_names(
    letters: str, units: Sequence[str], topic: str, tmp_path: Path
) -> None:
    """Torques of six joints or readings of fingers and thumbs, are no force along x; all come back with their names."""
    wrench = np.random.default_rng(0).normal(size=(2, 50, 6)).astype(np.float32)
    axes = tuple(f"{letter}{number}" for number, letter in enumerate(letters))
    made = Recordings.from_arrays(list(wrench), 200.0, axes=axes, units=units)
    export(DataSet.of(made), tmp_path / "out", "mcap")
    with (tmp_path / "out/000001.mcap").open("rb") as file:
        assert {channel.topic for channel in make_reader(file).get_summary().channels.values()} == {topic}
    import_source(tmp_path / "out", tmp_path / "again.zarr", "mcap")
    again = read_recordings(tmp_path / "again.zarr")
    assert again.axes == axes
    np.testing.assert_array_equal(again.wrench, wrench)


def test_an_export_in_a_folder_is_read_only_by_itself(tmp_path: Path) -> None:
    """One beside other recordings ended the whole import with a KeyError, and so did another program's file."""
    made = Recordings.from_arrays([np.random.default_rng(0).normal(size=(30, 6))], 20.0)
    (tmp_path / "runs").mkdir()
    export(DataSet.of(made), tmp_path / "runs" / "old", "csv")
    with pytest.raises(InputError, match=r"runs holds what rcbht export wrote \(old\); import each folder alone"):
        read_source(tmp_path / "runs")
    (tmp_path / "runs" / "day1").mkdir()
    (tmp_path / "runs" / "day1" / "dataset.json").write_text('{"robot": "ours"}')
    (tmp_path / "runs" / "day1" / "a.csv").write_text("t,Fz\n" + "".join(f"{k / 20},{k % 7}\n" for k in range(30)))
    imported = read_source(tmp_path / "runs")
    assert imported.report.imported == ["day1/a.csv"]
    assert any("1 folder that rcbht export wrote was not read: 'old'" in text for text in imported.report.remarks)


@pytest.mark.parametrize("change", ["order", "units", "none"])
def test_only_a_wrench_in_order_and_in_its_units_is_one_in_mcap(change: str, tmp_path: Path) -> None:
    """Fz, Fx, Fy were force.x, force.y, force.z, and kN were N."""
    axes = ["Fz", "Fx", "Fy", "Mz", "Mx", "My"] if change == "order" else list(AXES)
    units = ["kN"] * 3 + ["Nm"] * 3 if change == "units" else ["N"] * 3 + [""] * 3
    made = Recordings.from_arrays([np.random.default_rng(0).normal(size=(30, 6))], 20.0, axes=axes, units=units)
    export(DataSet.of(made), tmp_path / "out", "mcap")
    with open_bag(tmp_path / "out/000000.mcap") as bag:
        assert {one.topic for one in bag.connections} == {"/wrench" if change == "none" else "/signal"}
    back = read_source(tmp_path / "out").recordings
    assert (back.axes, back.units) == (made.axes, made.units)
    np.testing.assert_array_equal(back.wrench, made.wrench)


@pytest.mark.parametrize("kind", sorted(FORMATS))
def test_simulated_trials_stay_simulated(kind: str, tmp_path: Path) -> None:
    """They came back as recorded ones, and their table of the simulation was lost without a word."""
    seed = {"seed": np.arange(3)}
    write_recordings(tmp_path / "a.zarr", recordings(), {"simulated": {"seed": 1}}, simulation=seed)
    export(load(tmp_path / "a.zarr"), tmp_path / "out", kind)
    report = import_source(tmp_path / "out", tmp_path / "back.zarr", kind).report
    assert "but for labels and the table of the simulation." in report.remarks[0]
    assert "3 recordings of 3 simulated trials" in card(load(tmp_path / "back.zarr"), "")


@pytest.mark.parametrize("attrs", [{"importer": "hiro", "frames": "as logged"}, {"simulated": {"seed": 1}}])
def test_what_made_the_trials_and_their_frames_come_back(attrs: dict[str, Any], tmp_path: Path) -> None:
    """Words of HIRO's trials were made with other thresholds under the same name, and the card stated no frames."""
    made = Recordings.from_arrays([np.random.default_rng(0).normal(size=(30, 6))], 200.0)
    write_recordings(tmp_path / "a.zarr", made, attrs)
    export(load(tmp_path / "a.zarr"), tmp_path / "out", "csv")
    import_source(tmp_path / "out", tmp_path / "back.zarr")
    assert main(["encode", str(tmp_path / "back.zarr")]) == 0
    assert read_tracks_attrs(tmp_path / "back.zarr", "online-W5")["thresholds_from"]["robot"] == "hiro"
    frames = card(load(tmp_path / "back.zarr"), "")
    assert ("as logged" in frames) == ("frames" in attrs)
    about = json.loads((tmp_path / "out/dataset.json").read_text())
    for store in ({"importer": "", "frames": 1}, ["hiro"]):
        (tmp_path / "out/dataset.json").write_text(json.dumps(about | {"store": store}))
        assert {"importer", "frames"}.isdisjoint(read_source(tmp_path / "out").attrs)


def test_every_interval_of_every_track_is_an_event_in_mcap(tmp_path: Path) -> None:
    """Only those of the first track were, and of several that begin together the last."""
    rows = [(0, "phase", "push", 0.5, 1.0), (0, "contact", "touch", 0.5, 0.7), (0, "phase", "rest", 0.5, np.nan)]
    wrench = np.random.default_rng(0).normal(size=(40, 6))
    made = Recordings.from_arrays([wrench], 20.0, annotations=[*rows, (0, "phase", "late", 9.0, 9.5)])
    export(DataSet.of(made), tmp_path / "out", "mcap")
    with AnyReader([tmp_path / "out/000000.mcap"]) as bag:
        found = [
            (time / 1e9, json.loads(bag.deserialize(raw, connection.msgtype).json))
            for connection, time, raw in bag.messages([c for c in bag.connections if c.topic == "/events"])
        ]
    assert {at for at, one in found if one["label"] != "late"} == {0.5}
    marks = sorted((one["track"], one["label"], one["start"], one["end"]) for _, one in found)
    assert marks == [
        ("contact", "touch", 0.5, 0.7), ("phase", "late", 9.0, 9.5), ("phase", "push", 0.5, 1.0),
        ("phase", "rest", 0.5, None),
    ]  # fmt: skip
    assert len(read_source(tmp_path / "out").recordings.annotations) == 4


@pytest.mark.parametrize("kind", ["csv", "mcap", "parquet"])
def test_a_sorted_table_of_trials_still_says_which_signals_are_whose(kind: str, tmp_path: Path) -> None:
    """Sorted in a spreadsheet, it gave every outcome to the signals of another recording."""
    export(DataSet.of(recordings()), tmp_path / "out", kind)
    if kind == "parquet":
        trials = pd.read_parquet(tmp_path / "out/trials.parquet")
        trials.sort_values("outcome", ignore_index=True).to_parquet(tmp_path / "out/trials.parquet")
    else:
        header, *rows = (tmp_path / "out/trials.csv").read_text().splitlines(keepends=True)
        (tmp_path / "out/trials.csv").write_text("".join([header, *rows[::-1]]), encoding="utf-8-sig")
    same(read_source(tmp_path / "out").recordings, recordings())


@pytest.mark.parametrize(
    ("file", "lines", "sentence"),
    [
        ("trials.csv", [0, 1, 3], "does not number its recordings from 0 on"),
        ("trials.csv", [0, 1, 2], "000002.csv has no row in the table of trials"),
        ("wrench/000001.csv", range(40), "recording 1 has 39 samples; the table of trials states 50"),
        ("wrench/000001.csv", [0, *range(9, 51), *range(1, 9)], "the column sample is not that of an export"),
        ("wrench/000000.csv", None, "000000.csv: the column recording is not that of an export"),
    ],
)
def test_files_that_contradict_each_other_are_refused(
    file: str, lines: Sequence[int] | None, sentence: str, tmp_path: Path
) -> None:
    """Signals were taken for those of the next recording, and what was left of a cut file for all of it."""
    wrench = np.random.default_rng(0).normal(size=(3, 50, 6))
    export(DataSet.of(Recordings.from_arrays(list(wrench), 200.0)), tmp_path / "out", "csv")
    path = tmp_path / "out" / file
    if lines is None:
        path.write_bytes((path.parent / "000001.csv").read_bytes())
    else:
        found = path.read_text().splitlines(keepends=True)
        path.write_text("".join(found[line] for line in lines))
    with pytest.raises(InputError, match=sentence):
        read_source(tmp_path / "out")


def test_a_table_of_trials_with_other_separators_is_refused(tmp_path: Path) -> None:
    export(DataSet.of(recordings()), tmp_path / "out", "csv")
    path = tmp_path / "out" / "trials.csv"
    path.write_text(path.read_text().replace(",", ";"))
    with pytest.raises(InputError, match="no column recording; expected the columns as they were written"):
        read_source(tmp_path / "out")


@pytest.mark.parametrize(
    "changed",
    [lambda table: table.sort_values(["sample", "recording"]), lambda table: table.assign(recording=-1)],
    ids=["another order", "no recording"],
)
def test_parquet_signals_in_another_order_are_refused(tmp_path: Path, changed: Callable[[Any], Any]) -> None:
    export(DataSet.of(recordings()), tmp_path / "out", "parquet")
    path = tmp_path / "out" / "wrench.parquet"
    changed(pd.read_parquet(path)).to_parquet(path, index=False)
    with pytest.raises(InputError, match=r"wrench.parquet: the column recording is not that of an export"):
        read_source(tmp_path / "out")


@pytest.mark.parametrize(
    ("kind", "file", "groups"), [("parquet", "trials", 1), ("lerobot", "meta/episodes/chunk-000/file-000", 2)]
)
def test_parquet_keeps_every_text_and_type(
    kind: str, file: str, groups: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcbht_jax.io.export.lerobot.GROUP", 2)
    large = np.arange(2**64 - 4, 2**64, dtype=np.uint64)
    recordings = Recordings.from_arrays([np.ones((9, 6))] * 4, 100.0, texts=["a\0b", "\0c", "d", ""], large=large)
    export(DataSet.of(recordings), tmp_path / "out", kind)
    table = parquet.read_table(tmp_path / f"out/{file}.parquet")
    for column in ("texts", "large"):
        assert table[column].to_pylist() == recordings.columns[column].tolist()
    assert parquet.ParquetFile(tmp_path / f"out/{file}.parquet").num_row_groups == groups
