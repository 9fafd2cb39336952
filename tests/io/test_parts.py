"""Stores in parts: order and writer do not matter, a growing store says so, rows and batches are those of the whole."""

from __future__ import annotations

import dataclasses
import json
import random
import resource
import shutil
import subprocess
import sys
import threading
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from rcbht_jax._util import atomic
from rcbht_jax._util.atomic import flush_all
from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_parts, label_store, parts, store, store_reader, store_writer
from rcbht_jax.io.store_schema import schema_of
from rcbht_jax.io.summary import merged, quantiles, summary_of
from rcbht_jax.types import Recordings
from tests.support.parted_stores import (
    COUNT,
    GAPS,
    PART,
    add,
    begun,
    finish,
    ragged,
    tracks_of,
    tree,
    trimmed,
    truth,
)
from tests.support.store_cases import same
from tests.support.trees import assert_trees_equal


@pytest.fixture(scope="module")
def parted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished store of three parts, not to be changed."""
    path = begun(tmp_path_factory.mktemp("parted") / "parts.zarr")
    for number in (0, 1, 2):
        add(path, number)
    return finish(path)


@pytest.fixture
def copied(parted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(parted, tmp_path / "copy.zarr"))


def test_order_and_repetition_do_not_matter(parted: Path, tmp_path: Path) -> None:
    rng = random.Random(0)
    path = begun(tmp_path / "random.zarr")
    numbers = [0, 1, 2, 1, 0]
    rng.shuffle(numbers)
    for number in numbers:
        add(path, number)
    (path / "wrench" / "c" / "0" / "0" / "0.0123.partial").write_bytes(b"of a process that was killed")
    assert tree(finish(path)) == tree(parted)
    store_writer.finish(path)
    assert tree(path) == tree(parted)


def test_all_is_on_disk_and_parts_before_they_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed, path = set[Path](), begun(tmp_path / "p.zarr")
    monkeypatch.setattr(atomic, "_flush", flushed.add)
    for number in (2, 0, 1):
        counts = partial(store_writer.has_part, path, number)
        monkeypatch.setattr(parts, "flush_all", lambda entries, counts=counts: counts() or flush_all(entries))
        add(path, number)
        assert path / f"wrench/c/{number}/0/0" in flushed
        assert counts()
    monkeypatch.setattr(parts, "flush_all", flush_all)
    parts.flush_rest(finish(path))
    assert flushed >= {path, *path.rglob("*")}


def test_what_is_written_whole_is_the_same_bytes(parted: Path, tmp_path: Path) -> None:
    whole = tmp_path / "whole.zarr"
    store.write_recordings(
        whole, ragged(), {"importer": "none"}, created="then", simulation=truth(), part=PART
    )  # fmt: skip
    expected = {name: data for name, data in tree(parted).items() if not name.startswith("labels/")}
    assert {name: data for name, data in tree(whole).items() if name != "zarr.json"} == {
        name: data for name, data in expected.items() if name != "zarr.json"
    }
    assert store.read_attrs(whole) == store.read_attrs(parted)
    same(store.read_recordings(whole), ragged())
    assert_trees_equal(store.read_simulation(parted), {name: truth()[name] for name in sorted(truth())})
    _, found, how = label_store.choose_tracks(parted, "x")
    assert_trees_equal(found, tracks_of())
    assert how["window"] == 5


def test_two_processes_write_parts_at_the_same_time(parted: Path, tmp_path: Path) -> None:
    path = begun(tmp_path / "two.zarr")
    code = """
import sys
from collections import Counter
from pathlib import Path
from tests.support.parted_stores import add
for number in sys.argv[2:]:
    add(Path(sys.argv[1]), int(number))
"""
    root = Path(__file__).parents[2]
    children = [
        subprocess.Popen([sys.executable, "-c", code, str(path), *numbers], cwd=root, env=None)
        for numbers in (["0", "1"], ["2", "1"])
    ]
    assert [child.wait() for child in children] == [0, 0]
    assert tree(finish(path)) == tree(parted)


def test_rows_and_batches_are_those_of_the_whole(parted: Path) -> None:
    whole = ragged()
    for rows in ([7], [10, 0, 5, 5], list(range(COUNT))):
        found = store.read_rows(parted, rows)
        expected = whole.take(rows)
        same(found, trimmed(expected))
    batches = list(store.read_batches(parted, most=4 * 2 * 1000))
    assert len(batches) > 3
    joined = Recordings.join(batches)
    same(joined, whole)
    sizes = [len(batch) for batch in batches]
    assert_trees_equal(label_parts.joined([*label_store.read_batches(parted, "x", sizes)]), tracks_of())
    table = store.read_table(parted)
    same(dataclasses.replace(table, wrench=whole.wrench), whole)
    assert store.read_lengths(parted).tolist() == whole.length.tolist()
    for rows in ([11], [-1], [0.5], []):
        with pytest.raises(InputError, match="has recordings 0 to 10"):
            store.read_rows(parted, rows)


def test_a_sample_is_spread_evenly(parted: Path) -> None:
    longest = int(ragged().length.max())
    found, numbers = store.read_sample(parted, most=4 * 2 * longest * 3)
    assert numbers.tolist() == [0, 5, 10]
    same(found, trimmed(ragged().take(numbers)))
    assert store.read_sample(parted)[1].tolist() == list(range(COUNT))


def test_gaps_keep_their_place_and_are_left_out(tmp_path: Path) -> None:
    path = begun(tmp_path / "gaps.zarr", GAPS)
    for number in (2, 0, 1):
        add(path, number, GAPS)
    finish(path)
    kept = np.delete(np.arange(COUNT), GAPS)
    expected = ragged(gaps=GAPS).take(kept)
    same(store.read_recordings(path), trimmed(expected))
    assert store.read_attrs(path)["gaps"] == list(GAPS)
    assert store.count_recordings(path) == len(kept)
    same(store.read_rows(path, [5, 4]), trimmed(expected.take([5, 4])))
    assert store.read_simulation(path, "mass")["mass"].tolist() == truth()["mass"][kept].tolist()
    assert_trees_equal(label_store.choose_tracks(path, "x")[1], label_parts.taken(tracks_of(gaps=GAPS), kept))
    wanted = label_parts.taken(tracks_of(gaps=GAPS), kept)
    label_store.write_tracks(path, "y", wanted, {})
    assert_trees_equal(label_store.choose_tracks(path, "y")[1], wanted)
    with xr.open_zarr(path) as data:
        assert data["length"].values[list(GAPS)].tolist() == [0, 0]
        assert data["wrench"].shape[0] == COUNT


@pytest.mark.parametrize("gaps", [(), GAPS])
def test_counts_of_the_parts_add_up_to_those_of_the_whole(gaps: tuple[int, ...], tmp_path: Path) -> None:
    path = begun(tmp_path / "counted.zarr", gaps)
    for number in range(3):
        add(path, number, gaps)
    finish(path)
    whole = summary_of(store.read_recordings(path))
    assert store.read_summary(path) == merged([whole])
    assert sum(sum(counts.values()) for *_, counts in whole["groups"]) == COUNT - len(gaps)
    lengths = np.delete(ragged().length, gaps)
    merged_lengths: Counter[str] = Counter()
    for *_, counts in whole["groups"]:
        merged_lengths.update(counts)
    np.testing.assert_allclose(quantiles(merged_lengths), np.quantile(lengths, (0, 0.5, 1)))
    assert whole["columns"]["hook"] == {"texts": {"x": COUNT - 1 - len(gaps)}}
    assert whole["annotations"]["track0"]["label2"] == [2, 2]


def test_a_growing_or_large_store_is_described(
    parted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = begun(tmp_path / "growing.zarr")
    add(path, 1)
    assert main(["info", str(path)]) == 0
    assert "4 of 11 recordings; still being written" in capsys.readouterr().out
    assert main(["encode", str(path)]) == 2
    assert "still being written: 1 of 3 parts" in capsys.readouterr().err
    assert main(["info", str(parted), "--json"]) == 0
    small = json.loads(capsys.readouterr().out)
    monkeypatch.setattr(store, "SMALL_BYTES", 1)
    assert main(["info", str(parted), "--json"]) == 0
    large = json.loads(capsys.readouterr().out)
    assert small["verified"]
    assert small["tasks"]
    assert small["trials"] == store.read_recordings(parted).trial.tolist()
    assert not large["verified"]
    assert (large["trials"], large["all_trials"]) == (small["trials"][:5], False)  # of a million, some are read
    assert large | {key: small[key] for key in ("verified", "tasks", "trials", "all_trials")} == small
    assert main(["info", str(parted)]) == 0
    assert f"trials: {', '.join(small['trials'][:5])}, ...\n" in capsys.readouterr().out
    assert main(["info", str(parted), "--json", "--check"]) == 0
    assert json.loads(capsys.readouterr().out)["verified"]


def test_dask_computes_on_it_chunk_by_chunk(parted: Path) -> None:
    pytest.importorskip("dask")
    with xr.open_zarr(parted) as data:
        samples = data["wrench"]
        assert samples.chunks is not None
        assert max(samples.chunks[0]) <= PART  # no chunk has rows of two parts
        found = abs(samples).max(("time", "axis")).compute(scheduler="synchronous")
        np.testing.assert_array_equal(found.values, np.abs(ragged().wrench).max((1, 2)))


def test_a_store_of_gaps_alone_is_refused(tmp_path: Path) -> None:
    everything = tuple(range(COUNT))
    path = begun(tmp_path / "none.zarr", everything)
    for number in range(3):
        add(path, number, everything)
    with pytest.raises(InputError, match="None of the 11 rows"):
        store_writer.finish(path)


def test_a_growing_store_can_be_looked_at_but_not_used(tmp_path: Path) -> None:
    path = begun(tmp_path / "growing.zarr")
    assert store.count_recordings(path) == 0
    add(path, 1)
    assert not store.is_finished(path)
    assert [store_writer.has_part(path, number) for number in range(3)] == [False, True, False]
    assert store.count_recordings(path) == 4
    assert store.read_table(path).trial.tolist() == [f"trial-{n}" for n in range(4, 8)]
    with xr.open_zarr(path, consolidated=False) as data:
        assert data["wrench"].dims == ("trial", "time", "axis")
        expected = trimmed(ragged().take([4, 5, 6, 7]))
        np.testing.assert_array_equal(data["wrench"].values[4:8], expected.wrench)
        assert data["trial"].values.tolist() == [""] * 4 + expected.trial.tolist() + [""] * 3
    for use in (
        lambda: store.read_recordings(path),
        lambda: store.read_rows(path, [0]),
        lambda: list(store.read_batches(path)),
        lambda: store.read_simulation(path),
        lambda: store.verify(path),
        lambda: label_store.write_tracks(path, "y", tracks_of(4), {}),
    ):
        with pytest.raises(InputError, match="still being written: 1 of 3 parts"):
            use()
    with pytest.raises(InputError, match="2 of 3 parts"):
        store_writer.finish(path)


def test_a_part_counts_only_with_its_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = begun(tmp_path / "killed.zarr")
    with monkeypatch.context() as patch:
        patch.setattr(store_writer.parts, "seal", lambda part: part.folder.name == "simulation" or 1 / 0)
        with pytest.raises(ZeroDivisionError):
            add(path, 0)
    assert not store_writer.has_part(path, 0)
    assert store.count_recordings(path) == 0


@pytest.mark.parametrize("chunk", ["wrench/c/2/0/0", "outcome/c/2"])  # of part 2
@pytest.mark.parametrize("rows", [[0], [9]])
def test_damage_is_found_in_what_is_read_and_only_there(copied: Path, rows: list[int], chunk: str) -> None:
    (copied / chunk).unlink()
    stored = store_reader.Stored.of(copied, store.open_store(copied))
    if rows == [0]:
        same(store.read_rows(copied, rows), trimmed(ragged().take(rows)))
        store_reader.check_part(stored, 0)
    else:
        with pytest.raises(InputError, match="damaged"):
            store.read_rows(copied, rows)
    for use in (store.read_recordings, store.verify, lambda path: list(store.read_batches(path))):
        with pytest.raises(InputError, match="damaged"):
            use(copied)


def test_a_simulation_of_other_parts_is_found(copied: Path) -> None:
    """Its parts are whole, but not those of which it was made."""
    file = copied / "simulation" / "zarr.json"
    content = json.loads(file.read_text())
    content["attributes"]["content_sha256"] = "0" * 64
    file.write_text(json.dumps(content))
    for use in (store.verify, store.read_simulation):
        with pytest.raises(InputError, match="its simulation does not match its checksum"):
            use(copied)


def test_a_part_of_another_store_is_found(copied: Path, tmp_path: Path) -> None:
    """Each part is whole in itself, but not what the store was made of."""
    path = begun(tmp_path / "other.zarr", GAPS)
    for number in (0, 1, 2):
        add(path, number, GAPS)
    for name in tree(path):
        if "/c/2" in name and (copied / name).exists():
            (copied / name).write_bytes((path / name).read_bytes())
    with pytest.raises(InputError, match="does not match its checksum"):
        store.read_recordings(copied)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dt": 0.02}, "all parts of"),
        ({"units": ("N", "N")}, "all parts of"),
        ({"columns": {}}, "all parts of"),
        ({"annotations": Annotations.from_rows([(0, "other", "x", 0.0, 1.0)])}, "all parts of"),
    ],
)
def test_parts_agree(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = begun(tmp_path / "x.zarr")
    part = dataclasses.replace(ragged().take(np.arange(4)), **change)
    with pytest.raises(InputError, match=words):
        store_writer.write_part(path, 0, part, {name: values[:4] for name, values in truth().items()})


def test_there_is_a_place_for_each_part_and_no_more(tmp_path: Path) -> None:
    path = begun(tmp_path / "x.zarr")
    some = {name: values[:4] for name, values in truth().items()}
    with pytest.raises(InputError, match="no part 3; there are 3"):
        store_writer.write_part(path, 3, ragged().take(np.arange(4)), some)
    with pytest.raises(InputError, match="of a part"):
        store_writer.write_part(path, 2, ragged().take(np.arange(4)), some)


def test_labels_of_too_few_or_too_many_recordings_are_refused(copied: Path) -> None:
    for count, words in ((COUNT - 1, "end after 10 of 11"), (COUNT + 1, "more recordings")):
        with pytest.raises(InputError, match=words):
            label_store.write_batches(copied, "y", [tracks_of(count)], {})
    assert label_store.list_tracks(copied) == ["x"]


def test_batches_need_the_memory_of_one(tmp_path: Path) -> None:
    """20 parts of 10 MB are gone through with the memory of few, the buffers of Zarr's threads allowed for."""
    path, count, part = tmp_path / "big.zarr", 20, 40
    one = Recordings.from_arrays(np.random.default_rng(0).normal(size=(part, 10_000, 6)).astype(np.float32))
    store_writer.create(path, schema_of(one, None, count * part, part), {}, "then")
    for number in range(2):
        store_writer.write_part(path, number, one)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(2, count):
        store_writer.write_part(path, number, one)
    store_writer.finish(path)
    assert sum(len(batch) for batch in store.read_batches(path)) == count * part
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before  # KiB
    assert grown < 100_000  # all of it is 173 MB


def test_parts_are_verified_at_the_same_time_and_the_first_damaged_one_is_named() -> None:
    both = threading.Barrier(2, timeout=10.0)  # a second part is read while the first one is

    def check(number: int) -> int:
        if number < 2:
            both.wait()
        if number in (3, 5):
            raise InputError(f"part {number}")
        return number

    assert parts.each(check, range(3)) == [0, 1, 2]
    with pytest.raises(InputError, match="part 3"):
        parts.each(check, range(7))
