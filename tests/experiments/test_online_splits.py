"""The splits of the streaming experiments: training reads one half of the trials, the scores read the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments._lib.streams import Stream, halves
from experiments.online import table2
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.introspection.training import Snapshots
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from tests.support.blank_trials import blank_trials

TRIALS, STATE, DT, EVERY, SEED = 16, 60, 0.005, 20, 3  # STATE: samples in each of the four states
FAST = Grid(kernels=("linear",), costs=(1.0,), scalings=(True,), inner=2)


class Spoilt(Stream):
    """A stream whose features are noise and the present state, but not numbers where nobody may read them."""

    hidden = False

    def described(self, snapshots: Snapshots, head: str) -> np.ndarray:
        columns = len(names(self.heads[head][0]))
        x = np.random.default_rng(0).normal(size=(len(snapshots), columns))
        state = np.minimum((snapshots.now - 1) // STATE, 3)
        x = (x + 3 * (np.arange(columns) % 4 == state[:, None])).astype(np.float32)
        inside, streamed = halves(self.items, SEED)[snapshots.interval], snapshots is self.regular
        return np.where(self.hidden & (inside == streamed)[:, None], np.nan, x)


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
    inside = halves(items, SEED)
    assert all(len(set(inside[items.trial == trial].tolist())) == 1 for trial in items.trial)
    assert inside.sum() == len(inside) / 2
    assert not np.array_equal(inside, halves(items, SEED + 1))


def test_table2_trains_on_one_half_and_scores_the_other() -> None:
    heads = {"state": (FeatureSpec(("levels", "histogram"), balance=True), FAST, 1)}
    made = []
    for hidden in (False, True):
        stream = Spoilt(
            blank_trials(TRIALS, STATE, DT), TaskSpec(), (EncoderConfig(), preset()), heads, 1 / (EVERY * DT)
        )
        stream.hidden = hidden
        made.append([table2.repeat(stream, relative, SEED) for relative in (False, True)])
    for one, other in zip(*made, strict=True):
        assert_same(one, other)
        probability, y_true = other[table2.WHOLE]
        assert np.isfinite(probability).all()
        np.testing.assert_array_equal(y_true, stream.items.y[~halves(stream.items, SEED)])
        assert other["full-sequence accuracy"] > 0.8
