"""Sets so large that the choice of hyper-parameters takes a part of them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax.learning import fitting, validation
from rcbht_jax.learning.class_groups import some_items
from rcbht_jax.learning.svm import Grid, SvmSpec, predictions, select
from rcbht_jax.learning.validation import nested_svm

GRID = Grid(("linear", "rbf"), (0.01, 1.0), inner=3)


@given(seed=st.integers(0, 99), trials=st.integers(1, 60), most=st.integers(1, 200), groups=st.integers(1, 60))
def test_some_items_are_whole_trials_with_groups_of_every_class(seed: int, trials: int, most: int, groups: int) -> None:
    rng = np.random.default_rng(seed)
    trial = np.sort(rng.integers(trials, size=150))
    y, group = rng.choice([0, 1, 4], 150, p=[0.9, 0.09, 0.01]), trial % groups
    rows = some_items(y, group, trial, seed, most)
    np.testing.assert_array_equal(rows, some_items(y, group, trial, seed, most))
    whole = np.isin(trial, trial[rows])
    for one in np.unique(y):
        assert len(np.unique(group[rows][y[rows] == one])) >= min(5, len(np.unique(group[y == one])))
    if most >= 150:
        assert len(rows) == 150
    elif whole.sum() > most:  # only the trials that the folds need, and an equal share of each class in each
        assert len(np.unique(trial[rows])) <= 5 * len(np.unique(y))
        for cell in {*zip(trial[rows].tolist(), y[rows].tolist(), strict=True)}:
            there = np.flatnonzero((trial == cell[0]) & (y == cell[1]))
            assert np.isin(there, rows).sum() == -(-most * len(there) // whole.sum())
    else:  # as many as fit: the next trial is no larger than the largest
        np.testing.assert_array_equal(rows, np.flatnonzero(whole))
        assert len(rows) > most - np.bincount(trial).max()


def test_few_long_trials_are_taken_in_part_evenly() -> None:
    """Five trials were taken whole, however long: the kernel of 300,000 snapshots takes 700 GB."""
    trial = np.repeat(np.arange(5), 2000)
    rows = some_items(np.tile([0, 1], 5000), trial, trial, 0, most=1000)
    for one in range(5):
        assert np.diff(rows[trial[rows] == one][::2]).tolist() == [20] * 99
    assert len(some_items(np.tile([0, 1], 5000), trial, trial, 0, 1000, np.full(10_000, 10))) == 100
    one = np.zeros(172, int)  # of which 51/172 are 51.00000000000001 in floating point
    assert len(some_items(one, one, one, 0, most=51)) == 51


def test_the_part_is_drawn_at_random() -> None:
    trial = np.repeat(np.arange(2000), 3)
    rows = some_items(np.tile([0, 1, 2], 2000), trial, trial, 0)
    assert len(rows) == 4998
    assert np.corrcoef(np.isin(np.arange(2000), trial[rows]), np.arange(2000))[0, 1] == pytest.approx(0, abs=0.05)
    assert len({trial[some_items(trial % 2, trial, trial, seed, most=1)].max() for seed in range(3)}) > 1


def test_a_classifier_of_many_is_chosen_on_a_part_and_trained_on_all(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    y = np.tile([0, 1, 3], 60)
    x = rng.normal(size=(180, 4)) + y[:, None]
    trial = np.arange(180) // 3
    train, test = np.flatnonzero(trial < 45), np.flatnonzero(trial >= 45)
    chosen: list[int] = []

    def spy(x: Any, *more: Any) -> Any:
        chosen.append(len(x[""]))
        return select(x, *more)

    monkeypatch.setattr(validation, "some_items", partial(some_items, most=60))
    monkeypatch.setattr(validation, "LARGEST", 60)
    monkeypatch.setattr(validation, "select", spy)
    predicted, spec = nested_svm({"": x}, y, trial, GRID)(train, test, 0)
    assert chosen == [60]
    (expected,) = predictions(x, y, train, test, SvmSpec(**spec), [spec["cost"]])
    np.testing.assert_array_equal(predicted, expected)


def test_a_model_states_on_how_many_it_was_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "some_items", partial(some_items, most=12))
    example = rj.Recordings.example()
    wrench = np.concatenate([example.wrench] * 3) + np.random.default_rng(0).normal(0, 0.01, (24, 1, 6))
    made = rj.Recordings.from_arrays(list(wrench), 200.0, outcome=np.tile(example.outcome, 3))
    tracks = rj.encode(made.wrench, rate=200)
    model = fitting.train(made, tracks, rj.TaskSpec("outcome"), rj.FeatureSpec(("histogram",)), GRID)
    assert (model.extra["chosen_on"], model.extra["items"]) == (12, 24)
