"""The splits of the streaming experiments: training reads one half of the trials, the scores read the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments.online import table2
from rcbht_jax.features.online import names
from rcbht_jax.introspection.training import Snapshots, regular_snapshots, training_snapshots
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from tests.support.blank_trials import blank_trials

TRIALS, STATE, DT, EVERY, SEED = 16, 60, 0.005, 20, 3  # STATE: samples in each of the four states
FAST = Grid(kernels=("linear",), costs=(1.0,), scalings=(True,), inner=2)


def features(snapshots: Snapshots, columns: int) -> np.ndarray:
    """Noise, and the present state in every fourth column."""
    x = np.random.default_rng(0).normal(size=(len(snapshots), columns))
    state = np.minimum((snapshots.now - 1) // STATE, 3)
    return (x + 3 * (np.arange(columns) % 4 == state[:, None])).astype(np.float32)


def spoilt(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Features of these rows that nobody may read: training refuses them, and their probabilities are not numbers."""
    return np.where(rows[:, None], np.nan, x)


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, tuple):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        np.testing.assert_array_equal(one, other)


@pytest.fixture
def items() -> LabelledIntervals:
    return labelled_intervals(blank_trials(TRIALS, STATE, DT), TaskSpec())


def test_halves_never_divide_a_trial(items: LabelledIntervals) -> None:
    inside = table2.halves(items, SEED)
    assert all(len(set(inside[items.trial == trial].tolist())) == 1 for trial in items.trial)
    assert inside.sum() == len(inside) / 2
    assert not np.array_equal(inside, table2.halves(items, SEED + 1))


def test_table2_trains_on_one_half_and_scores_the_other(
    items: LabelledIntervals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table2, "GRID", FAST)
    x: dict[str, Any] = {"picked": training_snapshots(items, EVERY), "streamed": regular_snapshots(items, EVERY)}
    families = ("levels",)
    x["family"] = np.array([name.split(".")[0] for name in names(table2.FeatureSpec(families=families))])
    x |= {f"{part}_x": features(x[part], len(x["family"])) for part in ("picked", "streamed")}
    inside = table2.halves(items, SEED)
    hidden = {
        "picked_x": spoilt(x["picked_x"], ~inside[x["picked"].interval]),
        "streamed_x": spoilt(x["streamed_x"], inside[x["streamed"].interval]),
    }
    result = table2.repeat(x, items, families, SEED, DT)
    assert_same(table2.repeat(x | hidden, items, families, SEED, DT), result)
    probability, y_true = result[table2.WHOLE]
    assert np.isfinite(probability).all()
    np.testing.assert_array_equal(y_true, items.y[~inside])
    assert result["full-sequence accuracy"] > 0.8
