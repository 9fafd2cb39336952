"""The experiment on faults of another session: what each way learns from, on synthetic snapshots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.online import faults as online
from experiments.online import faults_across as across
from experiments.online.fault_trials import GRADES
from experiments.online.fault_watch import Watched
from tests.experiments.test_faults import made_up, seen

KINDS = {kind: GRADES[kind][:1] for kind in ("jamming", "early-stop")}


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> tuple[Watched, Watched]:
    """Two sessions, in each of which a fault raises the feature by 6; nominal trials of the second are at 6."""
    monkeypatch.setattr(across, "GRADES", KINDS)
    first, second = seen(made_up(600, 20, 20), 6.0), seen(made_up(600, 20, 20), 6.0, seed=1)
    return first, replace(second, snapshots=replace(second.snapshots, features=second.snapshots.features + 6))


def test_chosen_trials_keep_their_snapshots_and_sets_become_one(sessions: tuple[Watched, Watched]) -> None:
    first, second = sessions
    both = across.together([first, second])
    rows = np.arange(len(both.trials.kind)) >= len(first.trials.kind)
    found = across.chosen(both, rows)
    for name in ("trial", "subtask", "begin", "now", "features"):
        np.testing.assert_array_equal(getattr(found.snapshots, name), getattr(second.snapshots, name))
    assert found.trials.kind.tolist() == second.trials.kind.tolist()
    assert len(found.trials.recordings) == rows.sum()


def test_levels_of_its_own_nominal_trials_keep_a_monitor_calm_elsewhere(
    sessions: tuple[Watched, Watched], tmp_path: Path
) -> None:
    first, second = sessions
    found = {
        way: [across.alarms_of(second, [first], seed, way, tmp_path / f"{way}-{seed}.npz") for seed in (0, 1)]
        for way in (across.OWN, across.CALM, across.OTHERS)
    }
    made = across.measure(second.trials, found)
    false = {way: made[way]["false alarms per nominal trial"]["mean"] for way in made}
    assert false[across.OTHERS] > 0.9  # what is nominal here is a fault there
    assert false[across.OWN] < 0.05
    assert false[across.CALM] < 0.05
    assert made[across.OWN]["kinds"]["jamming"]["share detected"]["mean"] > 0.9


def test_its_own_way_is_that_of_the_experiment_beside_it(sessions: tuple[Watched, Watched], tmp_path: Path) -> None:
    first = sessions[0]
    found, run = across.alarms_of(first, [], 3, across.OWN, tmp_path / "own.npz"), online.run(first, 3)
    for watcher, times in run.first.items():
        np.testing.assert_array_equal(found[across.EVERY].first[watcher], times)


def test_a_kind_that_is_never_seen_is_not_among_what_is_learned(
    sessions: tuple[Watched, Watched], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, inside = sessions[0], online.parts(sessions[0].trials, 0)
    made = across.learned(first, inside, [], 0, across.UNSEEN)
    for kind, monitor in made.items():
        assert all(kind not in machine.svm.classes for machine in monitor.machines.values())
    path = tmp_path / "unseen.npz"
    once = across.alarms_of(first, [], 0, across.UNSEEN, path)
    monkeypatch.setattr(across, "learned", lambda *_: pytest.fail("what is kept must not be learned again"))
    again = across.alarms_of(first, [], 0, across.UNSEEN, path)
    for kind in KINDS:
        np.testing.assert_array_equal(once[kind].first["words"], again[kind].first["words"])
    assert not np.array_equal(once["jamming"].first["words"], once["early-stop"].first["words"])
