"""Which snapshots train a head: every sentence alike, its end always, its beginning where that is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.features import ABSOLUTE, FeatureSpec, Intervals
from rcbht_jax.features.online import names, weights
from rcbht_jax.features.recipes import SUBTASK, SUBTASK_RELATIVE, TRIAL, TRIAL_RELATIVE
from rcbht_jax.introspection.training import (
    HeadSpec,
    learn,
    regular_snapshots,
    training_snapshots,
)
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec


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
