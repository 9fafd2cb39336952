"""Alarm levels: the promise about false alarms holds, and nothing of a streamed trial trains its own machine."""

from __future__ import annotations

import itertools
from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.events import AnomalyRaised, Belief
from rcbht_jax.introspection.alarms import (
    Alarm,
    Confidence,
    PhaseFilter,
    conformal_threshold,
    held_out,
    peaks,
    rounded_up,
    sustained_peak,
)
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import IntrospectionModel
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.training import HeadSpec, train_head, train_model
from rcbht_jax.io.messages import Sample
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.learning.tasks import TaskSpec
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from tests.support.introspection_models import CONFIG, model, trial


@given(st.lists(st.floats(0, 1), max_size=30), st.integers(1, 5))
def test_a_peak_is_where_an_alarm_stops(values, snapshots):
    """An alarm just below the peak is raised, one at the peak is not."""
    said = np.array(values)
    peak = sustained_peak(said, snapshots)
    runs = [min(values[k : k + snapshots]) for k in range(len(values) - snapshots + 1)]
    assert peak == max(runs, default=0.0)

    def raised(level: float) -> bool:
        alarm = Alarm(level, 0.1 * (snapshots - 1))
        return any(alarm.update(p, 0.1 * t) for t, p in enumerate(values))

    assert not raised(peak)
    if peak > 1e-6:
        assert raised(peak - 1e-9)


def test_the_promise_holds():
    rng = np.random.default_rng(0)
    for share, count in itertools.product((0.02, 0.1, 0.25), (49, 60, 199)):
        false = [np.mean(rng.beta(2, 5, 400) > conformal_threshold(rng.beta(2, 5, count), share)) for _ in range(300)]
        # The mean over training sets is between share - 1 / (n + 1) and share; here with its sampling error.
        assert share - 1 / (count + 1) - 0.004 < np.mean(false) < share + 0.004


def test_too_few_trials_promise_nothing():
    with pytest.raises(InputError, match="it takes 49"):
        conformal_threshold(np.zeros(48), 0.02)
    assert conformal_threshold(np.linspace(0, 1, 49), 0.02) == 1.0
    with pytest.raises(InputError, match="between 0 and 1"):
        conformal_threshold(np.zeros(9), 0.0)


@given(st.integers(1, 5000))
def test_what_is_said_to_be_promised_is_kept(count):
    """The share is printed in three digits: rounded down, it was refused."""
    least = float(f"{rounded_up(1 / (count + 1)):g}")
    assert 1 / (count + 1) <= least * (1 + 1e-9) < 1.011 / (count + 1)
    assert conformal_threshold(np.zeros(count), least) == 0.0
    with pytest.raises(InputError, match=f"only {least:g} or more; it takes"):
        conformal_threshold(np.zeros(count), 0.98 / (count + 1))


def test_peaks_are_in_the_order_of_the_names():
    p, names = np.array([0.1, 0.9, 0.8, 0.3, 0.2, 0.7]), np.array(["b", "a", "a", "b", "c", "a"])
    assert peaks(p, names, 2).tolist() == [0.8, 0.1, 0.0]
    assert peaks(p[:0], names[:0], 2).tolist() == []
    many = np.repeat([f"trial-{k:05d}" for k in np.random.default_rng(0).permutation(40_000)], 3)
    begun = perf_counter()
    assert len(peaks(np.zeros(len(many)), many, 2)) == 40_000
    assert perf_counter() - begun < 5


def test_peaks_are_held_out():
    """Each trial has a column of its own that gives it away: a machine that saw the trial would know it."""
    rng = np.random.default_rng(1)
    groups = np.repeat([f"t{k:02d}" for k in range(40)], 6)
    y = np.repeat(np.arange(40) % 2, 6)
    x = np.concatenate([rng.normal(size=(240, 1)), 5.0 * (groups[:, None] == np.unique(groups))], 1)
    svm = fit(x, y, ("failure", "success"), SvmSpec("linear", 1.0))
    machine = ProbabilisticSvm(svm, np.array([[-2.0, 0.0]]))
    calm = y == 1
    said = held_out(machine, x, y, groups, x[calm], groups[calm], 0)[:, 0]
    highest = peaks(said, groups[calm], 2)
    seen = peaks(machine.probability(x[calm])[:, 0], groups[calm], 2)
    assert len(highest) == 20
    assert max(seen) < 0.3  # the whole machine has learnt them by heart
    assert np.mean(highest) > 0.45  # those that did not see them are in doubt
    with pytest.raises(InputError, match="held out"):
        held_out(machine, x, y, groups, x[:1], np.array(["other"]), 0)


def made_up(kinds: list[int]) -> Recordings:
    """Calm trials succeed, pushed ones fail; half a second each."""
    count = len(kinds)
    text = {name: np.full(count, "") for name in ("failure_type", "note")}
    return snap_recordings(
        wrench=np.stack([trial(kind, 500 + k, 100) for k, kind in enumerate(kinds)]),
        length=np.full(count, 100, np.int32), dt=CONFIG.dt, onset=np.zeros((count, 4)),
        onset_harmonised=np.zeros((count, 4)), trial=np.array([f"t{k}" for k in range(count)]),
        arm=np.full(count, "R"), source=np.full(count, "made"), session=np.full(count, "up"),
        outcome=np.where(np.array(kinds) == 0, "success", "failure"), deviation=np.zeros((count, 3)), **text,
    )  # fmt: skip


def test_a_head_learns_its_level():
    data = made_up([0] * 20 + [1] * 8)
    spec = HeadSpec(TaskSpec("outcome"), ("histogram", "attributes"), rate=20.0, false_alarms=0.05, hold=0.15)
    learnt = train_head(data, spec, CONFIG, preset())
    assert 0 < learnt.alarm_level < 1
    assert learnt.alarm_hold == spec.hold
    model = IntrospectionModel(CONFIG, np.asarray(preset().limits), (learnt,), "")
    introspector, raised = Introspector(model, rate=20.0), []
    for kind in (0, 1):
        for seed in range(12):
            introspector.reset()
            raised.append(any(isinstance(e, AnomalyRaised) for e in introspector.push(trial(kind, 900 + seed, 100))))
    assert sum(raised[:12]) <= 2
    assert sum(raised[12:]) >= 10
    with pytest.raises(InputError, match="it takes 99"):
        train_head(data, HeadSpec(TaskSpec("outcome"), ("histogram",), false_alarms=0.01), CONFIG, preset())


def test_a_rate_of_false_alarms_without_an_alarm_is_refused():
    data = made_up([0] * 4 + [1] * 4)
    with pytest.raises(InputError, match="is for the task outcome; add that task"):
        train_model(data, (HeadSpec(TaskSpec("session"), false_alarms=0.1),), CONFIG, preset())
    renamed = replace(data, outcome=np.repeat(["good", "bad"], 4))
    with pytest.raises(InputError, match="No outcome is failure, so no alarm is learned"):
        train_head(renamed, HeadSpec(TaskSpec("outcome"), ("histogram",), false_alarms=0.1), CONFIG, preset())


def test_dates_as_time_stamps_delay_no_alarm():
    """A double resolves a quarter of a microsecond of such a clock, more than the tolerance of a comparison."""
    for begin in (0.0, 1.7e9 + 0.123):
        session = Session(Introspector(model(), rate=10.0, hold=0.1))
        shaken = trial(1, 900)
        events = [session.feed(Sample(tuple(row.tolist()), begin + k * CONFIG.dt)) for k, row in enumerate(shaken)]
        found = [event for event in itertools.chain(*events) if isinstance(event, AnomalyRaised)]
        above = [
            event.sample
            for event in itertools.chain(*events)
            if isinstance(event, Belief) and event.head == "outcome" and event.probabilities[1] > 0.7
        ]
        assert found[0].sample == above[1] == above[0] + 20  # held for one belief


@pytest.mark.parametrize(("k", "margin"), [(1.0, 0.1), (1.5, 0.1), (0.49, 0.0), (0.8, 0.31), (0.8, -0.1)])
def test_a_level_that_no_belief_can_pass_or_keep_is_refused(k: float, margin: float) -> None:
    with pytest.raises(InputError, match="cannot be certain above"):
        Confidence(k, margin)
    Confidence(0.8, 0.3)


@pytest.mark.parametrize(("margin", "least"), [(0.0, 0.5), (0.05, 0.55), (0.2, 0.7)])
def test_the_least_level_is_the_one_that_the_error_names(margin: float, least: float) -> None:
    """It named 0.5, which the default margin does not allow; and 0.7 - 0.2 is less than 0.5 in binary."""
    with pytest.raises(InputError, match=f"here {least:g}, to less than 1"):
        Confidence(least - 0.01, margin)
    Confidence(least, margin)


def test_a_belief_after_a_long_time_weighs_no_more_than_one() -> None:
    rare, dense = (PhaseFilter(["reach", "push"], memory=memory) for memory in (0.1, 1.0))
    for one in (rare, dense):
        one.update([0.3, 0.7], 1.0)
    assert rare.filtered.tolist() == dense.filtered.tolist()
    rare.update([1.0, 0.0], 2.0)
    assert rare.filtered[1] > 0  # no single belief rules a sub-task out
    rare.reset()
    rare.update([0.5, 0.5], 1.0)  # after the mean duration of a sub-task
    assert rare.filtered[0] == pytest.approx(np.exp(-1))
