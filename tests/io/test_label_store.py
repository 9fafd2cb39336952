"""Label tracks beside the recordings of a store: what goes in comes out, damage is found, nothing is half written."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings

from rcbht_jax.errors import InputError
from rcbht_jax.io import label_store, parts, store
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.types import LabelTrack, LabelTracks, TrackInfo
from tests.support.store_cases import files, folder_is_clean, same, simple


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "trials.zarr"
    store.write_recordings(path, simple(), {})
    return path


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


@settings(max_examples=3)
@given(seed=st.integers(0, 99), slots=st.integers(1, 9))
def test_tracks_round_trip(seed: int, slots: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/x.zarr"  # text serves as well as a Path
        store.write_recordings(path, simple(), {})
        label_store.write_tracks(path, "online-W5", label_tracks(seed, slots=slots), {"window": 5})
        assert label_store.choose_tracks(path)[0] == "online-W5"
        got, attrs = label_store.read_tracks(path, "online-W5")
        same_tracks(got, label_tracks(seed, slots=slots))
        assert attrs["window"] == 5
        folder_is_clean(Path(folder), "x.zarr")


def test_tracks_have_the_names_of_the_axes_of_the_store(tmp_path: Path) -> None:
    turned = ("Mz", "My", "Mx", "Fz", "Fy", "Fx")
    recordings = dataclasses.replace(simple(), axes=turned)
    store.write_recordings(tmp_path / "x.zarr", recordings, {})
    label_store.write_tracks(tmp_path / "x.zarr", "x", label_tracks(1), {})
    found, _ = label_store.read_tracks(tmp_path / "x.zarr", "x")
    assert found.info == TrackInfo(1 / recordings.dt, turned, (0, 1, 2))
    assert found.words("Mz", "primitive", 1) == label_tracks(1).words(0, "primitive", 1)


def test_tracks_join_the_store(path: Path) -> None:
    assert label_store.list_tracks(path) == []
    label_store.write_tracks(path, "online-W5", label_tracks(1), {})
    label_store.write_tracks(path, "offline-master", label_tracks(2), {})
    assert label_store.list_tracks(path) == ["offline-master", "online-W5"]
    same_tracks(label_store.read_tracks(path, "online-W5")[0], label_tracks(1))
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
        ("zarr.json", 3, "and not zarr.json"),
        ("taken", 3, "has label tracks taken already"),
        ("other", 2, "expected \\[3 recordings"),
    ],
)
def test_wrong_tracks_are_refused(path: Path, name: str, count: int, sentence: str) -> None:
    label_store.write_tracks(path, "taken", label_tracks(), {})
    with pytest.raises(InputError, match=sentence):
        label_store.write_tracks(path, name, label_tracks(count=count), {})
    assert label_store.list_tracks(path) == ["taken"]


def test_labels_of_another_rate_are_refused(path: Path) -> None:
    """Reading gives labels the rate of the store."""
    rate, tracks = 1 / simple().dt, label_tracks()
    other = dataclasses.replace(tracks, info=TrackInfo(2 * rate, simple().axes))
    for write in (label_store.write_tracks, lambda path, name, one, attrs: label_store.write_batches(
        path, name, [one], attrs
    )):  # fmt: skip
        with pytest.raises(InputError, match=f"labels are of {2 * rate:g} Hz, .*trials.zarr has {rate:g} Hz; encode"):
            write(path, "x", other, {})
    assert label_store.list_tracks(path) == []
    label_store.write_tracks(path, "x", dataclasses.replace(tracks, info=TrackInfo(rate, simple().axes)), {})


def test_track_dtypes_are_checked(path: Path) -> None:
    good = label_tracks()
    wrong = dataclasses.replace(good, mc=dataclasses.replace(good.mc, label=good.mc.label.astype(np.int64)))
    with pytest.raises(InputError, match="mc label is int64"):
        label_store.write_tracks(path, "x", wrong, {})


def test_missing_and_damaged_tracks(path: Path) -> None:
    with pytest.raises(InputError, match="no label tracks x; it has: none"):
        label_store.read_tracks(path, "x")
    label_store.write_tracks(path, "x", label_tracks(), {})
    for entry in list(files(path / "labels" / "x")):
        whole = entry.read_bytes()
        entry.unlink()
        with pytest.raises(InputError, match=r"damaged|incomplete|not a Zarr group"):
            label_store.read_tracks(path, "x")
        assert label_store.list_tracks(path) == ["x"]  # damaged tracks do not vanish
        entry.write_bytes(whole)
    same_tracks(label_store.read_tracks(path, "x")[0], label_tracks())


def test_interrupted_tracks_leave_the_store_as_it_was(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = parts.write_array

    def failing(group: Any, name: str, *rest: Any) -> None:
        if name == "mc/grad":
            raise OSError("stopped")
        real(group, name, *rest)

    monkeypatch.setattr(parts, "write_array", failing)
    with pytest.raises(OSError, match="stopped"):
        label_store.write_tracks(path, "x", label_tracks(), {})
    assert label_store.list_tracks(path) == []
    folder_is_clean(path.parent, "trials.zarr")
    same(store.read_recordings(path), simple())


def test_labels_of_other_recordings_are_refused(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.zarr"
    store.write_recordings(other, dataclasses.replace(simple(), wrench=2 * simple().wrench), {})
    label_store.write_tracks(other, "x", label_tracks(), {"recordings_sha256": "any"})
    assert label_store.read_tracks(other, "x")[1]["recordings_sha256"] == store.read_attrs(other)["content_sha256"]
    shutil.copytree(other / "labels", path / "labels")
    for use in (
        lambda: label_store.read_tracks(path, "x"),
        lambda: label_store.read_rows(path, "x", np.array([1])),
        lambda: label_store.verify_tracks(path, "x"),
    ):
        with pytest.raises(InputError, match="labels/x labels other recordings than those of"):
            use()
    content = json.loads((path / "labels/x/zarr.json").read_text())
    del content["attributes"]["recordings_sha256"]  # as of earlier versions
    (path / "labels/x/zarr.json").write_text(json.dumps(content))
    same_tracks(label_store.read_tracks(path, "x")[0], label_tracks())


def test_tracks_whose_metadata_are_not_collected_are_found(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(_: Path) -> None:
        raise KeyboardInterrupt

    label_store.write_tracks(path, "first", label_tracks(), {})
    with monkeypatch.context() as patch:
        patch.setattr("rcbht_jax.io.zarr.consolidate", killed)
        with pytest.raises(KeyboardInterrupt):
            label_store.write_tracks(path, "second", label_tracks(), {})
    assert label_store.uncollected_tracks(path) == ["second"]
    shutil.copytree(path, again := path.with_name("again.zarr"))
    label_store.collect(path)
    label_store.write_tracks(again, "third", label_tracks(), {})
    for repaired in (path, again):
        assert label_store.uncollected_tracks(repaired) == []
        assert xr.open_zarr(repaired, group="labels/second/llb")["label"].shape == (3, 6, 1)
        collected = json.loads((repaired / "zarr.json").read_text())["consolidated_metadata"]["metadata"]
        assert "labels/second/llb/label" in collected


def test_of_two_that_write_at_the_same_time_the_later_one_collects_both(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one process collects, which may miss a new track, the other one waits."""
    real, inside, most = zarr_io.consolidate, list[int](), list[int]()

    def slow(where: Path) -> None:
        inside.append(1)
        most.append(len(inside))
        time.sleep(0.1)
        real(where)
        inside.pop()

    monkeypatch.setattr(zarr_io, "consolidate", slow)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda name: label_store.write_tracks(path, name, label_tracks(), {}), ["a", "b"]))
    assert most == [1, 1]
    assert label_store.uncollected_tracks(path) == []


def test_the_lock_of_a_store_is_one_that_other_machines_see(path: Path) -> None:
    """On shared folders, which know no locks of folders; also where who holds it replaces the file that is locked."""
    file = path / "zarr.json"

    def locks_others_out() -> None:
        with file.open("rb+") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def waiting() -> None:
        with zarr_io.locked(path):
            locks_others_out()

    with ThreadPoolExecutor(1) as pool:
        with zarr_io.locked(path):
            locks_others_out()
            second = pool.submit(waiting)
            time.sleep(0.1)
            Path(shutil.copy(file, path.with_suffix(".json"))).replace(file)
        second.result()


def test_a_description_that_may_only_be_read_is_locked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(self: Path, mode: str = "r", *others: Any, **more: Any) -> Any:
        if self == path / "zarr.json" and "+" in mode:
            raise PermissionError(self)
        return opened(self, mode, *others, **more)

    opened = Path.open
    monkeypatch.setattr(Path, "open", read_only)
    label_store.write_tracks(path, "a", label_tracks(), {})
    assert label_store.uncollected_tracks(path) == []


def test_labels_kept_under_another_name_are_collected(path: Path) -> None:
    """Of two that write the same name at the same time, the later one made a store that doctor calls damaged."""

    def batches() -> Iterator[LabelTracks]:
        label_store.write_tracks(path, "a", label_tracks(), {})
        yield label_tracks()

    with pytest.raises(InputError, match=r"Another process changed .*/labels/a meanwhile.* is .*/labels/a-2"):
        label_store.write_batches(path, "a", batches(), {})
    assert label_store.list_tracks(path) == ["a", "a-2"]
    assert label_store.uncollected_tracks(path) == []
    label_store.verify_tracks(path, "a-2")
