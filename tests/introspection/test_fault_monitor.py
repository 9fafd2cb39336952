"""The fault monitor: few false alarms, alarms in faulty trials, nothing learned before a fault shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.alarms import held_half
from rcbht_jax.introspection.fault_monitor import (
    COLUMNS,
    NOMINAL,
    FaultMonitor,
    FaultMonitorConfig,
    SubtaskSnapshots,
    schedule_snapshots,
)

DT, LENGTH = 0.1, 30
CONFIG = FaultMonitorConfig(false_alarms=0.04, clock_false_alarms=0.02)


def streams(nominal: int, faulty: int, shift: float, since: int = 10, seed: int = 0) -> SubtaskSnapshots:
    """Two sub-tasks of 10 and 20 samples; the mean of one feature is ``shift`` in faulty trials from ``since`` on."""
    count = nominal + faulty
    begins = np.tile([0, 10], (count, 1))
    trial, subtask, begin, now = schedule_snapshots(begins, np.full(count, LENGTH), 1)
    x = np.random.default_rng(seed).normal(size=(len(trial), 1)) + shift * ((trial >= nominal) & (now > since))[:, None]
    return SubtaskSnapshots(trial, subtask, begin, now, x, DT)


def causes(nominal: int, faulty: int) -> np.ndarray:
    return np.array([NOMINAL] * nominal + ["jamming"] * faulty)


def test_alarms_on_new_trials_keep_the_promise() -> None:
    monitor = FaultMonitor.fit(streams(200, 20, 6.0), causes(200, 20), config=CONFIG)
    first = monitor.alarms(streams(1000, 100, 6.0, seed=1), 1100)
    assert np.isfinite(first["words"][:1000]).mean() < 2 * CONFIG.false_alarms
    assert np.isfinite(first["words"][1000:]).mean() > 0.95
    assert (first["words"][1000:] > 1.0).mean() > 0.95  # not before the fault
    assert np.isinf(first["clock"]).all()


@pytest.mark.parametrize("every", [2, 3])
def test_the_promise_holds_at_the_rate_of_the_snapshots(every: int) -> None:
    """A level for alarms of so many snapshots was kept by alarms of so many seconds, which took fewer of them."""

    def drawn(nominal: int, seed: int) -> SubtaskSnapshots:
        count = nominal + 20
        trial, subtask, begin, now = schedule_snapshots(np.zeros((count, 1), int), np.full(count, 60), every)
        x = np.random.default_rng(seed).normal(size=(len(trial), 1)) + 2.5 * (trial >= nominal)[:, None]
        return SubtaskSnapshots(trial, subtask, begin, now, x, DT)

    lessons, new = drawn(60, 0), drawn(600, 1)
    with pytest.raises(InputError, match=rf"up to 0.{every} s apart, .* has 10 per second; .* rate={10 / every:g}\."):
        FaultMonitor.fit(lessons, causes(60, 20), config=CONFIG)
    slow = replace(CONFIG, rate=float(f"{10 / every:g}"), holds=(0.6,))
    monitor = FaultMonitor.fit(lessons, causes(60, 20), config=slow)
    assert np.isfinite(monitor.alarms(new, 620)["words"][:600]).mean() < 2 * CONFIG.false_alarms
    quick = FaultMonitor.fit(streams(200, 20, 6.0), causes(200, 20), config=CONFIG)
    with pytest.raises(InputError, match="the monitor's config has 10 per second"):
        quick.alarms(new, 620)


def test_a_hold_between_two_snapshots_takes_the_later_one() -> None:
    """The level is that of as many snapshots as the alarm takes: 0.25 s are three steps of 0.1 s, not two."""
    lessons, cause = streams(200, 20, 6.0), causes(200, 20)
    between, after = (
        FaultMonitor.fit(lessons, cause, config=replace(CONFIG, holds=(hold,))).levels for hold in (0.25, 0.3)
    )
    assert between == after


def test_the_split_keeps_its_rate_where_features_outnumber_trials() -> None:
    """The final classifier of "cross" has seen more trials than those of the folds, and its values are spread wider."""
    share, fits, new = 0.05, 40, 60
    cause = np.concatenate([causes(39, 19), [NOMINAL] * new])
    trial, subtask, begin, now = schedule_snapshots(np.zeros((len(cause), 1), int), np.full(len(cause), 8), 1)
    row, rng = np.arange(len(cause)), np.random.default_rng(0)
    lessons = {"cross": (row >= 20) & (row < 58), "split": row < 58}  # levels of 19 nominal trials each
    alarms = dict.fromkeys(lessons, 0.0)
    for _ in range(fits):
        x = rng.normal(size=(len(cause), 300))[trial] + 0.5 * rng.normal(size=(len(trial), 300))
        x[:, 0] += (cause != NOMINAL)[trial]
        drawn = SubtaskSnapshots(trial, subtask, begin, now, x, DT)
        for calibration, inside in lessons.items():
            config = FaultMonitorConfig(false_alarms=share, holds=(0.2, 0.3, 0.5), snapshots=3, calibration=calibration)
            monitor = FaultMonitor.fit(drawn.of_trials(inside), cause, config=config)
            first = monitor.alarms(drawn.of_trials(row >= 58), len(cause))["words"]
            alarms[calibration] += np.isfinite(first[58:]).mean() / fits
    # Alarms of one fit are beta-binomial, since the level is the largest of 19 peaks.
    deviation = np.sqrt(share * (1 - share) / fits * (1 / new + (1 - 1 / new) / 21))
    assert alarms["split"] < share + 3 * deviation < alarms["cross"]


def test_the_split_trains_on_every_trial_but_half_of_the_nominal_ones() -> None:
    """What the held-out half is like moves the levels, and neither the classifiers nor the choice of the hold."""
    lessons, cause = streams(200, 20, 6.0), causes(200, 20)
    config = replace(CONFIG, calibration="split")
    held = np.isin(np.arange(len(cause)), held_half(np.flatnonzero(cause == NOMINAL), 0))
    assert (held.sum(), held[200:].any()) == (100, False)
    moved = replace(lessons, features=lessons.features + 1.5 * held[lessons.trial][:, None])
    monitor, other = (FaultMonitor.fit(one, cause, subtasks=[1], config=config) for one in (lessons, moved))
    assert monitor.hold == other.hold
    np.testing.assert_array_equal(monitor.predict(lessons), other.predict(lessons))
    assert other.levels[1] > monitor.levels[1]
    assert monitor.detected > 0.9
    with pytest.raises(InputError, match="13 nominal trials cannot promise"):
        FaultMonitor.fit(streams(25, 20, 6.0), causes(25, 20), config=config)
    with pytest.raises(InputError, match="calibration is 'half'; expected one of cross, split"):
        FaultMonitorConfig(calibration="half")


def test_the_clock_raises_the_alarm_when_a_sub_task_lasts_too_long() -> None:
    durations = {0: np.append(np.linspace(0.6, 0.9, 100), np.full(20, np.nan))}
    monitor = FaultMonitor.fit(streams(100, 20, 6.0), causes(100, 20), durations=durations, config=CONFIG)
    assert 0.85 < monitor.limits[0] < 0.9
    np.testing.assert_allclose(monitor.alarms(streams(2, 1, 0.0), 3)["clock"], 0.9)


def test_the_clock_of_a_later_sub_task_starts_when_that_begins() -> None:
    durations = {1: np.append(np.linspace(1.0, 1.55, 100), np.full(20, np.nan))}
    monitor = FaultMonitor.fit(streams(100, 20, 6.0), causes(100, 20), durations=durations, config=CONFIG)
    assert 1.5 < monitor.limits[1] < 1.6
    new = streams(2, 1, 0.0)
    np.testing.assert_allclose(new.elapsed, [*np.arange(1, 11) * DT, *np.arange(1, 21) * DT] * 3)
    np.testing.assert_allclose(monitor.alarms(new, 3)["clock"], 1.0 + 1.6)


def test_a_sub_task_that_always_lasts_as_long_is_not_late() -> None:
    """Differences of stamps are rounded, and the clock raised the alarm in every nominal trial."""
    durations = {1: np.full(120, 3.3 - 1.3)}
    assert durations[1][0] < 2.0
    monitor = FaultMonitor.fit(streams(100, 20, 6.0), causes(100, 20), durations=durations, config=CONFIG)
    assert np.isinf(monitor.alarms(streams(100, 0, 0.0), 100)["clock"]).all()


def test_a_nominal_trial_that_did_not_end_does_not_stop_the_clock() -> None:
    """A single one made the limit NaN, which no time exceeds."""
    lessons, cause = streams(100, 20, 6.0), causes(100, 20)

    def limit(unfinished: int) -> float:
        lasted = np.append(np.linspace(0.6, 0.9, 100), np.full(20, np.nan))
        lasted[:unfinished] = np.nan
        return FaultMonitor.fit(lessons, cause, durations={0: lasted}, config=CONFIG).limits[0]

    assert limit(0) < limit(1) == 0.9  # the 99th of 100
    with pytest.raises(InputError, match="Sub-task 0 did not end in 2 of 100 nominal trials, too many"):
        limit(2)


def test_nothing_is_learned_before_a_fault_can_show() -> None:
    cause, late = causes(100, 20), streams(100, 20, 6.0, since=20)
    visible = np.where(cause == NOMINAL, 0.0, 2.05)
    blind = FaultMonitor.fit(late, cause, subtasks=[1], config=CONFIG)
    told = FaultMonitor.fit(late, cause, subtasks=[1], visible=visible, config=CONFIG)
    before = (late.trial >= 100) & (late.subtask == 1) & (late.now <= 20)
    after = (late.trial >= 100) & (late.now > 20)
    contrast = [m.predict(late)[after].mean() - m.predict(late)[before].mean() for m in (told, blind)]
    assert contrast[0] > contrast[1] + 0.1
    assert set(told.machines) == {1}
    assert (told.predict(late)[late.subtask == 0] == 0).all()


def test_the_hold_time_counts_only_alarms_before_the_deadline() -> None:
    snapshots, cause = streams(200, 20, 6.0), causes(200, 20)
    assert FaultMonitor.fit(snapshots, cause, config=CONFIG).detected > 0.9
    early = np.where(cause == NOMINAL, np.nan, 1.0)
    assert FaultMonitor.fit(snapshots, cause, deadline=early, config=CONFIG).detected < 0.2


def test_levels_of_its_own_trials_keep_the_promise_where_others_differ() -> None:
    def moved(snapshots: SubtaskSnapshots, rows: np.ndarray) -> SubtaskSnapshots:
        return replace(snapshots, features=snapshots.features + 2.5 * rows[snapshots.trial][:, None])

    own, cause = np.isin(np.arange(520), range(440, 500)), causes(500, 20)
    lessons = moved(streams(500, 20, 6.0), own)
    new = moved(streams(1000, 1, 0.0, seed=1), np.ones(1001, bool))
    found = [FaultMonitor.fit(lessons, cause, subtasks=[1], own=those, config=CONFIG) for those in (own, None)]
    alone, together = (np.isfinite(one.alarms(new, 1001)["words"][:1000]).mean() for one in found)
    assert alone < 2 * CONFIG.false_alarms < 4 * CONFIG.false_alarms < together
    first = lessons.of_trials(np.ones(520, bool))
    short = replace(first, **{name: getattr(first, name)[~own[first.trial] | (first.subtask == 0)] for name in COLUMNS})
    assert set(FaultMonitor.fit(short, cause, own=own, config=CONFIG).machines) == {0}


def test_input_that_cannot_be_learned_from() -> None:
    snapshots = streams(60, 2, 6.0)
    with pytest.raises(InputError, match="no sub-task shows 3 nominal trials"):
        FaultMonitor.fit(snapshots, causes(60, 2), config=CONFIG)
    with pytest.raises(InputError, match="it takes 199"):
        FaultMonitor.fit(streams(60, 20, 6.0), causes(60, 20))
    with pytest.raises(InputError, match="sorted by trial and time"):
        replace(snapshots, now=snapshots.now[::-1], begin=np.zeros_like(snapshots.begin))


def test_causes_too_rare_to_train_count_as_not_detected() -> None:
    cause = np.array([NOMINAL] * 60 + ["jamming"] * 20 + ["drop"] * 2)
    lessons = streams(60, 22, 6.0)
    monitor = FaultMonitor.fit(lessons, cause, config=CONFIG)
    assert monitor.detected == 0.5
    assert np.isfinite(monitor.alarms(lessons, 82)["words"][80:]).all()


@pytest.mark.parametrize("name", ["kind", "visible", "deadline", "own", "durations"])
def test_values_of_another_number_of_trials_are_one_sentence(name: str) -> None:
    short = {"kind": causes(1, 1), "own": np.ones(2, bool)}.get(name, np.ones(2))
    given = {name: {0: short} if name == "durations" else short}
    with pytest.raises(InputError, match=rf"There are 40 trials, and 2 values of {name}.*; expected as many\."):
        FaultMonitor.fit(streams(30, 10, 6.0), causes(30, 10), config=CONFIG, **given)
