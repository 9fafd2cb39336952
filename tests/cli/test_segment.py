"""``rcbht segment``: from a store to a table of intervals."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.introspection import segmenter_file
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.types import Recordings


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five recordings with a contact, of which the last is not annotated."""
    rng = np.random.default_rng(0)
    begin = rng.integers(40, 80, 5)
    wrenches = [np.where(np.arange(120) < one, 0.0, 8.0)[:, None] + rng.normal(size=(120, 1)) * 0.1 for one in begin]
    starts = np.stack([np.zeros(4), begin[:4] / 40], 1)
    marks = Annotations.from_starts("contact", ("free", "touch"), starts, np.full(4, 3.0))
    recordings = replace(Recordings.from_arrays(wrenches, 40.0, axes=("grip",), units=("N",)), annotations=marks)
    recordings = replace(recordings, source=np.array(["new", *["old"] * 4]))
    path = tmp_path_factory.mktemp("segment") / "runs.zarr"
    write_recordings(path, recordings, {})
    return path


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_a_table_of_intervals(store, tmp_path, rcbht):
    out = tmp_path / "segments.csv"
    result = rcbht.json("segment", store, "-o", out)
    assert (result["recordings"], result["annotated"], result["classes"]) == (5, 4, ["free", "touch"])
    assert result["score"]["accuracy"] > 0.95 > result["majority"]
    rows = table(out)
    new = [row for row in rows if row["recording"] == "4"]
    assert [row["label"] for row in new] == ["free", "touch"]
    assert {row["annotated"] for row in new} == {"False"}
    assert float(new[0]["start"]) == 0
    assert float(new[-1]["end"]) == 3


def test_recordings_of_one_source_have_their_numbers_in_the_store(store, tmp_path, rcbht):
    out = tmp_path / "segments.csv"
    rcbht("segment", store, "--source", "old", "-o", out)
    rows = table(out)
    assert {(row["recording"], row["source"]) for row in rows} == {(str(number), "old") for number in range(1, 5)}
    trials = read_recordings(store).trial
    assert all(row["trial"] == trials[int(row["recording"])] for row in rows)


def test_one_arm_is_labelled(store, tmp_path, rcbht, monkeypatch):
    """An idle arm counted as a recording of its own, on which no phase can be seen."""
    monkeypatch.setattr(WrenchSegmenter, "fit", lambda self, *_: self)
    monkeypatch.setattr(WrenchSegmenter, "predict", lambda self, data: [np.arange(n) // 60 for n in data.length])
    right = read_recordings(store)
    two, out = tmp_path / "two.zarr", tmp_path / "segments.csv"
    write_recordings(two, Recordings.join([replace(right, arm=np.full(5, "L"), wrench=right.wrench * 0), right]), {})
    for words, named, first in (((), "right", 5), (("--arm", "L"), "left", 0)):
        printed = rcbht("segment", two, "-o", out, *words)
        assert "5 recordings, 4 of them annotated" in printed
        assert printed.endswith(f"\nOnly the {named} arm is used.\n")
        assert {(row["recording"], row["arm"]) for row in table(out)} == {
            (str(first + number), named[0].upper()) for number in range(5)
        }
    saved = []
    monkeypatch.setattr(segmenter_file, "save", lambda path, file: saved.append(file))
    monkeypatch.setattr(segmenter_file.SegmenterFile, "of", lambda segmenter, track, labels, arm: arm)
    one, words = tmp_path / "one.zarr", ["-o", str(out), "--write-model", str(tmp_path / "s")]
    write_recordings(one, replace(right, arm=np.full(5, "L")), {})
    for wanted in (["--arm", "L"], []):
        rcbht("segment", two, *wanted, *words)
    rcbht("segment", one, *words)
    assert saved == ["L", "R", "L"]


def test_a_recording_that_nothing_labels_is_reported(store, tmp_path, rcbht):
    """The only one with two classes was missing from the table without a remark."""
    data = read_recordings(store)
    whole = data.annotations.of_recording(0)
    rows = [(0, "contact", *row) for row in zip(whole.names().tolist(), whole.start.tolist(), [1.5, 3.0], strict=True)]
    one = replace(data, annotations=Annotations.from_rows([*rows, (1, "contact", "free", 0.0, 1.0)]))
    few, out = tmp_path / "few.zarr", tmp_path / "segments.csv"
    write_recordings(few, one, {})
    printed = rcbht("segment", few, "--one-shot", "-o", out)
    assert "\nNot in the table: 1 recording, as none of another trial has two classes." in printed
    assert {row["recording"] for row in table(out)} == {"1", "2", "3", "4"}
    assert rcbht.json("segment", store, "--one-shot", "-o", out)["unlabelled"] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--task", "nothing"], "nothing"),
        (["-o", "table.txt"], "must end in .csv"),
        (["--one-shot", "--folds", "3"], "leave out --folds"),
        (["--source", "none"], "no recording has the source none"),
    ],
)
def test_what_it_refuses(store, words, said, rcbht):
    assert said in rcbht.refused("segment", store, *words)


def test_a_place_for_the_model_that_does_not_exist_is_said_at_once(store, tmp_path, rcbht, monkeypatch):
    monkeypatch.setattr("rcbht_jax.io.store.read_recordings", lambda path: pytest.fail("work was begun"))
    out = ["-o", str(tmp_path / "segments.csv")]
    error = rcbht.refused("segment", store, *out, "--write-model", tmp_path / "none" / "x.segmenter")
    assert "none is not a folder; create it first" in error
    error = rcbht.refused("segment", store, *out, "--write-model", out[1])
    assert "segments.csv is to be written and is used as" in error


def test_the_table_stays_where_the_model_cannot_be_written(store, tmp_path, monkeypatch):
    def full(path: Path, segmenter: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rcbht_jax.introspection.segmenter_file.save", full)
    out = tmp_path / "segments.csv"
    assert main(["segment", str(store), "-o", str(out), "--write-model", str(tmp_path / "x.segmenter")]) != 0
    assert out.read_text().startswith("recording,source,trial")
