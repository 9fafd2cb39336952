"""Names of trials, and values of a group that come again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping, write_mapping
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


def sessions_of_trials(path: Path, goes_on: bool, column: str = "session") -> None:
    """Two sessions of two trials, counted anew, with a time that goes on or starts anew."""
    lines = [f"{column},trial,t,Fz,phase"]
    for place, (session, trial) in enumerate([("mon", 1), ("mon", 2), ("tue", 1), ("tue", 2)]):
        begin = 5.0 * place if goes_on else 0.0
        rows = zip(noise(place).tolist(), PHASE, strict=True)
        lines += [f"{session},{trial},{begin + 0.01 * k:.2f},{value},{phase}" for k, (value, phase) in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("goes_on", [True, False])
def test_trials_that_are_counted_anew_in_one_table_are_recordings(goes_on: bool, tmp_path: Path) -> None:
    sessions_of_trials(tmp_path / "a.csv", goes_on)
    imported = read_source(tmp_path)
    recordings = imported.recordings
    assert recordings.trial.tolist() == ["a-1-1", "a-1-2", "a-2-1", "a-2-2"]
    assert recordings.session.tolist() == ["mon", "tue", "mon", "tue"]
    assert set(recordings.note.tolist()) == {"again:2"}
    for row, seed in enumerate((0, 2, 1, 3)):
        np.testing.assert_array_equal(recordings.wrench[row, :200, 0], noise(seed).astype(np.float32))
    np.testing.assert_allclose(recordings.starts("phase"), [[0.0, 1.0]] * 4)
    remark = "4 recordings are from tables in which values of the group come again after others; each stretch is one."
    assert remark in imported.report.remarks
    write_mapping(tmp_path / "map.toml", imported.mapping)
    again = read_source(tmp_path / "a.csv", mapping=read_mapping(tmp_path / "map.toml")).recordings
    np.testing.assert_array_equal(again.wrench, recordings.wrench)


def test_numbers_of_sessions_in_one_table_become_a_column(tmp_path: Path) -> None:
    sessions_of_trials(tmp_path / "a.csv", goes_on=True, column="subject")
    text = (tmp_path / "a.csv").read_text().replace("mon,", "11,").replace("tue,", "12,")
    (tmp_path / "a.csv").write_text(text)
    assert read_source(tmp_path).recordings.columns["subject"].tolist() == ["11", "12", "11", "12"]


def test_blocks_of_sensors_that_take_turns_stay_one_recording_each(tmp_path: Path) -> None:
    lines = ["sensor,t,Fz"]
    for block in range(6):
        for sensor in (1, 2):
            lines += [f"{sensor},{0.01 * (20 * block + k):.2f},{noise(sensor)[20 * block + k]}" for k in range(20)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    recordings = read_source(tmp_path, mapping=Mapping(group="sensor")).recordings
    assert recordings.trial.tolist() == ["a-1", "a-2"]
    np.testing.assert_array_equal(recordings.wrench[:, :, 0], np.stack([noise(1), noise(2)])[:, :120].astype("f4"))


def test_what_changes_where_the_time_starts_anew_describes_the_recordings(tmp_path: Path) -> None:
    """The outcome and the mass were left out, and the operator became annotations."""
    facts = [("1", "kim", 0.5), ("0", "kim", 0.5), ("1", "lee", 0.75)]
    lines = ["t,Fz,success,operator,mass,phase"]
    for seed, (success, operator, mass) in enumerate(facts):
        rows = zip(noise(seed).tolist(), PHASE, strict=True)
        lines += [
            f"{0.01 * k:.2f},{value},{success},{operator},{mass},{phase}" for k, (value, phase) in enumerate(rows)
        ]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, recordings.note.tolist()) == (("Fz",), ["restarts:2"] * 3)
    assert recordings.outcome.tolist() == ["success", "failure", "success"]
    assert recordings.columns["operator"].tolist() == ["kim", "kim", "lee"]
    assert recordings.columns["mass"].tolist() == ["0.5", "0.5", "0.75"]
    assert recordings.annotations.tracks == ("phase",)


def test_equal_numbers_in_other_units_are_no_copies(tmp_path: Path) -> None:
    for name, unit in {"a": "N", "b": "N", "c": "kgf"}.items():
        rows = (f"{k / 100},{k * 7 % 13}\n" for k in range(60))
        (tmp_path / f"{name}.csv").write_text(f"t,Fz [{unit}]\n" + "".join(rows))
    report = read_source(tmp_path, keep_copies=True).report
    assert report.imported == ["a.csv", "b.csv"]
    assert report.duplicates == [("b.csv", "exact copy of a.csv; imported all the same.")]
    assert [name for name, _ in report.skipped] == ["c.csv"]
