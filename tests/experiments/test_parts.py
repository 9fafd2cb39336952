"""Parts of the experiments that decide what a number means: draws, splits, standing beliefs; and the figures draw."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from experiments._lib.benchmarks import BENCHMARKS
from experiments._lib.results_io import COMMITTED
from experiments.classification import peers, probes, table1_ours
from experiments.figures import all as figures
from experiments.online import confidence, table2
from rcbht_jax.introspection.training import Snapshots
from tests.experiments.test_raw_learners import items


def test_a_held_out_session_is_on_one_side_and_failures_on_both() -> None:
    facts = items([10] * 20)
    session = np.where(facts.y == 0, "C", np.where(np.arange(20) < 8, "A", "B"))
    facts = dataclasses.replace(facts, session=session, trial=np.arange(20).astype(str))
    seen = set()
    for seed in range(5):
        (train, test), back = probes.held_out(facts, ("A", "B"), seed)
        assert sorted([*train, *test]) == list(range(20))
        np.testing.assert_array_equal(back[0], test)
        assert set(session[train]) == {"A", "C"}
        assert set(session[test]) == {"B", "C"}
        assert np.sum(session[train] == "C") == np.sum(session[test] == "C") == 5
        seen.add(tuple(train.tolist()))
    assert len(seen) > 1


def test_classes_are_drawn_in_equal_number() -> None:
    facts = dataclasses.replace(items([10] * 12), y=np.array([0] * 9 + [1] * 3))
    np.testing.assert_array_equal(table1_ours.drawn(facts, False, 0), np.arange(12))
    draws = [table1_ours.drawn(facts, True, seed) for seed in range(4)]
    for rows in draws:
        assert len(set(rows.tolist())) == 6
        assert np.bincount(facts.y[rows]).tolist() == [3, 3]
    assert len({tuple(sorted(rows.tolist())) for rows in draws}) > 1


def test_a_belief_stands_until_the_next() -> None:
    now = np.array([60, 90, 10, 110])  # the third look is another sentence's
    begin = np.full(4, 10)
    snapshots = Snapshots(np.array([3, 3, 2, 3]), np.zeros(4, np.int64), begin, now, now == 110)
    course = confidence.held(snapshots, np.array([0.2, 0.4, 9.0, 1.0]), 3, 100)
    expected = [0.4 if k >= 16 else 0.2 if k >= 10 else np.nan for k in range(confidence.PARTS)]
    np.testing.assert_array_equal(course, expected)


def test_few_sequences_look_badly_calibrated_even_when_they_are_not() -> None:
    rng, runs = np.random.default_rng(0), []
    for _ in range(60):
        p = rng.dirichlet([3, 1, 1], 40)
        truth = (p.cumsum(1)[:, :2] < rng.random((40, 1))).sum(1)
        runs.append({table2.WHOLE: (p, truth), "kept": 1})
    found = table2.together(runs, 0)
    assert runs == [{"kept": 1}] * 60
    assert found["ECE full sequences, repeats together"] < 0.04 < 0.06 < found[table2.CHANCE]


def test_moments_that_most_sentences_lack_are_left_out() -> None:
    p = np.array([[np.nan, 0.5], [np.nan, 0.7], [0.9, 0.9]])
    found = confidence.summary(p)
    assert found["mean"] == [None, pytest.approx(0.7)]
    assert found["low"][1] == pytest.approx(0.54)
    assert found["high"][1] == pytest.approx(0.86)


def test_the_slow_are_repeated_less() -> None:
    assert peers.repeats_of("REAL states", "majority", 10) == 10
    assert peers.repeats_of("failure types", "majority", 10) == 2
    assert peers.repeats_of("REAL states", "MultiRocketHydra + ridge", 10) == 2
    assert {peers.kind(name) for name in (*peers.PEERS, *peers.PROBES, *peers.OURS)} == {"peer", "probe", "ours"}


def test_the_committed_comparison_has_every_cell() -> None:
    result = json.loads((COMMITTED / "peers.json").read_text())["result"]
    methods = (*peers.PEERS, *peers.PROBES, *peers.OURS)
    assert set(result["rows"]) == {f"{benchmark} | {method}" for benchmark in BENCHMARKS for method in methods}
    for name in ("peers", "probes", "curves", "confidence", "table1_ours"):
        assert json.loads((COMMITTED / f"{name}.json").read_text())["result"]["complete"], name


@pytest.mark.parametrize("name", ["peers", "training-size", "kernel-cost", "confidence"])
def test_figures_draw_what_is_committed(name: str) -> None:
    figure = figures.FIGURES[name]()
    assert len(figure.axes) >= 2
    assert all(ax.has_data() for ax in figure.axes)
