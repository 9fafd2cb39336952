"""Sentences about confounds: present where the data has them, absent where it has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2_contingency

from rcbht_jax.features import Intervals
from rcbht_jax.learning import confounds as module
from rcbht_jax.learning.confounds import confounds
from rcbht_jax.learning.evaluation import EvaluationProtocol, score
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import Recordings
from tests.support.store_cases import simple


def labelled(session: str, length: list[int], y: list[int]) -> LabelledIntervals:
    """One interval per recording."""
    count = len(y)
    intervals = Intervals(np.arange(count), np.zeros(count, np.int64), np.array(length), 0.1)
    trial = np.array([f"t{k}" for k in range(count)])
    return LabelledIntervals(("failure", "success"), np.array(y), trial, np.array(list(session)), (intervals,), {})


def test_balanced_data_is_told_nothing():
    recordings = simple(8)
    assert (
        confounds(labelled("ABABABAB", [20, 20, 30, 30] * 2, [0, 0, 1, 1, 1, 1, 0, 0]), WrenchFacts.of(recordings))
        == ()
    )


def test_durations_predict_items_that_had_no_part_in_the_medians():
    """With each item in its own class's median, all four would be right."""
    score = module.duration_score(np.array([1.0, 3.0, 3.1, 5.0]), np.array([0, 0, 1, 1]))
    assert score == 0.5
    assert module.duration_score(np.array([1.0, 3.0, 3.1]), np.array([0, 0, 1])) == 0.25  # nothing is left of a class


@given(st.lists(st.integers(0, 5), min_size=2, max_size=9))
def test_the_median_of_the_others_is_what_numpy_says(values):
    each = [np.median(np.delete(values, one)) for one in range(len(values))]
    assert module._median_of_others(np.array(values, float)) == pytest.approx(each)


@pytest.mark.parametrize(
    ("items", "sentence"),
    [
        (labelled("CCAB", [20, 30, 30, 20], [0, 0, 1, 1]), "No session holds more than one class: A (success), B (suc"),
        (labelled("CAAA", [20, 30, 30, 20], [0, 0, 1, 1]), "a single class have 25% of the intervals: C (failure);"),
        (
            labelled("AAAAABBBBB" * 2, [20, 30] * 10, [0, 0, 0, 0, 1, 0, 1, 1, 1, 1] * 2),
            "chance 50%): failure from success 80%;",
        ),
        (labelled("AAAA", [20, 21, 40, 41], [0, 0, 1, 1]), "balanced accuracy of 100% (chance 50%)"),
        (labelled("AAAA", [1, 30, 30, 1], [0, 0, 1, 1]), "1 of 2 intervals of failure is one sample long."),
    ],
)
def test_each_confound_has_its_sentence(items, sentence):
    assert sentence in " ".join(confounds(items))


def test_sessions_that_share_few_classes_are_named():
    """Two sessions with two classes each: no session has a single class, but four pairs of classes share none."""
    items = replace(labelled("AAAABBBB", [20] * 8, [0, 1, 0, 1, 2, 3, 2, 3]), classes=("a", "b", "c", "d"))
    scores, count = module.session_scores(items)
    assert scores[0].tolist() == [0.5, 0.5, 1.0, 1.0]
    assert module._by_chance(count) == pytest.approx(chi2_contingency([[2, 2, 0, 0], [0, 0, 2, 2]]).pvalue)
    (found,) = confounds(items)
    assert "a from c 100%, a from d 100%, b from c 100%, b from d 100%;" in found
    assert confounds(items.take(np.array([0, 1, 2, 3, 4, 5]))) == ()  # six trials may be divided so by chance
    shared = replace(items, trial=np.array(list("abcdabcd")), session=np.array(list("AABBAABB")))
    assert confounds(shared) == ()  # every trial has two of the classes, as the phases of a task


def test_a_confound_has_to_predict_more_than_half_of_what_chance_does_not():
    """Three quarters by duration are half of what chance leaves; four fifths are more."""
    few = confounds(labelled("A" * 8, [20, 20, 20, 30, 30, 30, 30, 20], [0] * 4 + [1] * 4))
    more = confounds(labelled("A" * 10, [20, 20, 20, 20, 30, 30, 30, 30, 30, 20], [0] * 5 + [1] * 5))
    assert few == ()
    assert "balanced accuracy of 80%" in " ".join(more)


def test_either_arm_may_differ_in_length():
    one, other = (labelled("AAAA", length, [0, 0, 1, 1]) for length in ([20, 30, 30, 20], [20, 21, 40, 41]))
    assert "differ in length" in " ".join(confounds(replace(one, intervals=(*one.intervals, *other.intervals))))


def test_only_what_is_classified_can_confound():
    """Copies among other recordings, and the beginnings of recordings that intervals do not begin with."""
    y = np.repeat([0, 1], 2)
    recordings = Recordings.from_arrays(
        np.random.default_rng(0).normal(size=(6, 40, 3)) + 50.0 * np.array([0, 0, 1, 1, 1, 1])[:, None, None], rate=10
    )
    recordings.wrench[5] = recordings.wrench[4]
    items, facts = labelled("AAAA", [30, 40, 40, 30], y.tolist()), WrenchFacts.of(recordings)
    (spans,) = items.intervals
    inside = replace(items, intervals=(replace(spans, start=np.array([0, 1, 1, 0])),))
    assert ["first second" in " ".join(confounds(one, facts)) for one in (items, inside)] == [True, False]
    assert "copies" not in " ".join(confounds(items, facts))


def test_one_session_is_no_confound_and_copies_are_counted():
    recordings = simple(4)
    recordings.wrench[3] = recordings.wrench[1]
    found = confounds(labelled("AAAA", [20, 30, 30, 20], [0, 0, 1, 1]), WrenchFacts.of(recordings))
    assert found == ("Exact copies of another recording: 1; keep copies on one side of every split.",)


def test_first_seconds_have_no_centre_of_a_class_of_one() -> None:
    assert module.first_mean_score(np.array([[5.0], [5.2], [0.0]]), np.array([0, 0, 1])) == 0.5


@pytest.mark.parametrize(("items", "samples", "told"), [(4, 201, True), (4, 200, False), (3, 201, False)])
def test_first_seconds_are_judged_in_two_items_a_class_and_more_than_two_seconds(
    items: int, samples: int, told: bool
) -> None:
    outcome = np.array(["success", "success", "failure", "failure"])[:items]
    wrench = np.random.default_rng(0).normal(size=(items, samples, 3)) + 50.0 * (outcome == "success")[:, None, None]
    recordings = Recordings.from_arrays(wrench, rate=100, outcome=outcome)
    found = confounds(labelled_intervals(recordings, TaskSpec("outcome")), WrenchFacts.of(recordings))
    assert ("first second predicts" in " ".join(found)) == told


def test_a_bias_that_gives_the_class_away_is_told_by_the_first_second() -> None:
    rng = np.random.default_rng(0)
    outcome = np.array(["success", "failure"] * 10)
    plain = rng.normal(size=(20, 500, 3)) * 0.1
    biased = plain + np.where(outcome == "success", 0.5, 0.0)[:, None, None]
    texts = []
    for wrench in (plain, biased):
        recordings = Recordings.from_arrays(wrench, outcome=outcome, session=np.repeat(["a", "b"], 10))
        items = labelled_intervals(recordings, TaskSpec("outcome"))
        texts.append(" ".join(confounds(items, WrenchFacts.of(recordings))))
    assert "first second" not in texts[0]
    assert "The nearest mean of the first second predicts the classes with a balanced accuracy of 100%" in texts[1]


def test_a_session_that_is_not_scored_says_nothing_about_the_score():
    """C, which is neither trained on nor tested on, holds a single class and a class of its own."""
    items = labelled("AAAABBBBCC", [100] * 10, [0, 1, 0, 1, 0, 1, 0, 1, 1, 1])
    grid = Grid(kernels=("linear",), costs=(1.0,), scalings=(False,), inner=2)
    said = {}
    for train in (("A",), ("A", "C")):
        protocol = EvaluationProtocol(grid=grid, train_on=train, test_on=("B",))
        said[train] = score(items, {"": np.eye(2)[items.y]}, protocol, {}, {}).confounds
    assert ["C (success)" in sentences for sentences in said.values()] == [False, True]
