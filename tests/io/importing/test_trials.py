"""Names of trials, and values of a group that come again."""

from __future__ import annotations

from pathlib import Path

from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from tests.io.importing.test_importer import noise, write

PHASE = ["free"] * 100 + ["push"] * 100


def test_trials_that_are_counted_anew_every_day_keep_names_of_their_own(tmp_path: Path) -> None:
    for seed, (day, trial) in enumerate([("mon", 1), ("mon", 2), ("tue", 1), ("tue", 2)]):
        write(tmp_path / day / f"{trial}.csv", noise(seed), trial=trial, phase=PHASE)
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert recordings.trial.tolist() == ["mon/1", "mon/2", "tue/1", "tue/2"]
    assert recordings.columns["c_trial"].tolist() == ["1", "2", "1", "2"]
    named = "Recordings have the same value of trial, so each is named by its session and value; the values are the "
    assert named + "column c_trial." in imported.report.remarks
    assert len(labelled_intervals(recordings, TaskSpec("phase")).y) == 8  # refused where names repeat


def test_files_of_one_value_of_trial_are_named_after_themselves(tmp_path: Path) -> None:
    for seed, name in enumerate("ab"):
        write(tmp_path / f"{name}.csv", noise(seed), trial=7)
    recordings = read_source(tmp_path).recordings
    assert (recordings.trial.tolist(), recordings.columns["c_trial"].tolist()) == (["a", "b"], ["7", "7"])


def test_arms_of_one_trial_share_its_value(tmp_path: Path) -> None:
    for seed, arm in enumerate(("left", "right")):
        write(tmp_path / f"{arm}.csv", noise(seed), trial=7, arm=arm)
    recordings = read_source(tmp_path).recordings
    assert recordings.trial.tolist() == ["7", "7"]
    assert "c_trial" not in recordings.columns
