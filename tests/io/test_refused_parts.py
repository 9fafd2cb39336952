"""A part that is refused changes nothing, and ``rcbht info --check`` reads all of a store."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts, store, store_writer
from rcbht_jax.types import Recordings
from tests.support.parted_stores import add, begun, finish, ragged, tree, trimmed, truth


@pytest.fixture
def parted(tmp_path: Path) -> Path:
    path = begun(tmp_path / "parts.zarr")
    for number in (0, 1, 2):
        add(path, number)
    return finish(path)


def test_a_refused_part_changes_nothing(parted: Path) -> None:
    before = tree(parted)
    with pytest.raises(InputError, match=r"of shape \(3,\); expected string of shape \[4\]"):
        store_writer.write_part(
            str(parted), 0, trimmed(ragged().take([0, 1, 2])), {k: v[:3] for k, v in truth().items()}
        )
    assert store_writer.has_part(str(parted), 0)
    assert tree(parted) == before
    store.verify(str(parted))


@pytest.mark.parametrize("rows", [5, 0])
@pytest.mark.parametrize("name", ["session", "length", "annotations/track", "wrench_sha256"])
def test_an_array_of_other_rows_than_its_store_is_one_sentence(
    name: str, rows: int, parted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table with a column that was too short ended the export with a ValueError."""
    file = parted / name / "zarr.json"
    content = json.loads(file.read_text())
    content["shape"][0] = rows
    file.write_text(json.dumps(content))
    assert main(["export", str(parted), "--format", "csv", "-o", str(tmp_path / "out")]) == 2
    assert f"{name} has {rows} of 11 rows. Import or copy it again" in capsys.readouterr().err
    read = {"length": store.read_lengths, "wrench_sha256": store.read_digests}.get(name, store.read_table)
    with pytest.raises(InputError, match=f"{name} has {rows} of 11 rows"):
        read(parted)


@pytest.mark.parametrize("small", [True, False])
def test_info_check_reads_all_of_a_store_of_any_size(
    parted: Path, small: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not small:
        monkeypatch.setattr(store, "SMALL_BYTES", 1)
    assert main(["info", str(parted), "--check"]) == 0
    assert "every checksum is right" in capsys.readouterr().out
    shutil.copy(parted / "part_summary" / "c" / "1", parted / "part_summary" / "c" / "0")
    assert main(["info", str(parted), "--check"]) == 2
    assert "the summary of part 0 is not that of its recordings" in capsys.readouterr().err


def test_what_differs_between_the_simulations_of_two_parts_is_named(tmp_path: Path) -> None:
    path, part = begun(tmp_path / "x.zarr"), ragged().take(np.arange(4))
    some = {name: values[:4] for name, values in truth().items()}
    name = next(name for name, values in some.items() if values.dtype.kind in "iuf")
    for changed, words in (
        (
            some | {name: some[name].astype(np.float16)},
            f"Part 0 has simulation/{name} of type float16 .*; all parts of",
        ),
        (some | {"fault": some["fault"].astype(object)}, "has simulation/fault of type object .* of type string"),
        (some | {"more": np.zeros(4)}, r"has simulation/more of type float64 \[\]; .* have no simulation/more\.$"),
        (
            {one: some[one] for one in some if one != name},
            f"has no simulation/{name}; .* have simulation/{name} of type",
        ),
    ):
        with pytest.raises(InputError, match=words):
            store_writer.write_part(path, 0, part, changed)


def test_a_part_whose_second_writing_was_interrupted_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = begun(tmp_path / "parts.zarr")
    for number in (0, 1, 2):
        add(path, number)
    changed = trimmed(ragged().take([3, 2, 1, 0]))
    simulation = {name: values[:4] for name, values in truth().items()}

    def interrupted(part: parts.Part) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(parts, "write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            store_writer.write_part(path, 0, trimmed(ragged().take([0, 1, 2, 3])), simulation)
        assert store_writer.has_part(path, 0)  # the same content again: what is there stays right
        with pytest.raises(KeyboardInterrupt):
            store_writer.write_part(path, 0, changed, simulation)
    assert not store_writer.has_part(path, 0)
    assert store_writer.has_part(path, 1)
    with pytest.raises(InputError, match=r"1 of 3 parts of .* are missing"):
        store_writer.finish(path)
    store_writer.write_part(path, 0, changed, simulation)
    store_writer.finish(path)
    store.verify(path)
    assert store.read_table(path).trial.tolist()[:4] == changed.trial.tolist()


@pytest.mark.parametrize("gaps", ["[2, 3]", '"x"', "[9999]", "[[1]]", "[1.5]", "null"])
def test_a_list_of_gaps_that_is_not_that_of_the_rows_is_found(
    parted: Path, gaps: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = parted / "zarr.json"
    attrs = json.loads(file.read_text())
    attrs["attributes"]["gaps"] = json.loads(gaps)
    file.write_text(json.dumps(attrs))
    for read in (store.verify, store.read_recordings, lambda path: list(store.read_batches(path))):
        with pytest.raises(InputError, match="its list of rows without a recording is not that of its rows"):
            read(parted)
    assert main(["doctor", str(parted)]) == 2
    assert "rows without a recording" in "".join(capsys.readouterr())


def test_columns_of_any_legal_name_and_no_wider_numbers_than_stores_hold(tmp_path: Path) -> None:
    recordings = Recordings.from_arrays([np.ones((9, 6))], 200.0, **{"load.partial": [1.0]})
    store.write_recordings(tmp_path / "a.zarr", recordings, {})
    assert store.read_recordings(tmp_path / "a.zarr").columns["load.partial"].tolist() == [1.0]
    if np.dtype(np.longdouble).itemsize > 8:
        wide = Recordings.from_arrays([np.ones((9, 6))], 200.0, c=np.ones(1, np.longdouble))
        with pytest.raises(InputError, match=r"column c is .*; expected text or numbers of at most 64 bits"):
            store.write_recordings(tmp_path / "b.zarr", wide, {})


def test_a_part_that_is_finished_while_counts_are_read_does_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A growing store counted as damaged: the text of that part was still empty."""
    path = begun(tmp_path / "parts.zarr")
    add(path, 1)
    expected, real = store.read_summary(path), parts.read
    monkeypatch.setattr(parts, "read", lambda *args: (real(*args), add(path, 0))[0])
    assert store.read_summary(path) == expected
    assert store_writer.has_part(path, 0)


def test_a_finished_store_takes_no_other_part(parted: Path) -> None:
    before = tree(parted)
    add(parted, 0)  # the same content, of a worker that was late
    changed, simulation = ragged().take([3, 2, 1, 0]), {name: values[:4] for name, values in truth().items()}
    with pytest.raises(InputError, match=r"parts\.zarr is finished, and its part 0 has other content"):
        store_writer.write_part(parted, 0, trimmed(changed), simulation)
    assert tree(parted) == before
