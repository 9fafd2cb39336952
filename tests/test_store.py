"""The store: what goes in comes out, damage is found, an interrupted write leaves nothing."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import given, settings

from rcbht_jax.data import store, tracks, zarrio
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

WORDS = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\x00"), max_size=6)


@st.composite
def some_recordings(draw: st.DrawFn) -> Recordings:
    count, samples = draw(st.integers(1, 4)), draw(st.integers(1, 30))
    length = draw(hnp.arrays(np.int32, count, elements=st.integers(1, samples)))
    finite = st.floats(-1e5, 1e5, width=32)
    wrench = draw(hnp.arrays(np.float32, (count, samples, 6), elements=finite))
    for row, end in zip(wrench, length, strict=True):
        row[end:] = 0
    numbers = st.one_of(st.floats(-1e3, 1e3), st.just(np.nan))

    def words(elements: st.SearchStrategy[str]) -> np.ndarray:
        return np.array(draw(st.lists(elements, min_size=count, max_size=count)), np.str_)

    onset, better, deviation = (draw(hnp.arrays(np.float64, (count, width), elements=numbers)) for width in (4, 4, 3))
    return Recordings(
        wrench=wrench,
        length=length,
        dt=draw(st.floats(1e-4, 1.0)),
        onset=onset,
        onset_harmonised=better,
        trial=words(WORDS),
        arm=words(st.sampled_from(["R", "L"])),
        source=words(WORDS),
        session=words(WORDS),
        outcome=words(st.sampled_from(store.OUTCOMES)),
        failure_type=words(WORDS),
        deviation=deviation,
        note=words(WORDS),
    )


def simple(count: int = 3, samples: int = 50) -> Recordings:
    """Recordings with random wrenches, all of full length."""
    name = np.array([f"t{k}" for k in range(count)])
    return Recordings(
        wrench=np.random.default_rng(0).normal(size=(count, samples, 6)).astype(np.float32),
        length=np.full(count, samples, np.int32),
        dt=0.005,
        onset=np.tile([0.0, 0.1, 0.15, np.nan], (count, 1)),
        onset_harmonised=np.tile([0.0, 0.1, 0.15, np.nan], (count, 1)),
        trial=name,
        arm=np.full(count, "R"),
        source=np.full(count, "set"),
        session=np.full(count, "A"),
        outcome=np.full(count, "success"),
        failure_type=np.full(count, ""),
        deviation=np.full((count, 3), np.nan),
        note=np.full(count, ""),
    )


def same(one: Recordings, two: Recordings) -> None:
    for field in dataclasses.fields(Recordings):
        left, right = np.asarray(getattr(one, field.name)), np.asarray(getattr(two, field.name))
        assert left.dtype.kind == right.dtype.kind
        assert left.shape == right.shape
        # Bit for bit: the sign of zero counts, the width of a string's dtype does not.
        assert zarrio.content_hash([left]) == zarrio.content_hash([right]), field.name


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "trials.zarr"
    store.write_recordings(path, simple(), {})
    return path


def folder_is_clean(folder: Path, *expected: str) -> None:
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(expected)


def test_every_field_has_a_variable() -> None:
    fields = {field.name for field in dataclasses.fields(Recordings)}
    assert fields == {spec[0] for spec in store.VARIABLES.values()} | {"dt"}


@given(some_recordings())
def test_round_trip(recordings: Recordings) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.zarr"
        store.write_recordings(path, recordings, {"engine": "none"})
        same(store.read_recordings(path), recordings)
        attrs = store.read_attrs(path)
        assert attrs["engine"] == "none"
        assert attrs["dt"] == recordings.dt
        folder_is_clean(Path(folder), "x.zarr")


def test_the_sign_of_zero_survives(tmp_path: Path) -> None:
    zeros = dataclasses.replace(simple(), wrench=np.full((3, 50, 6), -0.0, np.float32))
    store.write_recordings(tmp_path / "x.zarr", zeros, {})
    same(store.read_recordings(tmp_path / "x.zarr"), zeros)


def test_xarray_reads_it_without_a_warning(path: Path) -> None:
    data = xr.open_zarr(path)
    assert data["wrench"].dims == ("trial", "time", "axis")
    assert data["wrench"].dtype == np.float32
    assert data["axis"].values.tolist() == list(AXES)
    np.testing.assert_array_equal(data["wrench"].values, simple().wrench)
    np.testing.assert_array_equal(data["onset"].values, simple().onset)
    assert data["trial_name"].values.tolist() == ["t0", "t1", "t2"]
    assert float(data["dt"]) == data.attrs["dt"] == 0.005


def test_chunks_are_sharded_compressed_and_checksummed(tmp_path: Path) -> None:
    store.write_recordings(tmp_path / "big.zarr", simple(300, 2000), {})
    array = store.open_store(tmp_path / "big.zarr")["wrench"]
    assert array.chunks[1:] == (2000, 6)
    assert array.chunks[0] < 300
    assert array.shards[0] % array.chunks[0] == 0
    codecs = str(array.metadata.codecs)
    assert "Zstd" in codecs
    assert codecs.count("Crc32c") == 2


def test_nothing_is_replaced_unasked(path: Path) -> None:
    before = (path / "zarr.json").read_bytes()
    with pytest.raises(InputError, match="exists already"):
        store.write_recordings(path, simple(), {})
    assert (path / "zarr.json").read_bytes() == before


def test_overwriting_replaces_the_whole_store(path: Path) -> None:
    store.write_recordings(path, simple(5), {}, overwrite=True)
    assert len(store.read_recordings(path)) == 5
    folder_is_clean(path.parent, "trials.zarr")


def test_only_a_store_is_ever_deleted(tmp_path: Path, path: Path) -> None:
    precious = tmp_path / "thesis"
    precious.mkdir()
    (precious / "chapter1.tex").write_text("...")
    (tmp_path / "file").write_text("...")
    (tmp_path / "link").symlink_to(path)
    for name in ("thesis", "file", "link"):
        with pytest.raises(InputError, match="not a store made by rcbht"):
            store.write_recordings(tmp_path / name, simple(), {}, overwrite=True)
    assert (precious / "chapter1.tex").exists()
    same(store.read_recordings(path), simple())


@pytest.mark.parametrize("path", [Path(""), Path("/"), Path("no/such/folder/x.zarr")])
def test_impossible_places(path: Path) -> None:
    with pytest.raises(InputError, match=r"not a name|not a folder"):
        store.check_target(path, False)


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", [OSError, KeyboardInterrupt])
def test_an_interrupted_write_leaves_no_half_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overwrite: bool, kind: type[BaseException]
) -> None:
    path = tmp_path / "trials.zarr"
    if overwrite:
        store.write_recordings(path, simple(), {})
    real = zarrio.write_array
    calls: list[str] = []

    def failing(group: Any, name: str, *rest: Any) -> None:
        calls.append(name)
        if len(calls) == 5:
            raise kind("stopped")
        real(group, name, *rest)

    monkeypatch.setattr(zarrio, "write_array", failing)
    with pytest.raises(kind):
        store.write_recordings(path, simple(7), {}, overwrite=overwrite)
    folder_is_clean(tmp_path, *(["trials.zarr"] if overwrite else []))
    if overwrite:
        same(store.read_recordings(path), simple())


def test_a_killed_write_leaves_no_half_store(tmp_path: Path) -> None:
    code = """
import os, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from test_store import simple
from rcbht_jax.data import store, zarrio
real, count = zarrio.write_array, []
def dying(*args):
    count.append(1)
    if len(count) == 5:
        os.kill(os.getpid(), 9)
    real(*args)
zarrio.write_array = dying
store.write_recordings(Path(sys.argv[1]), simple(), {})
"""
    path = tmp_path / "trials.zarr"
    done = subprocess.run([sys.executable, "-c", code, str(path), str(Path(__file__).parent)], check=False)
    assert done.returncode == -9
    assert not path.exists()
    store.write_recordings(path, simple(), {})
    same(store.read_recordings(path), simple())


def test_ctrl_c_waits_for_the_array_being_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    real = zarr.Group.create_array

    def pressing(self: zarr.Group, name: str, **options: Any) -> Any:
        if name == "onset":
            os.kill(os.getpid(), signal.SIGINT)
        array = real(self, name, **options)
        done.append(name)
        return array

    monkeypatch.setattr(zarr.Group, "create_array", pressing)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        store.write_recordings(tmp_path / "x.zarr", simple(), {})
    assert done == ["wrench", "length", "onset"]
    assert signal.getsignal(signal.SIGINT) is handler
    folder_is_clean(tmp_path)


def files(path: Path) -> Iterator[Path]:
    return (entry for entry in sorted(path.rglob("*")) if entry.is_file())


def test_every_lost_cut_or_changed_file_is_found(path: Path) -> None:
    silent, sentences = set(), []
    for entry in list(files(path)):
        whole = entry.read_bytes()
        third = len(whole) // 3
        flipped = whole[:third] + bytes([whole[third] ^ 1]) + whole[third + 1 :]
        for change in (None, whole[: len(whole) // 2], *([] if entry.name == "zarr.json" else [flipped])):
            entry.unlink() if change is None else entry.write_bytes(change)
            try:
                same(store.read_recordings(path), simple())
                silent.add(str(entry.relative_to(path)))
            except InputError as error:
                sentences.append(str(error))
            entry.write_bytes(whole)
    assert all(re.search("damaged|incomplete|not a Zarr group", sentence) for sentence in sentences)
    # The axes are fixed and never read; a lost chunk of empty strings reads as empty strings.
    assert silent <= {"axis/zarr.json", "axis/c/0", "failure_type/c/0", "note/c/0"}


def test_foreign_folders_are_one_sentence(tmp_path: Path, path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        store.read_recordings(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="not a Zarr group"):
        store.read_recordings(tmp_path / "empty")
    zarrio.create_group(tmp_path / "other.zarr", {"title": "someone else's"})
    with pytest.raises(InputError, match="not a store of recordings"):
        store.read_recordings(tmp_path / "other.zarr")
    shutil.copytree(path, tmp_path / "future.zarr")
    text = (path / "zarr.json").read_text().replace('"format_version": 1', '"format_version": 9')
    (tmp_path / "future.zarr" / "zarr.json").write_text(text)
    with pytest.raises(InputError, match="format version 9; expected 1"):
        store.read_recordings(tmp_path / "future.zarr")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wrench": np.zeros((0, 5, 6), np.float32)}, "none of them 0"),
        ({"wrench": np.zeros((3, 50, 5), np.float32)}, "none of them 0"),
        ({"length": np.array([50, 0, 50], np.int32)}, r"recording 1 \(t1\): length is 0"),
        ({"length": np.array([50, 50, 51], np.int32)}, r"recording 2 \(t2\): length is 51"),
        ({"length": np.array([50, 50, 49], np.int32)}, "not zero; expected zero padding"),
        ({"length": np.full(2, 50, np.int32)}, "length is int32 of shape"),
        ({"wrench": np.full((3, 50, 6), np.nan, np.float32)}, "not finite"),
        ({"onset": np.zeros((3, 5))}, "onset is float64 of shape"),
        ({"dt": 0.0}, "dt is 0.0"),
        ({"arm": np.full(3, "X")}, "arm is 'X'"),
        ({"outcome": np.full(3, "meh")}, "outcome is 'meh'"),
    ],
)
def test_contradictory_recordings_are_refused(tmp_path: Path, change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        store.write_recordings(tmp_path / "x.zarr", dataclasses.replace(simple(), **change), {})
    folder_is_clean(tmp_path)


def test_attributes_must_be_json(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be stored as JSON"):
        store.write_recordings(tmp_path / "x.zarr", simple(), {"a": np.nan})
    folder_is_clean(tmp_path)


def label_tracks(seed: int = 0, count: int = 3, slots: int = 4) -> LabelTracks:
    rng = np.random.default_rng(seed)

    def layer(slots: int) -> LabelTrack:
        shape = (count, 6, slots)
        whole = {name: rng.integers(-1, 9, shape).astype(np.int32) for name in ("t0", "t1", "emit")}
        real = {name: rng.normal(size=shape).astype(np.float32) for name in ("vmax", "vmin", "avg", "grad")}
        return LabelTrack(label=rng.integers(0, 9, shape).astype(np.int8), **whole, **real)

    return LabelTracks(primitive=layer(slots), mc=layer(max(1, slots - 1)), llb=layer(1))


def same_tracks(one: LabelTracks, two: LabelTracks) -> None:
    for layer in ("primitive", "mc", "llb"):
        for field in dataclasses.fields(LabelTrack):
            left = getattr(getattr(one, layer), field.name)
            right = getattr(getattr(two, layer), field.name)
            np.testing.assert_array_equal(left, right, strict=True)


@settings(max_examples=6)
@given(seed=st.integers(0, 99), slots=st.integers(1, 9))
def test_tracks_round_trip(seed: int, slots: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.zarr"
        store.write_recordings(path, simple(), {})
        tracks.write_tracks(path, "online-W5", label_tracks(seed, slots=slots), {"window": 5})
        got, attrs = tracks.read_tracks(path, "online-W5")
        same_tracks(got, label_tracks(seed, slots=slots))
        assert attrs["window"] == 5
        folder_is_clean(Path(folder), "x.zarr")


def test_tracks_join_the_store(path: Path) -> None:
    assert tracks.list_tracks(path) == []
    tracks.write_tracks(path, "online-W5", label_tracks(1), {})
    tracks.write_tracks(path, "offline-master", label_tracks(2), {})
    assert tracks.list_tracks(path) == ["offline-master", "online-W5"]
    same_tracks(tracks.read_tracks(path, "online-W5")[0], label_tracks(1))
    same(store.read_recordings(path), simple())
    assert xr.open_zarr(path)["wrench"].shape == (3, 50, 6)
    layer = xr.open_zarr(path, group="labels/online-W5/mc")
    assert layer["label"].dims == ("trial", "axis", "slot")
    np.testing.assert_array_equal(layer["label"].values, label_tracks(1).mc.label)


@pytest.mark.parametrize(
    ("name", "count", "sentence"),
    [
        ("../escape", 3, "not a name"),
        ("", 3, "not a name"),
        (".hidden", 3, "not a name"),
        ("taken", 3, "has label tracks taken already"),
        ("other", 2, "expected \\[3 recordings"),
    ],
)
def test_wrong_tracks_are_refused(path: Path, name: str, count: int, sentence: str) -> None:
    tracks.write_tracks(path, "taken", label_tracks(), {})
    with pytest.raises(InputError, match=sentence):
        tracks.write_tracks(path, name, label_tracks(count=count), {})
    assert tracks.list_tracks(path) == ["taken"]


def test_track_dtypes_are_checked(path: Path) -> None:
    good = label_tracks()
    wrong = dataclasses.replace(good, mc=dataclasses.replace(good.mc, label=good.mc.label.astype(np.int64)))
    with pytest.raises(InputError, match="mc label is int64"):
        tracks.write_tracks(path, "x", wrong, {})


def test_missing_and_damaged_tracks(path: Path) -> None:
    with pytest.raises(InputError, match="no label tracks x; it has: none"):
        tracks.read_tracks(path, "x")
    tracks.write_tracks(path, "x", label_tracks(), {})
    for entry in list(files(path / "labels" / "x")):
        whole = entry.read_bytes()
        entry.unlink()
        with pytest.raises(InputError, match=r"damaged|incomplete|not a Zarr group"):
            tracks.read_tracks(path, "x")
        entry.write_bytes(whole)
    same_tracks(tracks.read_tracks(path, "x")[0], label_tracks())


def test_interrupted_tracks_leave_the_store_as_it_was(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = zarrio.write_array

    def failing(group: Any, name: str, *rest: Any) -> None:
        if name == "grad":
            raise OSError("stopped")
        real(group, name, *rest)

    monkeypatch.setattr(zarrio, "write_array", failing)
    with pytest.raises(OSError, match="stopped"):
        tracks.write_tracks(path, "x", label_tracks(), {})
    assert tracks.list_tracks(path) == []
    folder_is_clean(path.parent, "trials.zarr")
    same(store.read_recordings(path), simple())
