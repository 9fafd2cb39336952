"""The parts of the grammar experiment that decide what is trained on and what is tested."""

from __future__ import annotations

import numpy as np

from experiments._lib.benchmarks import FAILURES
from experiments.classification.grammar import (
    ALL,
    AT_REST,
    BATCHES,
    GRAMMARS,
    LEVELS,
    LOADED,
    METHODS,
    PLAIN,
    RICHER,
    by_batch,
    of_both,
)
from rcbht_jax.features import ABSOLUTE, Intervals
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.types import Recordings


def test_only_classes_of_both_batches_are_left():
    y = np.array([0, 1, 2, 2, 0, 2, 3, 3, 2, 1, 1])
    session = np.array([AT_REST] * 4 + [LOADED] * 7)
    rows = np.arange(11)
    spans = Intervals(rows, rows * 0, rows + 1, 0.005)
    items = LabelledIntervals(tuple("abcd"), y, rows.astype(str), session, (spans,), {"no arm R": 1})
    made = of_both(items, (AT_REST, LOADED))
    assert made.classes == ("c",)
    assert made.y.tolist() == [0, 0, 0, 0]
    assert made.trial.tolist() == ["2", "3", "5", "8"]
    assert made.intervals[0].recording.tolist() == [2, 3, 5, 8]
    assert made.dropped == {"no arm R": 1, "class not in both batches": 7}


def test_what_is_said_to_know_no_offset_and_no_duration_does_not():
    for families in (PLAIN, RICHER):
        assert not set(families) & {*ABSOLUTE, "duration"}
    assert set(LEVELS) & set(ABSOLUTE) == {"levels"}
    assert "duration" in ALL
    named = [method for name, method in METHODS.items() if name.startswith("richer words and levels")]
    assert all(method.families == LEVELS for method in named)
    assert {grammar for method in METHODS.values() for grammar in method.grammars} == set(GRAMMARS)


def test_batches_of_failures_are_told_by_their_first_sample(hiro_recordings: Recordings):
    made = by_batch(hiro_recordings)
    failures = made.source == FAILURES
    assert set(made.session[failures]) == {AT_REST, LOADED}
    np.testing.assert_array_equal(made.session[~failures], hiro_recordings.session[~failures])
    first = np.abs(made.wrench[failures, 0, 0])
    assert first[made.session[failures] == AT_REST].max() < 0.1
    assert first[made.session[failures] == LOADED].min() > 1.5
    assert all({train, test} == {AT_REST, LOADED} for train, test in BATCHES.values())
