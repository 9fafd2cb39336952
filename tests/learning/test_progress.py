"""Calibration by progress: it mends overconfident beliefs, and shows when it was fitted on what it should not see."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.alarms import held_out
from rcbht_jax.introspection.training import HeadSpec, snapshot_features, train_head, training_snapshots
from rcbht_jax.learning import metrics
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.progress import ProgressCalibration, mixed_jax, part_of, progress_arrays
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

TRIALS, STEPS, PLANNED = 60, 8, 8.0
SECONDS = np.tile(np.arange(STEPS) + 0.5, TRIALS)


def beliefs(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Training features, classes, trials, and a machine's features of new ones: nothing can be known before 4 s."""
    rng = np.random.default_rng(seed)
    trial = np.repeat(np.arange(TRIALS), STEPS)
    y = (trial % 2).astype(np.int64)
    x = rng.normal(size=(TRIALS * STEPS, 12)) + np.where(SECONDS > 4, 4.0 * y, 0.0)[:, None]
    return x, y, trial, SECONDS


def error(p: np.ndarray, y: np.ndarray) -> float:
    """Largest calibration error of a quarter."""
    quarter = part_of(SECONDS / PLANNED)
    return max(metrics.calibration_error(p[quarter == k], y[quarter == k]) for k in range(4))


def test_the_error_falls_and_a_calibrator_fitted_on_training_trials_is_noticed() -> None:
    x, y, trial, seconds = beliefs(0)
    spec = SvmSpec("rbf", 100.0, scaling=True)  # learns the noise by heart
    machine = ProbabilisticSvm(fit(x, y, ("a", "b"), spec), np.array([[-4.0, 0.0]]))  # and is sure of it
    new, truth, _, _ = beliefs(1)
    raw = machine.probability(new)
    unseen = held_out(machine, x, y, trial, x, trial, 0)
    right = ProgressCalibration.fit(unseen, y, seconds, trial, PLANNED)
    wrong = ProgressCalibration.fit(machine.probability(x), y, seconds, trial, PLANNED)
    assert error(raw, truth) > 0.3
    assert error(right(raw, seconds), truth) < 0.12
    assert error(wrong(raw, seconds), truth) > 0.25
    assert right.temperature[0] > 2 * wrong.temperature[0]


def test_the_stream_says_the_same() -> None:
    calibration = ProgressCalibration(8.0, (3.0, 1.0, 0.5, 0.7), (0.9, 0.2, 0.0, 0.1), (0.2, 0.3, 0.5))
    rng = np.random.default_rng(0)
    p, seconds = rng.dirichlet(np.ones(3), 40), rng.uniform(0, 12, 40)
    one = jax.vmap(lambda q, t: mixed_jax(progress_arrays(calibration), q, t))
    said = one(p.astype(np.float32), seconds.astype(np.float32))
    np.testing.assert_allclose(said, calibration(p, seconds), atol=1e-5)
    np.testing.assert_allclose(calibration(p, seconds).sum(1), 1.0)


@pytest.mark.parametrize(
    "fields",
    [
        (0.0, (1.0,), (0.0,), (0.5, 0.5)), (1.0, (0.0,), (0.0,), (0.5, 0.5)), (1.0, (1.0,), (1.5,), (0.5, 0.5)),
        (1.0, (1.0, 1.0), (0.0,), (0.5, 0.5)), (1.0, (1.0,), (0.0,), (0.5, 0.6)), (np.nan, (1.0,), (0.0,), (1.0,)),
    ],
)  # fmt: skip
def test_impossible_numbers_are_refused(fields: tuple) -> None:
    with pytest.raises(InputError, match="a prior that sums to one"):
        ProgressCalibration(*fields)


def test_parts_without_beliefs_stay_and_classes_without_mistakes_are_not_certain() -> None:
    p, y = np.array([[0.9, 0.1], [0.1, 0.9]] * 10), np.array([0, 1] * 10)
    made = ProgressCalibration.fit(p, y, np.full(20, 9.0), np.arange(20), 10.0)
    assert made.temperature[:3] == (1.0, 1.0, 1.0)
    assert 0.95 < made(p, np.full(20, 9.0)).max() < 0.99
    near = ProgressCalibration.fit(0.5 + 0.02 * (p - 0.5), y, np.full(20, 9.0), np.arange(20), 10.0)
    assert near.temperature[3] == pytest.approx(0.25)  # however much a colder one would gain
    with pytest.raises(InputError, match="expected at least one, and more than 0 s"):
        ProgressCalibration.fit(p, y, np.full(20, 9.0), np.arange(20), 0.0)


def test_a_trained_head_is_calibrated_on_trials_that_were_held_out() -> None:
    walks = np.random.default_rng(0).normal(size=(12, 100, 6)).cumsum(1)  # of which nothing can be learned
    recordings = Recordings.from_arrays(walks, outcome=["failure", "success"] * 6)
    spec, config = HeadSpec(TaskSpec("outcome"), families=("histogram",)), EncoderConfig()
    head = train_head(recordings, spec, config, preset())
    items = labelled_intervals(recordings, spec.task)
    shots = training_snapshots(items, 20, early=False)
    x = snapshot_features(recordings, shots, head.view, config, preset())
    y, trial, seconds = items.y[shots.interval], items.trial[shots.interval], (shots.now - shots.begin) * config.dt
    unseen = held_out(head.machine, x, y, trial, x, trial, 0)
    assert head.progress == ProgressCalibration.fit(unseen, y, seconds, trial, 0.5)
    seen = ProgressCalibration.fit(head.machine.probability(x), y, seconds, trial, 0.5)
    assert head.progress != seen
    cut = HeadSpec(TaskSpec("outcome", seconds=0.4), families=("histogram",))
    assert labelled_intervals(recordings, cut.task).intervals[0].end.tolist() == [80] * 12
    phase = replace(spec, phase=True)
    assert train_head(recordings, phase, config, preset()).progress is None  # the filter takes beliefs as they are


def test_few_trials_make_nobody_certain_however_many_steps_they_have() -> None:
    trial = np.repeat(np.arange(4), 50)
    y = trial % 2
    p = np.where(y[:, None] == np.arange(2), 0.9999, 0.0001)
    found = ProgressCalibration.fit(p, y, np.full(200, 1.0), trial, 1.0)(p, np.full(200, 1.0))
    assert found.max(1) == pytest.approx(1 - 0.5 / (4 + 2), abs=0.01)  # drawn inwards by one trial, not by one step
