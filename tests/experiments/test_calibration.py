"""Parts of the experiment with a bank of thresholds."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.calibration.bank import BANK, METHODS, Bank, filled_in
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from tests.calibration.test_contextual import recordings
from tests.support.snaps import marked

Y = np.repeat(np.arange(3), 10)
GROUPS = np.tile(np.arange(10), 3).astype(str)
TRAIN, TEST = np.flatnonzero(GROUPS.astype(int) < 7), np.flatnonzero(GROUPS.astype(int) >= 7)


def bank(useful: int, poison: float = 0.0) -> Bank:
    """Only one member says anything of the class; the test items may be spoilt."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(len(BANK), 30, 12)).astype(np.float32)
    x[useful] = np.eye(3)[Y].repeat(4, axis=1) + 0.1 * x[useful]
    x[:, TEST] += poison * rng.normal(size=x[:, TEST].shape)
    return Bank(x, Y, GROUPS, np.arange(len(BANK), dtype=float))


def test_the_preset_comes_first_and_every_encoder_once():
    assert BANK[0] == (5, 1.0, 1.0)
    assert len(set(BANK)) == len(BANK)


def test_weights_follow_the_classes_of_the_training_side():
    made = bank(useful=4)
    weight = made.alignment(TRAIN)
    assert weight.argmax() == 4
    np.testing.assert_allclose(weight.sum(), 1)
    # The alignment is the cosine of centred kernels: of a kernel with the classes' own it is 1.
    kernels = made._kernels_of(TRAIN)[:, TRAIN][:, :, TRAIN].astype(float)
    ideal = (Y[TRAIN, None] == Y[TRAIN]).astype(float)
    centred = [k - k.mean(0)[None] - k.mean(1)[:, None] + k.mean() for k in (*kernels, ideal)]
    cosine = [max(0, np.vdot(k, centred[-1]) / np.linalg.norm(k)) for k in centred[:-1]]
    np.testing.assert_allclose(weight, np.array(cosine) / np.sum(cosine), rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_chosen_on_the_test_side(method):
    (said, chosen), (spoilt, same) = (bank(0, poison).learner(method)(TRAIN, TEST, 0) for poison in (0.0, 1e3))
    assert chosen == same
    assert (said != spoilt).any()
    if not method.startswith("average"):  # which most members are noise in
        assert (said == Y[TEST]).all()


def test_marks_filled_in_by_hand():
    some = recordings(trials=3)
    items = labelled_intervals(some, TaskSpec())
    end = some.length * some.dt
    onset = np.stack([0 * end, 0.1 * end, 0.2 * end, 0.2 * end + [1.0, 0.3, 0.4]], 1)
    onset[1, 3] = end[1] - 1.005
    found = filled_in(marked(some, onset), items)
    assert {str(name) for name in items.trial[found]} == {"t0", "t1"}
