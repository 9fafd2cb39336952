"""Which snapshots train a head: every sentence alike, its end always, its beginning where that is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax._util.digest import wrench_digests
from rcbht_jax.annotations import Annotations
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import ABSOLUTE, FeatureSpec, Intervals
from rcbht_jax.features.online import names, weights
from rcbht_jax.features.recipes import SUBTASK, SUBTASK_RELATIVE, TRIAL, TRIAL_RELATIVE
from rcbht_jax.introspection import training
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.introspection.model import Head, load, save
from rcbht_jax.introspection.training import (
    HeadSpec,
    learn,
    regular_snapshots,
    training_snapshots,
)
from rcbht_jax.learning.probability import ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.svm import Grid, SvmSpec, fit
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec
from rcbht_jax.types import Recordings


def sentences_of(lengths: list[int]) -> LabelledIntervals:
    count = len(lengths)
    start = np.arange(count) * 7
    where = Intervals(np.arange(count) % 2, start, start + lengths, 0.005)
    names = np.array([f"t{k}" for k in range(count)])
    return LabelledIntervals(("a", "b"), np.arange(count) % 2, names, names, (where,), {})


@pytest.mark.parametrize("early", [False, True])
def test_picked_looks(early):
    items = sentences_of([10_000, 200, 21, 5])
    snapshots, every = training_snapshots(items, 20, 12, early), regular_snapshots(items, 20)
    for k, length in enumerate([10_000, 200, 21, 5]):
        mine, all_of_it = snapshots.interval == k, every.interval == k
        steps = snapshots.now[mine] - snapshots.begin[mine]
        assert len(steps) <= 24
        assert steps[-1] == length
        assert snapshots.complete[mine].tolist() == [False] * (len(steps) - 1) + [True]
        assert set(steps) <= set(every.now[all_of_it] - every.begin[all_of_it])
        assert (np.diff(steps) > 0).all()
        assert set(snapshots.recording[mine]) == {k % 2}
    first = snapshots.now[snapshots.interval == 0]
    assert (np.sum(first < 1000) > 5) == early
    assert len(every.now[every.interval == 3]) == 1
    assert np.sum(every.interval == 0) == 500


@pytest.mark.parametrize(
    ("rate", "hold", "dt", "steps"),
    [(10.0, 0.1, 0.005, 2), (10.0, 0.5, 0.5, 2), (10.0, 0.7, 0.5, 3), (10.0, 0.12, 0.005, 3), (20.0, 0.1, 0.005, 3)],
)
def test_an_alarm_is_held_for_as_many_snapshots_as_its_time_takes(monkeypatch, rate, hold, dt, steps):
    """A sensor may be slower than the snapshots that are asked for."""
    svm = fit(np.arange(4.0)[:, None], np.arange(4) // 2, ("failure", "success"), SvmSpec("linear", 1.0))
    machine, asked = ProbabilisticSvm(svm, np.array([[-2.0, 0.0]])), []
    head = Head("outcome", "trial", FeatureView(FeatureSpec(("elapsed",))), machine, "failure")
    items = sentences_of([400] * 4)
    items = replace(items, classes=("failure", "success"))
    monkeypatch.setattr(training, "snapshot_features", lambda *rest: np.zeros((len(rest[1]), 1)))
    monkeypatch.setattr(training, "held_out", lambda machine, x, y, groups, stream, *rest: np.zeros((len(stream), 2)))
    monkeypatch.setattr(training, "peaks", lambda p, groups, count: asked.append(count) or np.zeros(99))
    spec = HeadSpec(TaskSpec("outcome"), rate=rate, hold=hold, false_alarms=0.05)
    rest = np.zeros((4, 1)), np.zeros(4, int), np.array(list("abcd"))
    recordings = Recordings.from_arrays(np.zeros((2, 10, 6)), rate=1 / dt)
    training._alarm_level(recordings, spec, EncoderConfig(dt=dt), preset(), items, head, rest, 0)
    assert asked == [steps]


def test_intervals_that_overlap_are_refused():
    rows = [(row, "phase", *mark) for row in range(4) for mark in (("x", 0.0, 0.7), ("y", 0.5, 1.0))]
    data = Recordings.from_arrays(np.zeros((4, 200, 6)), 200, annotations=Annotations.from_rows(rows))
    for spec in (HeadSpec(TaskSpec("phase")), HeadSpec(TaskSpec("phase"), phase=True)):
        with pytest.raises(InputError, match=r"Intervals of phase overlap in recording 0 \(.*\) at 0.5 s"):
            training.train_head(data, spec, EncoderConfig(), preset())


def test_an_encoder_of_another_sampling_period_is_refused():
    """The model took seconds of 100 Hz for half seconds of 200 Hz."""
    data = Recordings.from_arrays(np.zeros((4, 200, 6)), 100, outcome=["success", "failure"] * 2)
    with pytest.raises(InputError, match=r"sampling period of 0\.005 s, the recordings of 0\.01 s"):
        training.train_model(data, (HeadSpec(TaskSpec("outcome"), families=("histogram",)),), EncoderConfig())


def test_names_of_classifiers_are_known_before_they_are_trained(monkeypatch):
    """All were trained before a detector was found to have the name of a task."""
    states, phase = HeadSpec(TaskSpec("a")), HeadSpec(TaskSpec("phase"))
    detector = replace(states, phase=True)
    assert training._names((states, detector)) == ["a", "phase"]
    assert training._names((states, phase, detector)) == ["a", "phase", "phase in trial"]
    monkeypatch.setattr(training, "train_head", lambda *args: pytest.fail("work was begun"))
    with pytest.raises(InputError, match="would be named a; name each task once"):
        training.train_model(Recordings.from_arrays(np.zeros((4, 200, 6)), 200), (states, states))


@pytest.mark.parametrize(("onset", "refused"), [(0.7, True), (0.5, False)])
def test_tracks_of_one_model_begin_together(monkeypatch, onset, refused):
    """A stream begins the sub-tasks of one track; beliefs about the other were of stretches that are none of its."""
    marks = [(0, "tool", "light", -1.0, 0.5), (0, "tool", "camera", 0.5, 1.0)]
    marks += [(0, "phase", "rest", 0.0, onset), (0, "phase", "push", onset, 1.0)]
    marks += [(1, "tool", "light", 0.0, 0.4), (1, "tool", "camera", 0.4, 1.0)]  # of which no phase is known
    data = Recordings.from_arrays(np.zeros((2, 200, 6)), 200, annotations=marks)
    monkeypatch.setattr(training, "train_head", lambda *args: pytest.fail("work was begun"))
    specs = (HeadSpec(TaskSpec("tool")), HeadSpec(TaskSpec("outcome")), HeadSpec(TaskSpec("phase")))
    text = "tool and phase begin at different times" if refused else "the task outcome needs two classes"
    with pytest.raises(InputError, match=text):  # every task is checked before the first is learned
        training.train_model(data, specs)


@pytest.mark.parametrize("time_alone", [False, True])
def test_a_complete_sentence_counts_several_times(time_alone):
    items = sentences_of([400] * 12)
    snapshots = training_snapshots(items, 20, 4)
    spec = FeatureSpec(families=("elapsed",) if time_alone else ("levels", "elapsed"), balance=True)
    x = np.random.default_rng(0).normal(size=(len(snapshots), len(names(spec))))
    grid = Grid(kernels=("rbf",), costs=(1.0,), scalings=(True,), ranks=True)
    rows = np.concatenate([np.arange(len(snapshots)), *[np.flatnonzero(snapshots.complete)] * 2])
    y, trial = items.y[snapshots.interval[rows]], items.trial[snapshots.interval[rows]]
    made = learn(x, snapshots, items, spec, grid, 3, 0)
    again = fit_probabilistic(x[rows], y, trial, items.classes, made.svm.spec, 0, weight=weights(spec))
    np.testing.assert_allclose(made.probability(x), again.probability(x), atol=5e-3)
    once = learn(x, snapshots, items, spec, grid, 1, 0)
    assert np.abs(made.probability(x) - once.probability(x)).max() > 0.02


def test_what_a_head_sees_depends_on_its_sentence():
    state, phase = HeadSpec(TaskSpec()), HeadSpec(TaskSpec(), phase=True)
    assert (state.view.spec.families, state.view.spec.balance) == (SUBTASK, True)
    assert (phase.view.spec.families, phase.view.spec.balance) == (TRIAL, False)
    assert HeadSpec(TaskSpec("outcome"), ("edges",)).view.spec.families == ("edges",)
    for head, families in (
        (HeadSpec(TaskSpec(), relative=True), SUBTASK_RELATIVE),
        (HeadSpec(TaskSpec("outcome"), relative=True), TRIAL_RELATIVE),
    ):
        assert head.view.spec.families == families
    assert not {"elapsed", "duration"} & {*TRIAL, *SUBTASK_RELATIVE}
    assert not {*ABSOLUTE} & {*SUBTASK_RELATIVE, *TRIAL_RELATIVE}


def test_a_model_keeps_the_digests_of_its_training_recordings_alone_and_their_arm(tmp_path):
    """A report said of trials that were held out that their beliefs are optimistic; another arm was streamed."""
    wrench = np.random.default_rng(0).normal(size=(6, 60, 6)).astype(np.float32)
    data = Recordings.from_arrays(
        wrench, 200, outcome=["success", "failure"] * 3, source=["a", "a", "b"] * 2, arm=["L"] * 6
    )
    spec = HeadSpec(TaskSpec("outcome", sources=("a",)), families=("histogram",))
    save(tmp_path / "m", training.train_model(data, (spec,)))
    model = load(tmp_path / "m")
    np.testing.assert_array_equal(model.digests, wrench_digests(data.wrench, data.length)[[0, 1, 3, 4]])
    assert model.arm == "L"


@pytest.mark.parametrize("most", [0, 20, 10**6])
def test_many_trials_are_learnt_in_part(monkeypatch, most):
    """A thousand simulated trials wanted a kernel of 100 GB; whole trials are left out, and counted."""
    if most:
        monkeypatch.setattr(training, "MOST", most)
    shape = np.random.default_rng(0).normal(size=(30, 60, 6)).astype(np.float32)
    data = Recordings.from_arrays(shape, 200, outcome=["success", "failure"] * 15)
    spec, config = HeadSpec(TaskSpec("outcome"), families=("histogram",), rate=20), EncoderConfig()
    items = training.training_items(data, spec, config, seed=1)
    each = len(training_snapshots(items.take(np.arange(1)), every=10, early=False))
    trials = 30 if most != 20 else 10  # five of each class at least
    assert each * 30 > 20
    assert len(items.y) == trials
    assert set(items.y.tolist()) == {0, 1}
    assert items.dropped == ({} if trials == 30 else {"beyond 20 snapshots to learn from": 20})
    model = training.train_model(data, (spec,), seed=1)
    rows = items.intervals[0].recording
    np.testing.assert_array_equal(model.digests, wrench_digests(data.wrench, data.length)[np.sort(rows)])


def test_repeated_snapshots_are_within_the_bound(monkeypatch):
    """Short intervals have hardly any but their last, which counts six times: six times the bound were learnt."""
    monkeypatch.setattr(training, "MOST", 72)
    marks = [(row, "phase", "ab"[k], k * 0.1, k * 0.1 + 0.1) for row in range(12) for k in range(2)]
    data = Recordings.from_arrays(np.zeros((12, 40, 6)), 200, annotations=marks, outcome=["success"] * 12)
    items = training.training_items(data, HeadSpec(TaskSpec("phase")), EncoderConfig())
    assert len(items.y) == 12  # six trials of two intervals
    items = training.training_items(data, HeadSpec(TaskSpec("phase"), phase=True), EncoderConfig())
    assert len(items.y) == 24  # none is repeated where a stream finds out when intervals begin
    monkeypatch.setattr(training, "MOST", 30)  # five snapshots
    few = data.take(np.arange(3))
    long = replace(few, annotations=Annotations.from_rows(
        (row, "phase", "ab"[k % 2], k * 0.02, k * 0.02 + 0.02) for row in range(3) for k in range(10)
    ))  # fmt: skip
    items = training.training_items(long, HeadSpec(TaskSpec("phase")), EncoderConfig())
    assert np.unique(items.trial, return_counts=True)[1].tolist() == [2] * 3  # one of each class
    assert items.dropped == {"intervals, beyond 30 snapshots to learn from": 24}


def test_hyper_parameters_are_chosen_on_some_snapshots_and_all_of_them_train(monkeypatch):
    asked = []
    monkeypatch.setattr(training, "LARGEST", 100)
    monkeypatch.setattr(training, "select", lambda x, *rest: asked.append(len(x[""])) or SvmSpec(kernel="linear"))
    wrench = np.random.default_rng(0).normal(size=(30, 60, 6)).astype(np.float32)
    data = Recordings.from_arrays(wrench, 200, outcome=["success", "failure"] * 15)
    fitted = training.fit_probabilistic
    monkeypatch.setattr(
        training, "fit_probabilistic", lambda x, *rest, **more: asked.append(len(x)) or fitted(x, *rest, **more)
    )
    training.train_head(
        data, HeadSpec(TaskSpec("outcome"), families=("histogram",), rate=20), EncoderConfig(), preset()
    )
    assert asked == [96, 180]  # whole trials of six snapshots


def test_classes_in_one_trial_only_are_refused_by_the_name_of_their_task():
    recordings = Recordings.from_arrays(np.zeros((4, 400, 6)), outcome=["failure", "success", "success", "unknown"])
    spec = HeadSpec(TaskSpec("outcome"))
    with pytest.raises(InputError, match=r"task outcome needs two .*; 1 class has as many\. Left out: 1 trial \(class"):
        training.train_head(recordings, spec, EncoderConfig(), preset())
