"""Files that version 0.1 wrote (tests/data/v0.1, simulated data only) load and give what they gave then."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.encoding.thresholds import read_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.io import store as stores
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings, read_simulation
from rcbht_jax.types import Recordings
from tests.support.store_cases import same

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / "tests/data/v0.1"
EXPECTED: dict[str, Any] = json.loads((FILES / "expected.json").read_text())
TRIAL = "sim-A-000003"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("v0.1")
    with zipfile.ZipFile(FILES / "store.zip") as archive:
        archive.extractall(folder)
    return folder / "store.zarr"


def test_the_store_is_whole(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(store), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["content_sha256"] == EXPECTED["content_sha256"]
    assert info["rcbht_jax_version"] == "0.1.0"
    assert read_simulation(store)["seated"].shape == (6, 4)


def test_the_store_is_read_by_rows_and_in_batches_and_damage_is_found(store: Path, tmp_path: Path) -> None:
    whole = stores.read_recordings(store)
    same(stores.read_rows(store, [3, 1]), whole.take([3, 1]))
    same(Recordings.join([*stores.read_batches(store)]), whole)
    same(stores.read_table(store), whole)
    assert stores.count_recordings(store) == len(whole) == 6
    stores.verify(store)
    copy = Path(shutil.copytree(store, tmp_path / "copy.zarr"))
    (copy / "length" / "c" / "0").unlink()
    with pytest.raises(InputError, match="damaged"):
        stores.read_recordings(copy)


def test_its_labels_are_made_again(store: Path) -> None:
    assert main(["encode", str(store), "--name", "again"]) == 0
    old, _ = read_tracks(store, "online-W5")
    new, _ = read_tracks(store, "again")
    for layer in ("primitive", "mc", "llb"):
        for field in ("label", "t0", "t1", "emit"):
            np.testing.assert_array_equal(getattr(getattr(new, layer), field), getattr(getattr(old, layer), field))
        for field in ("vmax", "vmin", "avg", "grad"):
            np.testing.assert_allclose(
                getattr(getattr(new, layer), field), getattr(getattr(old, layer), field), rtol=1e-5, atol=1e-5
            )


def test_thresholds_load() -> None:
    thresholds, provenance = read_thresholds(FILES / "thresholds.json")
    np.testing.assert_array_equal(np.asarray(thresholds.limits, np.float64), np.asarray(EXPECTED["limits"]))
    assert provenance["method"] == "search"
    assert provenance["trial_names"] == ["sim-A-000003", "sim-A-000005"]


def test_a_classifier_decides_as_before(store: Path, tmp_path: Path) -> None:
    out = tmp_path / "classes.csv"
    with pytest.warns(UserWarning, match="does not state its axes"):
        assert main(["classify", str(store), "--model", str(FILES / "states.model"), "-o", str(out)]) == 0
    old, new = (list(csv.reader(path.read_text().splitlines())) for path in (FILES / "classes.csv", out))
    assert new[0] == old[0]
    assert len(new) == len(old) == 9
    first = old[0].index("truth") + 1
    for before, now in zip(old[1:], new[1:], strict=True):
        assert now[:first] == before[:first]
        np.testing.assert_allclose(np.float64(now[first:]), np.float64(before[first:]), rtol=0, atol=1e-9)


def test_a_model_believes_as_before(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stream", str(store), "--trial", TRIAL, "--model", str(FILES / "online.model")]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [e["sample"] for e in events if e["event"] == "SubtaskStarted"] == EXPECTED["subtask_starts"]
    beliefs = [event for event in events if event["event"] == "Belief"]
    assert [[e["sample"], e["head"], e["label"]] for e in beliefs] == [row[:3] for row in EXPECTED["beliefs"]]
    np.testing.assert_allclose(
        [event["probability"] for event in beliefs], [row[3] for row in EXPECTED["beliefs"]], rtol=0, atol=1e-5
    )


def test_an_exported_chain_runs(store: Path) -> None:
    recordings = read_recordings(store)
    wrench = recordings.wrench[recordings.trial.tolist().index(TRIAL), :1500].astype(float).tolist()
    lines = [json.dumps({"wrench": row}) for row in wrench]
    lines.insert(EXPECTED["subtask_starts"][0], '{"begin": true}')
    command = [sys.executable, str(ROOT / "examples/run_chain.py"), str(FILES / "online.chain")]
    done = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True, check=True)
    answers = [json.loads(line) for line in done.stdout.splitlines()][9::10]
    assert [answer["sample"] for answer in answers] == [answer["sample"] for answer in EXPECTED["chain"]]
    for now, before in zip(answers, EXPECTED["chain"], strict=True):
        for head in ("states", "phase"):
            assert list(now[head]) == list(before[head])
            np.testing.assert_allclose(list(now[head].values()), list(before[head].values()), rtol=0, atol=2e-4)
