"""A store in whose place another one is put while it is read: what was read of both is not used as one."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax import report
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_parts, label_store, store, zarr
from rcbht_jax.io.export import DataSet, export, load
from rcbht_jax.types import LabelTracks, Recordings
from tests.support.parted_stores import tracks_of

COUNT, WORDS = 11, "was replaced by another store while it was read"


def write(path: Path, seed: int) -> None:
    """Recordings of the same names, lengths and places, with other signals."""
    wrench = np.random.default_rng(seed).normal(size=(COUNT, 30, 2))
    made = Recordings.from_arrays(list(wrench), 100.0, axes=("grip", "push"), units=("N", "V"), note=f"{seed}")
    store.write_recordings(path, made, {}, overwrite=True, part=4, simulation={"seed": np.full(COUNT, seed)})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write(tmp_path / "a.zarr", 1)
    return tmp_path / "a.zarr"


@pytest.mark.parametrize(
    "read", [store.read_batches, lambda path: store.read_batches(path, 1), store.read_simulation_batches],
    ids=["parts", "recordings", "simulation"],
)  # fmt: skip
def test_batches_are_of_one_store(read: Callable[[Path], Iterator[object]], path: Path) -> None:
    """The parts that were not yet read were those of the other store, each of which is whole."""
    batches = read(path)
    next(batches)
    write(path, 1)
    next(batches)  # the same content again
    write(path, 2)
    with pytest.raises(InputError, match=f"{path} {WORDS}"):
        list(batches)


@pytest.mark.parametrize(("read", "array"), [(store.read_table, "source"), (store.verify, "part_summary")])
def test_columns_are_of_one_store(
    read: Callable[[Path], object], array: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table held columns of both stores, and a whole store counted as damaged."""
    open_array, replaced = zarr.member, list[str]()

    def member(group: zarr.Group, name: str) -> zarr.Array:
        if name == array and not replaced:
            replaced.append(name)
            write(path, 2)
        return open_array(group, name)

    monkeypatch.setattr(zarr, "member", member)
    with pytest.raises(InputError, match=f"{path} {WORDS}"):
        read(path)


def test_labels_are_not_added_to_other_recordings_than_theirs(path: Path) -> None:
    """They had the digest of the store that was there at the end, and so passed every check."""

    def tracks() -> Iterator[LabelTracks]:
        for batch in store.read_batches(path):
            write(path, 2 if batch.trial[-1] == f"trial-{COUNT - 1}" else 1)
            yield tracks_of(len(batch))

    with pytest.raises(InputError, match=f"{path} {WORDS}"):
        label_store.write_batches(path, "words", tracks(), {})
    assert label_store.list_tracks(path) == []


def test_labels_are_of_one_set(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(label_parts, "PART", 4)
    label_store.write_tracks(path, "words", tracks_of(), {})
    batches = label_store.read_batches(path, "words", [4, 7])
    next(batches)
    shutil.rmtree(path / "labels" / "words")
    label_store.write_tracks(path, "words", label_parts.taken(tracks_of(), slice(None, None, -1)), {})
    with pytest.raises(InputError, match="does not match its checksum"):
        list(batches)


def test_an_export_is_of_one_store(path: Path, tmp_path: Path) -> None:
    """The table of trials was that of the store when the command began."""
    data: DataSet = load(path)
    write(path, 2)
    with pytest.raises(InputError, match=f"{path} {WORDS}"):
        export(data, tmp_path / "out", "csv")
    assert not (tmp_path / "out").exists()


def test_what_is_read_several_times_is_of_one_store(path: Path) -> None:
    """Commands that train read the table, the signals and the labels of a store one after the other."""
    with store.unchanged(path):
        write(path, 1)  # the same content again
    with pytest.raises(InputError, match=f"{path} {WORDS}"), store.unchanged(path):
        write(path, 2)
    with pytest.raises(InputError, match=f"{path} {WORDS}"), store.unchanged(path):
        raise IndexError(write(path, 1))  # what follows from it


def test_a_report_is_of_one_store(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    label_store.write_tracks(path, "words", tracks_of(), {})
    monkeypatch.setattr(report, "page", lambda *_: str(write(path, 2)))
    assert main(["report", str(path), "-o", str(tmp_path / "a.html"), "--tracks", "words"]) == 2
    assert WORDS in capsys.readouterr().err
    assert not (tmp_path / "a.html").exists()
