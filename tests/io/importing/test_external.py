"""Recordings of other laboratories, with the mappings of examples/."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping

MAPPINGS = Path(__file__).parents[3] / "examples" / "mappings"


def mapping(name: str) -> Mapping:
    return read_mapping(MAPPINGS / f"{name}.toml")


@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize("name", ["lp1", "lp2", "lp4"])
def test_robot_execution_failures(external_dir: Path, name: str, mapped: bool) -> None:
    path = external_dir / "robot_execution_failures" / f"{name}.csv"
    imported = read_source(path, "csv", mapping("robot_execution_failures") if mapped else None)
    recordings = imported.recordings
    with path.open() as file:
        rows = list(csv.DictReader(file))
    classes = {row["instance"]: row["class"] for row in rows}
    assert len(recordings) + len(imported.report.duplicates) == len(classes)
    assert recordings.dt == 0.021
    assert set(recordings.length.tolist()) == {15}
    assert recordings.axes == ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    assert set(recordings.units) == {""}  # not documented
    for trial, found in zip(recordings.trial.tolist(), recordings.columns["class"].tolist(), strict=True):
        assert classes[trial.rpartition("-")[2]] == found
    first = [float(row["Tz"]) for row in rows if row["instance"] == "0"]
    np.testing.assert_array_equal(recordings.wrench[recordings.trial.tolist().index(f"{name}-0"), :, 5], first)
    assert not any("saturated" in note for note in recordings.note)


def test_caps_at_40_hz(external_dir: Path) -> None:
    folder = external_dir / "caps" / "runs_40hz"
    recordings = read_source(folder, "csv", mapping("caps_40hz")).recordings
    assert len(recordings) == len(list(folder.glob("*.csv")))
    assert recordings.dt == 0.025
    assert recordings.annotations.labels["phase"] == (
        "none",
        "free_space_motion",
        "align",
        "engage",
        "screw",
        "tighten",
    )
    guessed = read_source(folder, "csv").recordings
    assert guessed.annotations.labels == {"label_name": recordings.annotations.labels["phase"]}
    assert 0.025 < guessed.dt < 0.0275  # the recordings have 37 to 40 samples per second, unevenly
    with (folder / "run1.csv").open() as file:
        rows = list(csv.DictReader(file))
    time, labels = np.array([float(row["t"]) for row in rows]), [row["label_name"] for row in rows]
    own = recordings.annotations.take(np.array([recordings.trial.tolist().index("run1")]))
    middles = (own.start + own.end) / 2
    assert [labels[np.abs(time - middle).argmin()] for middle in middles] == own.names().tolist()
    force = np.array([float(row["Fz"]) for row in rows])
    row = recordings.trial.tolist().index("run1")
    grid = np.arange(recordings.length[row]) * 0.025
    np.testing.assert_allclose(recordings.wrench[row, : len(grid), 2], np.interp(grid, time, force), atol=1e-4)


def test_caps_at_1_khz(external_dir: Path) -> None:
    slow = read_source(external_dir / "caps" / "runs_40hz", "csv", mapping("caps_40hz")).recordings
    folder = external_dir / "caps" / "runs_1khz"
    recordings = read_source(folder, "npz", mapping("caps_1khz")).recordings
    assert recordings.dt == 0.001
    assert recordings.trial.tolist() == slow.trial.tolist()
    assert recordings.annotations.labels == slow.annotations.labels
    # The same segments, seen at two rates.
    both = set(recordings.trial.tolist()) - {"run4", "run8"}
    rows = [row for row, trial in enumerate(recordings.trial.tolist()) if trial in both]
    fast_marks, slow_marks = (part.annotations.take(np.array(rows)) for part in (recordings, slow))
    assert Counter(fast_marks.names()) == Counter(slow_marks.names())
    reduced = read_source(folder / "run1.npz", "npz", Mapping(rate=200.0))
    assert reduced.recordings.note[0].split(";")[-1] == "resampled:1000"
    assert "filtered" in reduced.recordings.note[0].split(";")


def test_kitting(external_dir: Path) -> None:
    folder = external_dir / "kitting"
    recordings = read_source(folder, "csv", mapping("kitting")).recordings
    facts = json.loads((folder / "skills.json").read_text())
    assert len(recordings) == len(list(folder.rglob("*.csv")))
    assert recordings.axes == ("force", "torque")
    assert recordings.dt == 0.05
    listed = {entry["file"].removesuffix(".csv"): entry for entry in facts}
    for row, trial in enumerate(recordings.trial.tolist()):
        entry = listed[trial]
        assert recordings.outcome[row] == ("success" if entry["success"] else "failure")
        assert recordings.columns["skill"][row] == str(entry["skill"])
        assert recordings.session[row] == entry["day"]
    unmapped = read_source(folder / "successful_skills", "csv").recordings
    assert set(unmapped.outcome.tolist()) == {"unknown"}


def test_bags_of_a_baxter(external_dir: Path) -> None:
    imported = read_source(external_dir / "bags", "bag")
    recordings = imported.recordings
    assert len(recordings) == len(list((external_dir / "bags").glob("*.bag")))
    assert recordings.units == ("N", "N", "N", "Nm", "Nm", "Nm")
    assert recordings.dt == 0.005
    assert imported.report.skipped == []
