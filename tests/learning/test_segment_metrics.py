"""Scores of segmentations, against their definitions and known cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, f1_score

from rcbht_jax.errors import InputError
from rcbht_jax.learning import segment_metrics
from rcbht_jax.learning.metrics import percentile_interval, wilson
from rcbht_jax.learning.segment_metrics import (
    OVERLAPS,
    UNKNOWN,
    Segments,
    edit_distance,
    score_and_interval,
    segmentation_score,
)

LABELS = st.lists(st.integers(-1, 3), min_size=1, max_size=40)


def levenshtein(a: list[int], b: list[int]) -> int:
    if not a or not b:
        return len(a) + len(b)
    table = [[i + j if i * j == 0 else 0 for j in range(len(b) + 1)] for i in range(len(a) + 1)]
    for i in range(1, len(a) + 1):
        for j in range(1, len(b) + 1):
            change = table[i - 1][j - 1] + (a[i - 1] != b[j - 1])
            table[i][j] = min(table[i - 1][j] + 1, table[i][j - 1] + 1, change)
    return table[-1][-1]


def runs(labels: list[int]) -> list[tuple[int, int, int]]:
    out: list[tuple[int, int, int]] = []
    for i, label in enumerate(labels):
        if out and out[-1][0] == label and labels[i - 1] == label:
            out[-1] = (label, out[-1][1], i + 1)
        else:
            out.append((label, i, i + 1))
    return [run for run in out if run[0] != -1]


@given(st.lists(st.integers(0, 3), max_size=12), st.lists(st.integers(0, 3), max_size=12))
def test_edit_distance_is_levenshteins(a, b):
    assert edit_distance(np.array(a, int), np.array(b, int)) == levenshtein(a, b)


@given(LABELS)
def test_segments_are_the_runs(labels):
    found = Segments.of(np.array(labels))
    assert list(zip(found.label.tolist(), found.start.tolist(), found.end.tolist(), strict=True)) == runs(labels)


@given(LABELS, st.randoms())
def test_scores_are_their_definitions(labels, random):
    truth = np.array([*labels, 1])
    guess = np.array([random.choice([label, 0, 1, 2, 3]) for label in truth.tolist()])
    score = segmentation_score([truth], [guess], dt=0.5)
    known = truth != -1
    assert score.accuracy == pytest.approx(accuracy_score(truth[known], guess[known]))
    classes = np.unique(truth[known])
    macro = f1_score(truth[known], guess[known], labels=classes, average="macro", zero_division=0)
    assert score.macro_f1 == pytest.approx(macro)
    a, b = runs(truth.tolist()), runs(np.where(known, guess, -1).tolist())

    def overlap(x, y):
        inside = max(0, min(x[2], y[2]) - max(x[1], y[1]))
        return inside / (max(x[2], y[2]) - min(x[1], y[1])) if x[0] == y[0] else 0.0

    covering = sum((x[2] - x[1]) * max(overlap(x, y) for y in b) for x in a) / sum(x[2] - x[1] for x in a)
    assert score.covering == pytest.approx(covering)
    for least, value in zip(OVERLAPS, score.f1, strict=True):
        taken, right = set(), 0
        for y in b:
            best = max(range(len(a)), key=lambda k: overlap(a[k], y))
            if overlap(a[best], y) >= least and best not in taken:
                taken.add(best)
                right += 1
        assert value == pytest.approx(2 * right / (len(a) + len(b)))


def test_a_perfect_and_a_useless_segmentation():
    truth = [np.repeat([0, 1, 2], 20), np.repeat([0, 2], 30)]
    perfect = segmentation_score(truth, truth, 0.1)
    assert set(perfect.to_json().values()) == {1.0, 0.0}  # the delay is 0, all else 1
    assert perfect.delay == 0
    useless = segmentation_score(truth, [np.full(60, 3), np.full(60, 3)], 0.1)
    assert useless.accuracy == useless.edit == useless.covering == useless.found == useless.f1[0] == 0
    flicker = [np.arange(60) % 3, np.arange(60) % 3]
    assert segmentation_score(truth, flicker, 0.1).edit < 0.2
    assert segmentation_score(truth, flicker, 0.1).f1[2] == 0


def test_samples_without_annotation_count_nowhere():
    truth = np.array([-1, -1, 0, 0, 1, 1])
    first, second = np.array([3, 1, 0, 0, 1, 0]), np.array([0, 0, 0, 0, 1, 0])
    score = segmentation_score([truth], [first], 1)
    assert score == segmentation_score([truth], [second], 1)
    without = np.full(6, UNKNOWN)  # a recording that nobody has annotated
    assert score == segmentation_score([without, truth], [first, first], 1)
    assert score == segmentation_score([truth, without[:0]], [first, first[:0]], 1)
    with pytest.raises(InputError, match="No sample"):
        segmentation_score([np.array([-1])], [np.array([0])], 1)
    with pytest.raises(InputError, match="lengths differ"):
        segmentation_score([truth], [first[:3]], 1)


@pytest.mark.parametrize("ways", [1, 2])
def test_intervals_are_percentiles_of_scores_of_drawn_groups(ways: int, monkeypatch: pytest.MonkeyPatch):
    """One draw serves all ways, so that a recording whose group is drawn twice counts four times with two ways."""
    monkeypatch.setattr(segment_metrics, "RESAMPLES", 50)
    rng = np.random.default_rng(3)
    truth = [rng.integers(-1, 3, 40) for _ in range(10)]
    guess = [
        np.where(rng.random(40) < share, part, 1) for share, part in zip(np.linspace(0.3, 0.9, 10), truth, strict=True)
    ]
    groups = np.array(list("abbcddefgh"))
    interval = score_and_interval(truth, guess, 0.5, np.stack([groups] * ways, 1), seed=7)[1]
    draws = np.random.default_rng(7).multinomial(8, np.full(8, 1 / 8), 50)
    scores = []
    for draw in draws:
        rows = [i for i, group in enumerate(groups) for _ in range(draw["abcdefgh".index(group)] ** ways)]
        scores.append(segmentation_score([truth[i] for i in rows], [guess[i] for i in rows], 0.5).to_json())
    assert np.isnan(interval.pop("delay")).all()  # 0 in all draws
    for name, ends in interval.items():
        assert ends == pytest.approx(percentile_interval([score[name] for score in scores], len(np.unique(groups))))


def test_intervals_of_few_groups_are_wider_and_never_without_width():
    truth = [np.repeat([0, 1], 20)] * 12
    guess = [np.repeat([0, 1], (20 + shift, 20 - shift)) for shift in (0, 8, 2, 4, 1, 6, 0, 8, 2, 4, 1, 6)]

    def width(groups):
        low, high = score_and_interval(truth, guess, 0.1, groups)[1]["accuracy"]
        return high - low

    runs = np.arange(12)
    assert width(runs // 6) > 1.5 * width(runs)
    # rows that share a model are not independent either
    assert width(np.stack([runs // 6, runs], 1)) > 1.2 * width(runs)
    assert width(runs // 2) > 1.5 * width(runs)  # six pairs
    for count in (7, 8):  # groups of which Wilson's interval is taken, and of which groups are drawn
        score, interval = score_and_interval(truth[:count], guess[:count], 0.1, runs[:count])
        assert (interval["accuracy"] == wilson(score.accuracy * count, count)) == (count == 7)
    perfect = score_and_interval(truth, truth, 0.1, runs)[1]
    assert perfect["accuracy"] == wilson(12, 12)
    assert np.isnan(perfect["delay"]).all()  # the same in all draws
    assert np.isnan(score_and_interval(truth, truth, 0.1, runs // 6)[1]["delay"]).all()


@pytest.mark.filterwarnings("error")
def test_rounding_is_no_width_of_an_interval():
    truth = [np.repeat([0, 1, 2], 10)] * 9
    same = score_and_interval(truth, [np.ones(30, int)] * 9, 0.1, np.arange(9))[1]  # an edit score of 1/3 in every one
    assert same["edit"] == pytest.approx(wilson(3, 9))
    wrong = score_and_interval(truth, [np.full(30, 3)] * 9, 0.1, np.arange(9))[1]
    assert np.isnan(wrong["delay"]).all()


def test_intervals_from_few_groups_hold_the_truth():
    """Two operators, whose accuracies are drawn: drawing them again finds no more than the range between them."""
    rng, truth = np.random.default_rng(0), [np.repeat([0, 1], 50)] * 2
    held = []
    for _ in range(40):
        right = rng.random((2, 100)) < np.clip(rng.normal(0.8, 0.08, (2, 1)), 0, 1)
        guess = [np.where(good, part, 1 - part) for good, part in zip(right, truth, strict=True)]
        low, high = score_and_interval(truth, guess, 0.1, np.arange(2))[1]["accuracy"]
        held.append(low < 0.8 < high)
    assert np.mean(held) > 0.9
