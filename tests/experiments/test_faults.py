"""The experiment on simulated faults: what counts as noticed, and a monitor that learns from synthetic snapshots."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.online import fault_watch as watch
from experiments.online import faults as online
from experiments.online.fault_trials import GRADES, TAIL, Trials, batches, missing_tab, spec_of
from experiments.online.fault_watch import APPROACH, INSERTION, MATING, SETTLED, Watched, alarms, monitor, schedule
from rcbht_jax.introspection.fault_monitor import NOMINAL, SubtaskSnapshots
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import TABS
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization.trials import check, sample

DT, CONTACT, MATED, END = 0.1, 1.0, 3.0, 5.0  # s


def made_up(nominal: int, jammed: int, stopped: int) -> Trials:
    """Trials of 80 samples; the robots that stop early never come to mating."""
    count = nominal + jammed + stopped
    kind = np.array([NOMINAL] * nominal + ["jamming"] * jammed + ["early-stop"] * stopped)
    failed = kind != NOMINAL
    onset = np.tile([0.0, CONTACT, CONTACT + DT, MATED], (count, 1))
    onset[kind == "early-stop", 3] = np.nan
    onset[:, 3] += np.linspace(0, 0.15, count)  # no two insertions last the same
    text = np.full(count, "")
    recordings = snap_recordings(
        wrench=np.zeros((count, 80, 6), np.float32), length=np.full(count, 80, np.int32), dt=DT, onset=onset,
        onset_harmonised=onset, trial=np.arange(count).astype(str), arm=np.full(count, "R"), source=text, session=text,
        outcome=np.where(failed, "failure", "success"), failure_type=text, deviation=np.zeros((count, 3)), note=text,
    )  # fmt: skip
    stop = np.where(kind == "early-stop", 2.0, 1e4)
    ones = np.ones(count, bool)
    return Trials(recordings, kind, np.zeros(count, np.int64), ones, kind, stop, np.full(count, END))


def seen(those: Trials, wrong: float, seed: int = 0) -> Watched:
    """Snapshots with one feature, whose mean is ``wrong`` while a trial is failing."""
    row, stage, begin, now = schedule(those.recordings, 1)
    failing = those.failed[row] & (stage > APPROACH) & (now * DT >= np.where(those.stop < 1e3, those.stop, 0)[row])
    x = np.random.default_rng(seed).normal(size=(len(row), 1)) + wrong * failing[:, None]
    return Watched(those, SubtaskSnapshots(row, stage, begin, now, x.astype(np.float32), DT))


def test_snapshots_are_of_the_present_sub_task(monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = made_up(2, 0, 1).recordings
    assert SETTLED not in schedule(recordings, 7)[1]  # the record is too short
    monkeypatch.setattr(watch, "REST", 3.0)
    row, stage, begin, now = schedule(recordings, 7)
    mine = row == 0
    assert now[mine].tolist() == [7, 10, 17, 24, 30, 37, 44, 51, 58, 60, 67, 74, 80]
    assert stage[mine].tolist() == [APPROACH] * 2 + [INSERTION] * 3 + [MATING] * 5 + [SETTLED] * 3
    assert begin[mine].tolist() == [0] * 2 + [10] * 3 + [30] * 5 + [60] * 3
    assert MATING not in stage[row == 2]
    assert now[row == 2][-1] == 80


def test_every_trial_is_on_one_side_and_every_kind_on_both() -> None:
    those = made_up(9, 4, 4)
    inside = online.parts(those, 3)
    assert inside[:9].sum() == 6
    assert inside[9:13].sum() == inside[13:].sum() == 2
    assert not np.array_equal(inside, online.parts(those, 4))


def test_an_alarm_counts_after_the_fault_and_before_the_planned_end() -> None:
    those = made_up(0, 3, 3)
    early, good, late = CONTACT - 0.1, CONTACT + 0.5, END + 0.1
    assert online.in_time(those, np.array([early, good, late, good, 2.5, np.inf])).tolist() == [
        False, True, False, False, True, False,
    ]  # fmt: skip


def test_a_monitor_finds_what_differs_and_keeps_calm_otherwise() -> None:
    those = made_up(600, 20, 20)
    inside = online.parts(those, 0)
    found = {}
    for wrong in (0.6, 6.0):
        w = seen(those, wrong)
        learned = monitor(w, inside, 0)
        first = alarms(w, learned, ~inside)
        assert all(np.isinf(times[inside]).all() for times in first.values())
        nominal = those.nominal & ~inside
        # words 1 %, clock 0.5 %; 200 trials
        assert np.isfinite(np.minimum(*first.values()))[nominal].sum() <= 9
        failing = those.failed & ~inside
        found[wrong] = online.in_time(those, first["words"])[failing].mean()
        stopped = failing & (those.kind == "early-stop")
        assert online.in_time(those, first["clock"])[stopped].all()
    assert found[0.6] < 0.6
    assert found[6.0] > 0.9


def test_a_sub_task_that_no_nominal_trial_shows_has_no_machine() -> None:
    w = seen(made_up(600, 20, 0), 6.0)
    old = w.snapshots
    mask = ~((old.subtask == MATING) & w.trials.nominal[old.trial])
    columns = (getattr(old, name)[mask] for name in ("trial", "subtask", "begin", "now", "features"))
    some = Watched(w.trials, SubtaskSnapshots(*columns, DT))
    assert list(monitor(some, online.parts(w.trials, 0), 0).machines) == [INSERTION]


def test_the_table_counts_each_failure_once_per_repeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(online, "GRADES", {kind: GRADES[kind][:1] for kind in ("jamming", "early-stop")})
    w = seen(made_up(600, 12, 12), 6.0)
    made = online.measure(w, 2, 0)
    jammed = made["kinds"]["jamming"]["with contact"]
    assert jammed["trials"] == 12
    assert jammed["failures streamed"] == 12  # half of them, twice
    assert jammed["share detected"]["low"] <= jammed["share detected"]["mean"] <= jammed["share detected"]["high"]
    assert jammed["by the words"] <= jammed["detected"] <= jammed["by the words"] + jammed["by the clock"]
    assert made["kinds"]["jamming"]["without contact"]["share detected"] is None
    assert made["nominal trials streamed in each repeat"] == [200, 200]


def test_the_boundary_ends_with_the_first_grade_that_fails_half_of_the_time() -> None:
    those = made_up(0, 10, 10)
    grade = np.arange(20) % 5
    outcome = np.where(grade >= 2, "failure", "success")
    those = Trials(
        Recordings(**{**vars(those.recordings), "outcome": outcome}),
        those.kind, grade, those.contact, those.cause, those.stop, those.end,
    )  # fmt: skip
    assert online.boundary(those, "jamming") == [0, 1, 2]
    assert online.boundary(those, "early-stop") == [4]  # the later it stops, the less is missing


def test_lots_of_trials_are_possible_and_go_on_after_the_end() -> None:
    lots = batches((30, 20), 10)
    assert [lot for lot in lots if lot[0] == NOMINAL] == [(NOMINAL, 0, 30), (NOMINAL, 0, 20)]
    assert sum(count for kind, _, count in lots if kind != NOMINAL) == 4 * 10 + 60  # any of four tabs may be missing
    for kind, grade, _ in lots:
        check(spec_of(kind, grade))
        assert spec_of(kind, grade).logs_on == TAIL


def test_the_missing_tab_is_known_of_blocks_and_of_hooks() -> None:
    spec, found = spec_of("missing-tab", 0), {}
    for preset in ("B", "hooked-B"):
        parts = [sample(preset_of(preset), 1, index, spec)[0].parts for index in range(24)]
        names = ("hook_overlap", "tab_cut")[: 1 + (preset != "B")]
        found[preset] = missing_tab({name: np.stack([getattr(one, name) for one in parts]) for name in names})
    assert set(found["B"]) == set(TABS)
    assert found["B"].tolist() == found["hooked-B"].tolist()  # the same draw: which tab does not depend on the parts
