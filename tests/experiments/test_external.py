"""Parts of the experiments on recordings of other laboratories, on small made-up ones."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments._lib import other_robots
from experiments._lib.results_io import not_finite
from experiments.external import change_points, failures, kitting, kitting_more, method
from rcbht_jax.errors import InputError
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings


@pytest.fixture(scope="module")
def runs() -> Recordings:
    """Six runs of rest, push, rest in two days; the push begins later from run to run."""
    wrench, rows = [], []
    for run in range(6):
        at = 100 + 10 * run
        force = np.zeros((300, 2))
        force[at : at + 100] = 5
        wrench.append(force + np.random.default_rng(run).normal(size=force.shape) * 0.05)
        edges = np.array([0, at, at + 100, 300]) / 100
        rows += [
            (run, "phase", name, *pair) for name, pair in zip(("rest", "push", "rest"), pairwise(edges), strict=True)
        ]
    session = np.array(["monday"] * 3 + ["tuesday"] * 3)
    return Recordings.from_arrays(
        wrench, 100, axes=["a", "b"], units=["N", "N"], annotations=rows, session=session, anomaly=["x", "y"] * 3
    )


def test_segments_between_changes_get_the_class_that_other_runs_teach(runs: Recordings) -> None:
    marks = [np.array([100 + 10 * run, 200 + 10 * run]) for run in range(6)]
    marks[2] = np.array([121, 160, 219])  # one change more than there are, the others a little off
    labels = change_points.label(runs, marks, 0)
    names = runs.annotations.labels["phase"]
    for run, found in enumerate(labels):
        expected = np.repeat(["rest", "push", "rest"], np.diff([0, *marks[run][[0, -1]], 300]))
        assert [names[code] for code in found] == expected.tolist()


def test_a_run_without_changes_is_one_segment(runs: Recordings) -> None:
    items = labelled_intervals(runs, TaskSpec("phase", outcomes=()))
    found = change_points.cut(items, runs, [np.zeros(0, np.int64)] * 5 + [np.array([7])])
    assert found.intervals[0].recording.tolist() == [0, 1, 2, 3, 4, 5, 5]
    assert found.intervals[0].start.tolist() == [0] * 6 + [7]
    assert found.intervals[0].end.tolist() == [300] * 5 + [7, 300]


def test_only_changes_inside_a_run_count(runs: Recordings, monkeypatch: pytest.MonkeyPatch) -> None:
    """A detector is told the median number of changes of the other runs; edges and repetitions are no changes."""
    told = []

    def detector(series: np.ndarray, count: int, seed: int) -> np.ndarray:
        told.append(count)
        return np.array([300, 0, 150, 150])

    monkeypatch.setitem(change_points.DETECTORS, "made up", detector)
    labels, counts = change_points.scored(runs, "made up", 0)
    assert told == [2] * 6
    assert counts == {"segments found": 12, "segments annotated": 18}
    assert [at.tolist() for at in change_points.oracle(runs)] == [[100 + 10 * k, 200 + 10 * k] for k in range(6)]
    assert all(len(set(part[:150])) == len(set(part[150:])) == 1 for part in labels)


def test_days_are_held_out_whole(runs: Recordings) -> None:
    items = labelled_intervals(runs, TaskSpec("anomaly", outcomes=()))
    splits = kitting_more.by_days(items)
    assert [set(items.session[test]) for _, test in splits] == [{"monday"}, {"tuesday"}]
    assert all(not set(items.session[train]) & set(items.session[test]) for train, test in splits)


def test_every_set_of_robot_failures_in_the_folder_is_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one of a class with fewer items than there are folds, as LP3 is: 3 series lost of 47."""
    rng = np.random.default_rng(0)
    rows = ["instance,class,sample,t_ms,Fx,Fy,Fz,Tx,Ty,Tz"]
    for instance in range(24):
        name = "lost" if instance < 2 else ("ok", "moved")[instance % 2]
        at = {"ok": 0, "moved": 20, "lost": 60}[name]
        values = rng.integers(at, at + 9, (15, 6)).tolist()
        rows += [f"{instance},{name},{k},{21 * k},{','.join(map(str, row))}" for k, row in enumerate(values)]
    folder = tmp_path / failures.FOLDER
    folder.mkdir()
    (folder / "lp3.csv").write_text("\n".join(rows))
    for module in (failures, other_robots):
        monkeypatch.setattr(module, "EXTERNAL", tmp_path)
    assert failures.sets() == ("lp3",)
    experiment = failures.Experiment(1, 0)
    y = experiment.data("lp3")[1].y
    [folds] = failures.repeated_folds(y, 1, 0)
    assert len(folds) == 5
    assert np.sort(np.concatenate([test for _, test in folds])).tolist() == list(range(24))
    assert min(np.bincount(y[train], minlength=3).min() for train, _ in folds) == 1  # the SVM needs two of a class
    for title in ("words + wrench", "words: SVM, thresholds of the training rows", "tuned in the folds"):
        assert experiment.row("lp3", title)["accuracy"]["mean"] > 0.85
    (folder / "lp3.csv").unlink()
    with pytest.raises(InputError, match="holds no set such as lp1"):
        failures.sets()


def test_other_skills_of_kitting_are_measured() -> None:
    """Skills and days are those of the data; one of a single day is left out, and one may have no anomaly."""
    rng = np.random.default_rng(0)
    days = np.array(["may", "june"] * 8 + ["may"] * 4)
    bad = np.arange(20) % 8 == 7
    series = [rng.normal(size=(40, 2)) + 9 * (np.arange(40) > 20)[:, None] * late for late in bad]
    recordings = Recordings.from_arrays(
        series, 20, axes=["force", "torque"], session=days, outcome=np.where(bad, "failure", "success"),
        skill=["8"] * 8 + ["9"] * 8 + ["6"] * 4, anomaly=np.where(bad, "bump", ""),
        anomaly_rel=np.where(bad, "1.0", ""),
    )  # fmt: skip
    assert kitting.skills(recordings) == ("8", "9")
    executions = {skill: kitting.of_skill(recordings, skill) for skill in ("8", "9")}
    executions["9"] = replace(executions["9"], nominal=np.ones(8, bool))
    band = kitting.QuantileBand(rate=20, score_rate=5, memory=0.2)
    found = kitting.measure(band, executions, [0, 1], rng)
    assert found["skills"]["8"]["auroc"] == 1.0
    assert found["skills"]["9"]["auroc"] is found["skills"]["9"]["auroc_interval"] is None
    assert not_finite(found) == ""
    assert found["thresholds"] == {}  # it takes 19 nominal executions
    assert found["alarms"] == {"nominal": None, "anomalous": None}
    with pytest.raises(InputError, match="No skill has 3 nominal executions besides those of one day"):
        kitting.skills(recordings.take(np.arange(16, 20)))


def test_alarms_are_counted_by_day() -> None:
    """Days of two skills; one has no anomaly, and one no threshold."""

    def day(false: int, nominal: int, detected: float | None, anomalous: int) -> dict[str, Any]:
        return {"false_alarms_of": [false, nominal], "detected": detected, "anomalous": anomalous}

    first = {"may": day(1, 10, 0.5, 4), "june": day(0, 20, None, 0), "july": day(0, 0, None, 7)}
    found = kitting.alarms([{"groups": first}, {"groups": {"may": day(2, 30, 1.0, 2)}}])
    assert found["nominal"]["mean"] == pytest.approx(3 / 60)
    assert found["anomalous"]["mean"] == pytest.approx(4 / 6)
    assert found["nominal"]["low"] == 0
    assert found["nominal"]["high"] == pytest.approx(3 / 40)  # may alone


def test_a_class_with_one_item_is_not_learned() -> None:
    rng = np.random.default_rng(0)
    y = np.array([0] * 10 + [1] + [2] * 10)
    x = rng.normal(size=(21, 3)) + 5 * y[:, None]
    train, test = np.arange(21), np.array([0, 10, 20])
    found = method.believe(x, x, y, train, test, 0)
    np.testing.assert_allclose(found.sum(1), 1)
    assert found[:, 1].tolist() == [0, 0, 0]
    assert found[[0, 2]].argmax(1).tolist() == [0, 2]
