"""Data out: what another tool reads from an export is what the store holds; nothing is half-written or replaced."""

from __future__ import annotations

import csv
import dataclasses
import errno
import gc
import json
import resource
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from rcbht_jax._util.cells import text_of
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.export import FORMATS, Block, DataSet, export, load, tables
from rcbht_jax.io.export.dataset import codes_at_samples, states_at_samples
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.io.messages import Sample
from rcbht_jax.io.rosbags import read_bag
from rcbht_jax.io.store import write_recordings
from rcbht_jax.labels import AXES, LAYERS, name
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.robots.snap_assembly import RECORDED, snap_recordings
from rcbht_jax.types import Recordings
from tests.support.snaps import marked
from tests.support.store_cases import encoded_store, folder_is_clean, simple, some_fields

pd = pytest.importorskip("pandas")
pq = pytest.importorskip("pyarrow.parquet")

NAMES = ["Schnappen, »links«", 'a"b', "試行\n7"]
ONSETS = (0.0, 0.4, 0.9, np.nan)


def signals() -> Recordings:
    """Three recordings of different lengths with names that break careless writers."""
    rng = np.random.default_rng(0)
    length = np.array([400, 250, 333], np.int32)
    wrench = np.cumsum(rng.normal(size=(3, 400, 6)), 1).astype(np.float32) * 0.1
    for row, end in zip(wrench, length, strict=True):
        row[end:] = 0
    onset = np.tile(ONSETS, (3, 1))
    return marked(dataclasses.replace(
        simple(3, 400), wrench=wrench, length=length, trial=np.array(NAMES),
        outcome=np.array(["success", "failure", "unknown"]), arm=np.array(["R", "L", "R"]),
    ), onset, onset)  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encoded_store(tmp_path_factory.mktemp("export") / "set.zarr", signals(), {"made": "up"})


@pytest.fixture(scope="module")
def data(store: Path) -> DataSet:
    return load(store)


@pytest.fixture(scope="module")
def block(data: DataSet) -> Block:
    """All of the store, which fits into one block."""
    [block] = data.blocks()
    return block


def same_columns(found: Any, expected: tables.Table) -> None:
    """Values equal bit for bit, NaN equal to NaN, texts equal."""
    assert list(found.columns) == list(expected)
    for column, values in expected.items():
        got = found[column].to_numpy()
        if values.dtype.kind == "U":
            assert got.tolist() == values.tolist(), column
        else:
            assert got.dtype == values.dtype, column
            np.testing.assert_array_equal(got, values)


def whole_wrench(block: Block) -> tables.Table:
    parts = [tables.wrench(block, row) for row in range(len(block.recordings))]
    return {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}


def all_labels(block: Block) -> tables.Table:
    parts = list(tables.labels(block))
    return {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}


def test_tables_say_what_the_store_says(data: DataSet, block: Block) -> None:
    trials, labels = tables.trials(data.recordings), all_labels(block)
    assert trials["trial"].tolist() == NAMES
    marks = tables.intervals(data.recordings)
    rotation = (marks["track"] == RECORDED) & (marks["label"] == "rotation")
    np.testing.assert_array_equal(marks["start"][rotation], data.recordings.starts(RECORDED)[:, 1])
    assert block.tracks is not None
    assert len(labels["code"]) == sum(np.count_nonzero(getattr(block.tracks, layer).label) for layer in LAYERS)
    chosen = (labels["recording"] == 1) & (labels["layer"] == "llb") & (labels["axis"] == "My")
    track = block.tracks.llb
    assert labels["code"][chosen].tolist() == [c for c in track.label[1, 4].tolist() if c]
    np.testing.assert_array_equal(labels["avg"][chosen], track.avg[1, 4][track.label[1, 4] > 0])
    assert labels["label"][chosen].tolist() == [name("llb", c) for c in labels["code"][chosen].tolist()]


def test_codes_at_samples_are_what_was_known_then(block: Block) -> None:
    """Against the definition, label by label and sample by sample."""
    assert block.tracks is not None
    offline = encode_dataset(block.recordings)
    for tracks, online in ((block.tracks, True), (offline, False)):
        codes = codes_at_samples(tracks, 1, 250)
        for number, layer in enumerate(LAYERS):
            track = getattr(tracks, layer)
            for axis in range(6):
                expected = [0] * 250
                for slot in np.flatnonzero(track.label[1, axis]):
                    t0, t1, emit = (int(getattr(track, field)[1, axis, slot]) for field in ("t0", "t1", "emit"))
                    for sample in range(250):
                        if emit <= sample + 1 if online else t0 <= sample < t1:
                            expected[sample] = int(track.label[1, axis, slot])
                assert codes[:, number, axis].tolist() == expected
    assert states_at_samples(block.recordings, 0).tolist() == [0] * 80 + [1] * 100 + [2] * 220


def test_no_recording_is_in_two_row_groups(data: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcbht_jax.io.export.parquet.ROWS", 500)
    export(data, tmp_path / "out", "parquet")
    file = pq.ParquetFile(tmp_path / "out/wrench.parquet")
    assert [file.metadata.row_group(number).num_rows for number in range(file.num_row_groups)] == [650, 333]


def test_parquet_opens_in_pandas(data: DataSet, block: Block, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export(data, out, "parquet")
    same_columns(pd.read_parquet(out / "trials.parquet"), tables.trials(data.recordings))
    same_columns(pd.read_parquet(out / "annotations.parquet"), tables.intervals(data.recordings))
    same_columns(pd.read_parquet(out / "wrench.parquet"), whole_wrench(block))
    same_columns(pd.read_parquet(out / "labels.parquet"), all_labels(block))
    file = pq.ParquetFile(out / "wrench.parquet")
    assert float(file.schema_arrow.metadata[b"dt_seconds"]) == data.recordings.dt
    assert json.loads((out / "dataset.json").read_text())["store"]["made"] == "up"


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(some_fields())
def test_any_recordings_survive_parquet_and_csv(fields: dict[str, Any]) -> None:
    recordings = snap_recordings(**fields)
    with tempfile.TemporaryDirectory() as folder:
        export(DataSet.of(recordings), Path(folder) / "p", "parquet")
        same_columns(pd.read_parquet(Path(folder) / "p/trials.parquet"), tables.trials(recordings))
        same_columns(pd.read_parquet(Path(folder) / "p/wrench.parquet"), whole_wrench(Block(recordings, None)))
        export(DataSet.of(recordings), Path(folder) / "c", "csv")
        same_text(Path(folder) / "c/trials.csv", tables.trials(recordings))
        for row in range(len(recordings)):
            same_text(Path(folder) / f"c/wrench/{row:06d}.csv", tables.wrench(Block(recordings, None), row))


def same_text(path: Path, expected: tables.Table) -> None:
    """A CSV file, read by the standard library, is this table."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == list(expected)
    for (column, values), texts in zip(expected.items(), zip(*rows[1:], strict=True), strict=True):
        if values.dtype.kind == "U":
            assert [text_of(text) for text in texts] == values.tolist(), column
            assert not any(text.startswith(("=", "@", "\t", "\r")) for text in texts), column
        else:
            got = np.array([text or "nan" for text in texts]).astype(values.dtype)
            np.testing.assert_array_equal(got, values)


def test_csv_opens_in_pandas(data: DataSet, block: Block, tmp_path: Path) -> None:
    export(data, tmp_path / "out", "csv")
    trials = pd.read_csv(tmp_path / "out/trials.csv", keep_default_na=False)
    assert trials["trial"].tolist() == NAMES
    marks = pd.read_csv(tmp_path / "out/annotations.csv")
    assert marks["label"].tolist() == tables.intervals(data.recordings)["label"].tolist()
    assert pd.read_csv(tmp_path / "out/wrench/000001.csv").shape == (250, 9)
    assert pd.read_csv(tmp_path / "out/labels.csv")["label"].tolist() == all_labels(block)["label"].tolist()


def test_mcap_opens_in_its_own_reader(data: DataSet, block: Block, tmp_path: Path) -> None:
    export(data, tmp_path / "out", "mcap")
    folder_is_clean(
        tmp_path / "out",
        "000000.mcap",
        "000001.mcap",
        "000002.mcap",
        "trials.csv",
        "annotations.csv",
        "README.md",
        "dataset.json",
    )
    values, events, last = [], [], None
    with (tmp_path / "out/000001.mcap").open("rb") as file:
        for _, channel, message, ros in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic == "/wrench":
                values.append([getattr(part, a) for part in (ros.wrench.force, ros.wrench.torque) for a in "xyz"])
                assert message.log_time == round((len(values) - 1) * 5e6)
            elif channel.topic == "/events":
                events.append((message.log_time / 1e9, json.loads(ros.json)["label"]))
            else:
                last = [list(getattr(ros, layer)) for layer in LAYERS]
    np.testing.assert_array_equal(np.array(values, np.float32), block.recordings.wrench[1, :250])
    once = [(0.0, "approach"), (0.4, "rotation"), (0.4, "rotation+insertion"), (0.9, "insertion")]
    assert sorted(set(events)) == once
    assert len(events) == len(block.recordings.annotations.of_recording(1)) > len(once)
    again = [message.wrench for message in read_bag(tmp_path / "out/000001.mcap") if isinstance(message, Sample)]
    np.testing.assert_array_equal(np.array(again, np.float32), block.recordings.wrench[1, :250])
    assert block.tracks is not None
    assert last == codes_at_samples(block.tracks, 1, 250)[-1].tolist()


def test_lerobot_layout(data: DataSet, block: Block, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export(data, out, "lerobot")
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 200, 983)
    episodes = pd.read_parquet(out / "meta/episodes/chunk-000/file-000.parquet")
    frames = pd.read_parquet(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(frames.columns) == set(info["features"])
    assert frames["index"].tolist() == list(range(983))
    tasks = pd.read_parquet(out / "meta/tasks.parquet")
    assert tasks.index.tolist() == ["set"]
    for row, episode in episodes.iterrows():
        part = frames[episode["dataset_from_index"] : episode["dataset_to_index"]]
        samples = int(data.recordings.length[row])
        assert (part["episode_index"] == row).all()
        np.testing.assert_array_equal(np.stack(part["observation.wrench"]), block.recordings.wrench[row, :samples])
        assert part["next.done"].tolist() == [False] * (samples - 1) + [True]
        assert (episode["trial"], episode["length"]) == (NAMES[row], samples)
    everything = np.stack(frames["observation.wrench"]).astype(np.float64)
    stats = json.loads((out / "meta/stats.json").read_text())["observation.wrench"]
    for what in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(stats[what], getattr(np, what)(everything, axis=0), rtol=1e-9)
    assert stats["count"] == [983]


def test_lerobot_frames_match_their_features(data: DataSet, tmp_path: Path) -> None:
    """Types on disk are those that info.json promises, as its reader demands."""
    export(data, tmp_path / "out", "lerobot")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    schema = pq.read_schema(tmp_path / "out/data/chunk-000/file-000.parquet")
    for feature, kind in info["features"].items():
        field = schema.field(feature).type
        element = {"float": "float32", "bool": "bool"}
        if kind["shape"] == [1]:
            assert element.get(str(field), str(field)) == kind["dtype"]
        else:
            assert field.list_size == kind["shape"][0]
            assert element.get(str(field.value_type), str(field.value_type)) == kind["dtype"]


def test_lerobot_starts_another_file_when_one_is_full(
    data: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcbht_jax.io.export.lerobot.FILE_BYTES", 1)
    monkeypatch.setattr("rcbht_jax.io.export.lerobot.CHUNK", 2)
    export(data, tmp_path / "out", "lerobot")
    found = sorted(str(path.relative_to(tmp_path / "out/data")) for path in (tmp_path / "out/data").rglob("*.parquet"))
    assert found == ["chunk-000/file-000.parquet", "chunk-000/file-001.parquet", "chunk-001/file-000.parquet"]
    episodes = pd.read_parquet(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")
    assert episodes["data/chunk_index"].tolist() == [0, 0, 1]
    assert episodes["data/file_index"].tolist() == [0, 1, 0]


def test_lerobot_refuses_a_broken_rate(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="whole number of frames"):
        export(DataSet.of(dataclasses.replace(simple(), dt=0.0033)), tmp_path / "out", "lerobot")
    folder_is_clean(tmp_path)


@pytest.mark.parametrize("field", ["attrs", "tracks_attrs"])
def test_an_origin_that_cannot_be_written_is_one_sentence(field: str, tmp_path: Path) -> None:
    odd = dataclasses.replace(DataSet.of(simple()), **{field: {"note": "half a pair: \ud800"}})
    with pytest.raises(InputError, match="not valid Unicode"):
        export(odd, tmp_path / "out", "csv")
    folder_is_clean(tmp_path)


@pytest.mark.parametrize("kind", FORMATS)
def test_nothing_is_replaced_and_nothing_is_half_written(
    kind: str, data: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        export(data, tmp_path / "mine", kind)

    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("rcbht_jax.io.export.card.card", full)  # the last file: everything else is written by then
        with pytest.raises(OSError, match="No space"):
            export(data, tmp_path / "out", kind)
    with monkeypatch.context() as patch:
        patch.setattr("rcbht_jax.io.export.card.description", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            export(data, tmp_path / "out", kind)
    folder_is_clean(tmp_path, "mine")
    assert (tmp_path / "mine").read_text() == "precious"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # files of libraries that cannot close
@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_that_cannot_grow_leaves_nothing(kind: str, data: DataSet, tmp_path: Path) -> None:
    """The system itself refuses to write, at several places."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (10, 2_000, 8_000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        try:
            with pytest.raises((OSError, ValueError)):
                export(data, tmp_path / "out", kind)
        finally:
            gc.collect()
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        folder_is_clean(tmp_path)


def test_card_counts_and_warns(data: DataSet, tmp_path: Path) -> None:
    twice = dataclasses.replace(
        simple(4, 400), wrench=np.repeat(signals().wrench[:1], 4, 0), length=np.array([400, 400, 200, 199], np.int32),
        outcome=np.repeat(["success", "failure"], 2), session=np.repeat(["A", "B"], 2),
    )  # fmt: skip
    twice.wrench[2, 200:] = twice.wrench[3, 199:] = 0
    export(DataSet.of(twice), tmp_path / "out", "csv")
    text = (tmp_path / "out/README.md").read_text()
    assert "| set | A | success | R | 2 | 2.00 / 2.00 / 2.00 |" in text
    assert "Task outcome: No session holds more than one class: A (success), B (failure);" in text
    assert "with a balanced accuracy of 100%" in text
    assert "Exact copies of another recording: 1;" in text
    assert "Licence:** not stated yet" in text
    export(data, tmp_path / "labelled", "csv")
    assert "`online-W5` (online taxonomy, windows of 5 samples)" in (tmp_path / "labelled/README.md").read_text()


def test_command(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["export", str(store), "-o", str(tmp_path / "out"), "--format", "csv"]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["recordings"], result["tracks"]) == (3, "online-W5")
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words[:3], str(tmp_path / "now"), "--format", "csv", "--window", "5"]) == 0  # the same thresholds
    assert (tmp_path / "now/labels.csv").read_bytes() == (tmp_path / "out/labels.csv").read_bytes()
    assert main(["export", str(store), "-o", str(tmp_path / "no/such/out")]) == 2
    assert main(["export", str(store), "-o", str(tmp_path / "b"), "--tracks", "other"]) == 2
    assert main(["export", str(store), "-o", str(tmp_path / "b"), "--tracks", "online-W5", "--window", "5"]) == 2
    assert "not both" in capsys.readouterr().err


def test_labels_can_be_made_on_the_way(store: Path, block: Block, tmp_path: Path) -> None:
    plain = tmp_path / "plain.zarr"
    write_recordings(plain, signals(), {})
    assert load(plain).tracks_name == ""
    assert [some.tracks for some in load(plain).blocks()] == [None]
    thresholds = np.array(load(store).tracks_attrs["thresholds"])
    [made] = load(plain, window=5, thresholds=thresholds).blocks()
    for layer in LAYERS:
        np.testing.assert_array_equal(getattr(made.tracks, layer).label, getattr(block.tracks, layer).label)
    fitted = load(plain, window=5, rule="fit", tolerance=(0.5,))
    assert fitted.tracks_name == "online-W5-fit"
    assert (fitted.tracks_attrs["config"]["rule"], fitted.tracks_attrs["config"]["tolerance"]) == ("fit", [0.5] * 6)
    [words] = fitted.blocks()
    assert not np.array_equal(words.tracks.primitive.label, made.tracks.primitive.label)
    for options in ({"rule": "fit"}, {"tolerance": (1.0,)}, {"window": 5, "tolerance": (1.0,)},
                    {"window": 5, "rule": "fit", "tolerance": (1.0, 2.0)}):  # fmt: skip
        with pytest.raises(InputError):
            load(plain, **options)
    assert block.tracks is not None
    write_tracks(plain, "a", block.tracks, {})
    write_tracks(plain, "b", block.tracks, {})
    with pytest.raises(InputError, match="several label tracks"):
        load(plain)
    assert load(plain, "b").tracks_name == "b"


def test_simulation_becomes_columns(tmp_path: Path) -> None:
    path = tmp_path / "sim.zarr"
    parameters = {"seed": np.arange(3), "pose": np.arange(6.0).reshape(3, 2), "fault": np.array(["none", "", "é"])}
    write_recordings(path, signals(), {"simulated": {}}, simulation=parameters)
    export(load(path), tmp_path / "out", "parquet")
    found = pd.read_parquet(tmp_path / "out/simulation.parquet")
    assert found["pose[1]"].tolist() == [1.0, 3.0, 5.0]
    assert found["fault"].tolist() == ["none", "", "é"]
    assert AXES[0] not in found
    export(load(path), tmp_path / "mcap", "mcap")
    assert (tmp_path / "mcap/simulation.csv").is_file()
    export(load(path), tmp_path / "lerobot", "lerobot")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "lerobot/simulation.parquet"), found)
    assert "`simulation.parquet`" in (tmp_path / "lerobot/README.md").read_text()
    assert "`simulation.csv`" in (tmp_path / "mcap/README.md").read_text()
