"""Commands that go through a store in batches: the size of a batch changes nothing, and the whole is never read."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax._util.digest import data_hash
from rcbht_jax.calibration import sample, search
from rcbht_jax.calibration.objective import SCORES
from rcbht_jax.io import label_parts, store, store_reader
from rcbht_jax.io.export import FORMATS, dataset
from rcbht_jax.learning.tasks import TaskSpec
from rcbht_jax.types import Recordings
from tests.support.command_line import CommandLine
from tests.support.parted_stores import tree
from tests.support.store_cases import encoded_store

COUNT = 12
QUICK = ["--task", "outcome", "--kernels", "linear", "--costs", "1"]


def trials() -> Recordings:
    """Ragged trials of one arm, half of them with a push; two of them are copies."""
    rng = np.random.default_rng(0)
    wrenches = [rng.normal(size=(int(n), 6)) * 0.05 for n in np.resize([150, 255, 180, 210], COUNT)]
    for row in range(0, COUNT, 2):
        wrenches[row][60:90] += np.linspace(0, 12, 30)[:, None]
        wrenches[row][90:] += 12
    wrenches[5] = wrenches[3]
    return Recordings.from_arrays(
        wrenches,
        outcome=["success", "failure"] * (COUNT // 2),
        session=np.repeat(["a", "b"], COUNT // 2),
        source=np.repeat(["one", "two", "three"], COUNT // 3),
        mass=rng.normal(size=COUNT),
        annotations=[
            (row, "phase", name, 0.3 * n, 0.3 * n + 0.3) for row in range(COUNT) for n, name in enumerate("xy")
        ],
    )


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trials in parts of four."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rcbht_jax.io.store_schema.MOST_ROWS", 4)
        patch.setattr(label_parts, "PART", 4)
        return encoded_store(tmp_path_factory.mktemp("large") / "trials.zarr", trials())


@pytest.fixture
def batched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Batches of a few recordings; samples that were read at once, in this order. The whole is not read."""
    sizes: list[int] = []
    original = store_reader._wrench

    def counted(*args: Any) -> Any:
        found = original(*args)
        sizes.append(len(found))
        return found

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("all of the store was read at once")

    monkeypatch.setattr(store_reader, "_wrench", counted)
    monkeypatch.setattr(store_reader, "read_all", refuse)
    monkeypatch.setattr(store, "BATCH_BYTES", 3 * 4 * 6 * 260)
    monkeypatch.setattr(label_parts, "PART", 3)
    return sizes


def test_a_model_does_not_depend_on_the_batches(
    stored: Path, tmp_path: Path, request: pytest.FixtureRequest, rcbht: CommandLine
) -> None:
    words = ["train", str(stored), *QUICK, "-o"]
    assert "Confounds: " in rcbht(*words, tmp_path / "whole.model")
    batched = request.getfixturevalue("batched")
    rcbht(*words, tmp_path / "b.model")
    assert (tmp_path / "b.model").read_bytes() == (tmp_path / "whole.model").read_bytes()
    assert sum(batched) == COUNT  # each wrench once, for the digest of the data
    assert max(batched) <= 4  # recordings; of the short ones four fit


def test_a_score_does_not_depend_on_the_batches(
    stored: Path, request: pytest.FixtureRequest, rcbht: CommandLine
) -> None:
    words = ["evaluate", stored, *QUICK, "--folds", 3, "--repeats", 1]
    expected = rcbht.json(*words)
    batched = request.getfixturevalue("batched")
    assert rcbht.json(*words) == expected
    assert "Exact copies of another recording: 1" in expected["confounds"]
    assert max(batched) <= 4  # recordings; of the short ones four fit


def _content(data: bytes) -> bytes:
    """Of an MCAP file, what precedes the random name of its draft."""
    return data.partition(b".partial-")[0]


@pytest.mark.parametrize("kind", FORMATS)
def test_an_export_does_not_depend_on_the_batches(
    kind: str, stored: Path, tmp_path: Path, request: pytest.FixtureRequest, rcbht: CommandLine
) -> None:
    words = ["export", str(stored), "--format", kind, "-o"]
    rcbht(*words, tmp_path / "whole")
    batched = request.getfixturevalue("batched")
    rcbht(*words, tmp_path / "parts")
    found, expected = (
        {name: _content(data) for name, data in tree(tmp_path / at).items()} for at in ("parts", "whole")
    )
    assert found == expected
    assert sum(batched) == 2 * COUNT  # to examine it, and to write it
    assert max(batched) <= 4


def test_labels_of_an_export_are_made_batch_by_batch(
    stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, rcbht: CommandLine
) -> None:
    monkeypatch.setattr(store, "SAMPLE_BYTES", 3 * 4 * 6 * store.longest_of(stored))  # tells thresholds of either
    words = ["export", str(stored), "--format", "parquet", "--window", "5", "-o"]
    rcbht(*words, tmp_path / "one")
    batched = request.getfixturevalue("batched")
    rcbht(*words, tmp_path / "many")
    assert sum(batched) == 3 + 2 * COUNT  # the sample, and each recording as in any export
    assert max(batched) <= 4
    assert tree(tmp_path / "many") == tree(tmp_path / "one")


def test_a_report_reads_what_it_shows(
    stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, rcbht: CommandLine
) -> None:
    monkeypatch.setattr(dataset, "SMALL_BYTES", 0)
    words = ["report", str(stored), "--rule", "paper", "--trial", "trial-0", "trial-8", "-o"]
    rcbht(*words, tmp_path / "whole.html")
    batched = request.getfixturevalue("batched")
    rcbht(*words, tmp_path / "b.html")
    assert (tmp_path / "b.html").read_bytes() == (tmp_path / "whole.html").read_bytes()
    assert sum(batched) == 2
    assert "first seconds of the recordings were not compared" in (tmp_path / "b.html").read_text()


@pytest.mark.parametrize("method", ["rest", "search"])
def test_thresholds_of_a_large_store_come_from_a_stated_sample(
    method: str, stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest,
    rcbht: CommandLine,
) -> None:  # fmt: skip
    """The search itself is left out: what it is given, and what is said of it, is looked at."""
    none = dict.fromkeys(search.SCORES, 0.0)
    unsought = partial(
        search.SearchResult, value=0.0, scores=none, start_value=0.0, start_scores=none, evaluations=0, history=[]
    )
    monkeypatch.setattr(search, "search", lambda data, config, options, **_: unsought(options.space.base))
    monkeypatch.setattr(search, "score_candidates", lambda *_: np.zeros((2, len(SCORES))))
    words = ["calibrate", stored, "--method", method, "--session", "b", "-o", tmp_path / "l.json"]
    words += ["--task", "outcome"] if method == "search" else []
    assert "of_trials" not in rcbht.json(*words)
    of_all = json.loads((tmp_path / "l.json").read_text())
    batched = request.getfixturevalue("batched")
    monkeypatch.setattr(sample, "SAMPLE_BYTES", 3 * 4 * 6 * store.longest_of(stored))
    found = rcbht.json(*words)
    assert (found["trials"], found["of_trials"]) == (3, 6)
    assert sum(batched) == COUNT + 3  # once all for the digest of the data, and the sample
    assert "spread evenly over its 6." in rcbht(*words)
    assert json.loads((tmp_path / "l.json").read_text())["provenance"]["data_hash"] == of_all["provenance"]["data_hash"]


def test_a_sample_has_whole_trials_spread_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"trial-{n // 2}" for n in range(21)]  # the last one has one arm; the others say how many fit
    made = Recordings.from_arrays(np.ones((21, 30, 6)), trial=names, arm=["R", "L"] * 10 + ["R"])
    store.write_recordings(tmp_path / "a.zarr", made, {}, part=3)
    monkeypatch.setattr(sample, "SAMPLE_BYTES", 7 * 30 * 24)
    found = sample.read_sample(tmp_path / "a.zarr", TaskSpec("outcome", outcomes=()))
    assert found.recordings.trial.tolist() == ["trial-0"] * 2 + ["trial-5"] * 2 + ["trial-10"]
    assert found.recordings.arm.tolist() == ["R", "L"] * 2 + ["R"]
    assert (found.trials, found.data_hash) == (11, data_hash(made))
