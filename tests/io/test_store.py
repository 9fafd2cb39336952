"""The store: what goes in comes out, damage is found, an interrupted write leaves nothing."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import given

from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import chunk_reader, parts, store, store_reader, store_schema
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.summary import COUNTING
from rcbht_jax.labels import AXES
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from tests.support.store_cases import files, folder_is_clean, same, simple, some_fields


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "trials.zarr"
    store.write_recordings(path, simple(), {})
    return path


def test_every_field_is_stored() -> None:
    fields = {field.name for field in dataclasses.fields(Recordings)}
    assert fields == {*store.VARIABLES, "dt", "axes", "units", "annotations", "columns"}


@given(some_fields())
def test_round_trip(fields: dict[str, Any]) -> None:
    recordings = snap_recordings(**fields)
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


def test_long_texts_are_in_parts_that_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part of short recordings with one long text each was written, and then taken for a bomb."""
    monkeypatch.setattr(store_schema, "PART_BYTES", 2**18)
    monkeypatch.setattr(chunk_reader, "SMALL", 2**18)
    text = np.full(600, "of all recordings " * 50)
    made = Recordings.from_arrays([np.full((3, 6), n) for n in range(600)], 200.0, remark=text, note=text)
    store.write_recordings(tmp_path / "a.zarr", made, {})
    same(store.read_recordings(tmp_path / "a.zarr"), made)


def test_xarray_reads_it_without_a_warning(path: Path) -> None:
    data = xr.open_zarr(path)
    assert data["wrench"].dims == ("trial", "time", "axis")
    assert data["wrench"].dtype == np.float32
    assert data["axis"].values.tolist() == list(AXES)
    np.testing.assert_array_equal(data["wrench"].values, simple().wrench)
    np.testing.assert_array_equal(data["length"].values, simple().length)
    assert data["trial"].values.tolist() == ["t0", "t1", "t2"]
    np.testing.assert_allclose(data["time"].values, np.arange(50) * 0.005)
    assert float(data["dt"]) == data.attrs["dt"] == 0.005
    marks = xr.open_zarr(path, group="annotations")
    assert marks["label"].dims == ("trial", "interval")
    labels = [(track, name) for track, names in data.attrs["annotation_labels"].items() for name in ["", *names]]
    assert ("states", "approach") in labels
    tracks = list(data.attrs["annotation_labels"])
    codes = zip(marks["track"].values[0].tolist(), marks["label"].values[0].tolist(), strict=True)
    found = {data.attrs["annotation_labels"][tracks[track - 1]][label - 1] for track, label in codes}
    assert found == {"approach", "rotation", "insertion", "rotation+insertion"}


def test_chunks_are_sharded_compressed_and_checksummed(tmp_path: Path) -> None:
    store.write_recordings(tmp_path / "big.zarr", simple(300, 2000), {})
    array = store.open_store(tmp_path / "big.zarr")["wrench"]
    assert array.chunks == (16, 512, 6)
    assert array.shards == (512, 4096, 6)
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
    for name in ("thesis", "file"):
        with pytest.raises(InputError, match="not a store made by rcbht"):
            store.write_recordings(tmp_path / name, simple(), {}, overwrite=True)
    assert (precious / "chapter1.tex").exists()
    same(store.read_recordings(path), simple())


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["trials.zarr", "none.zarr"])
def test_a_link_is_never_replaced(name: str, overwrite: bool, path: Path) -> None:
    link = path.with_name("link")
    link.symlink_to(name)
    with pytest.raises(InputError, match=f"link is a link; name the place that it leads to: {path.with_name(name)}"):
        store.write_recordings(link, simple(5), {}, overwrite=overwrite)
    assert link.is_symlink()
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
    real = parts.write_array
    calls: list[str] = []

    def failing(group: Any, name: str, *rest: Any) -> None:
        calls.append(name)
        if len(calls) == 5:
            raise kind("stopped")
        real(group, name, *rest)

    monkeypatch.setattr(parts, "write_array", failing)
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
from tests.support.store_cases import simple
from rcbht_jax.io import parts, store
real, count = parts.write_array, []
def dying(*args):
    count.append(1)
    if len(count) == 5:
        os.kill(os.getpid(), 9)
    real(*args)
parts.write_array = dying
store.write_recordings(Path(sys.argv[1]), simple(), {})
"""
    path = tmp_path / "trials.zarr"
    done = subprocess.run([sys.executable, "-c", code, str(path), str(Path(__file__).parents[2])], check=False)
    assert done.returncode == -9
    assert not path.exists()
    store.write_recordings(path, simple(), {})
    same(store.read_recordings(path), simple())


def test_ctrl_c_waits_for_the_array_being_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    real = zarr.Group.create_array

    def pressing(self: zarr.Group, name: str, **options: Any) -> Any:
        if name == "arm":
            os.kill(os.getpid(), signal.SIGINT)
        array = real(self, name, **options)
        done.append(name)
        return array

    monkeypatch.setattr(zarr.Group, "create_array", pressing)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        store.write_recordings(tmp_path / "x.zarr", simple(), {})
    assert done == ["wrench", "length", "trial", "arm"]
    assert signal.getsignal(signal.SIGINT) is handler
    folder_is_clean(tmp_path)


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
    assert [s for s in sentences if not re.search("damaged|incomplete|not a Zarr group", s)] == []
    # Times and period are read from the attributes, counts are read where they are told, and a lost chunk of empty
    # strings reads as empty strings.
    unread = {f"{name}/{file}" for name in ("time", "dt", "part_summary") for file in ("zarr.json", "c", "c/0")}
    assert silent <= {*unread, "columns/failure_type/c/0", "note/c/0"}


def test_counts_of_other_recordings_are_found(path: Path) -> None:
    """What "rcbht info" tells is what is in the store."""
    counts: Any = zarr.open_group(path, mode="r+")["part_summary"]
    text = str(counts[0])
    for other in (text.replace("success", "failure"), "{}", "[" * 60_000, "{"):
        counts[0] = other
        with pytest.raises(InputError, match="damaged"):
            store.verify(path)
    counts[0] = text
    store.verify(path)


def test_counts_of_another_version_are_not_compared(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later program that counts something else finds no damage; the first stores said nothing of what they count."""
    counts: Any = zarr.open_group(path, mode="r+")["part_summary"]
    first = json.loads(str(counts[0]))
    assert first.pop("counting") == COUNTING
    counts[0] = json.dumps(first)
    store.verify(path)
    monkeypatch.setattr(store_reader, "COUNTING", COUNTING + 1)
    monkeypatch.setattr(store_reader, "summary_of", lambda recordings: {"other": 1})
    store.verify(path)
    counts[0] = json.dumps({"counting": COUNTING + 1, **first})
    with pytest.raises(InputError, match="the summary of part 0"):
        store.verify(path)


def test_foreign_folders_are_one_sentence(tmp_path: Path, path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        store.read_recordings(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="not a Zarr group"):
        store.read_recordings(tmp_path / "empty")
    zarr_io.create_group(tmp_path / "other.zarr", {"title": "someone else's"})
    with pytest.raises(InputError, match="not a store of recordings"):
        store.read_recordings(tmp_path / "other.zarr")
    shutil.copytree(path, tmp_path / "future.zarr")
    text = (path / "zarr.json").read_text().replace('"format_version": 3', '"format_version": 9')
    (tmp_path / "future.zarr" / "zarr.json").write_text(text)
    with pytest.raises(InputError, match="format version 9; expected 1 or 3"):
        store.read_recordings(tmp_path / "future.zarr")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wrench": np.zeros((0, 5, 6), np.float32)}, "none of them 0"),
        ({"wrench": np.zeros((3, 50, 5), np.float32)}, "expected 5 different names"),
        ({"axes": ("Fx", "Fx", "Fz", "Mx", "My", "Mz")}, "expected 6 different names"),
        ({"length": np.array([50, 0, 50], np.int32)}, r"recording 1 \(t1\): length is 0"),
        ({"length": np.array([50, 50, 51], np.int32)}, r"recording 2 \(t2\): length is 51"),
        ({"length": np.array([50, 50, 49], np.int32)}, "not zero; expected zero padding"),
        ({"length": np.full(2, 50, np.int32)}, "length is int32 of shape"),
        ({"wrench": np.full((3, 50, 6), np.nan, np.float32)}, "not finite"),
        ({"wrench": np.full((3, 50, 6), 3e38, np.float32)}, r"beyond 1e\+30"),
        (
            {"annotations": Annotations.from_rows([(3, "phase", "push", 0.0, 1.0)])},
            "are about recordings 3 to 3;",
        ),
        ({"annotations": Annotations.from_rows([(0, "phase", "push", np.inf, 1.0)])}, "expected a finite start"),
        ({"columns": {"grip": np.zeros(2)}}, "grip is float64 of shape"),
        ({"columns": {"a/b": np.zeros(3)}}, "not a name for a column"),
        ({"columns": {"wrench": np.zeros(3)}}, "not a name for a column"),
        ({"columns": {"é" * 101: np.zeros(3)}}, "expected at most 200 bytes"),
        ({"columns": {"zarr.json": np.zeros(3)}}, "and not zarr.json or part_sha256"),
        ({"columns": {"part_sha256": np.zeros(3)}}, "and not zarr.json or part_sha256"),
        ({"note": np.array(["", "a\udcff", ""])}, r"note of recording 1 is 'a\\udcff', which is not valid Unicode"),
        ({"columns": {"part": np.array(["\ud800"] * 3)}}, "column part of recording 0 is"),
        ({"dt": 0.0}, "dt is 0.0"),
        ({"dt": 1e-320}, "expected 1e-09 to"),
        ({"dt": 1e300}, "expected 1e-09 to"),
        ({"dt": float("nan")}, "dt is nan"),
    ],
)
def test_contradictory_recordings_are_refused(tmp_path: Path, change: dict[str, Any], sentence: str) -> None:
    recordings = simple()
    vars(recordings).update(change)  # not through the constructor, which checks shapes under pytest
    with pytest.raises(InputError, match=sentence):
        store.write_recordings(tmp_path / "x.zarr", recordings, {})
    folder_is_clean(tmp_path)


def test_attributes_must_be_json(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be stored as JSON"):
        store.write_recordings(tmp_path / "x.zarr", simple(), {"a": np.nan})
    folder_is_clean(tmp_path)


def test_a_period_that_is_no_number_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "x.zarr"
    store.write_recordings(path, simple(), {})
    zarr.open_group(path, mode="r+").attrs["dt"] = "inf"
    with pytest.raises(InputError, match=r"x\.zarr: dt is 'inf', no finite number\."):
        store.read_recordings(path)
