"""Training by gradients, step by step: losses by NumPy from given shares, and what a loop over fake steps is told."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.calibration import gradient
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.gradient import Batch, GradientOptions, Parameters, calibrate
from rcbht_jax.calibration.label_durations import fit_windows
from rcbht_jax.calibration.objective import RIDGE
from rcbht_jax.calibration.rest import RestSlopes
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError

CONFIG = EncoderConfig(dt=0.004)  # no other test's, whose compiled steps would be taken for those of the fakes
TRIALS, SENTENCES = 5, 3
RNG = np.random.default_rng(0)
SHARES = RNG.uniform(0, 0.2, (TRIALS, SENTENCES, 150)).astype(np.float32)
Y = RNG.integers(0, 2, (TRIALS, SENTENCES)).astype(np.int32)
Y[:, 0] = 0, 1, 0, 1, 0
LIMITS = np.asarray(preset().limits)


def corpus() -> CalibrationData:
    """Each trial is known by its constant force."""
    wrench = np.broadcast_to(np.arange(TRIALS, dtype=np.float32)[:, None, None], (TRIALS, 33, 6))
    edges, length = np.tile(np.array([0, 10, 20, 33], np.int32), (TRIALS, 1)), np.full(TRIALS, 33, np.int32)
    names = np.array([f"t{k}" for k in range(TRIALS)])
    return CalibrationData(wrench, fit_windows(CONFIG, wrench, length), edges, Y, ("slow", "fast"), names)


@pytest.fixture
def _given_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shares of each trial without an encoder."""
    monkeypatch.setattr(gradient, "soft_encode", lambda _, limits, wrench, *_args: wrench[:, 0, 0].astype(jnp.int32))
    monkeypatch.setattr(gradient, "soft_shares", lambda trial, _: jnp.asarray(SHARES)[trial])


@pytest.mark.usefixtures("_given_shares")
def test_a_logistic_loss_counts_the_bias() -> None:
    weights, bias = RNG.normal(size=(150, 2)).astype(np.float32), np.array([0.5, -1.5], np.float32)
    parameters = Parameters(gradient._free(preset()), jnp.asarray(weights), jnp.asarray(bias))
    batch = gradient.batch_of(corpus(), CONFIG)
    logits = 4 * SHARES.astype(np.float64) @ weights + bias
    right, wrong = (np.take_along_axis(logits, y[..., None], -1) for y in (Y, 1 - Y))
    found = gradient.loss(CONFIG, GradientOptions(), parameters, batch, 1.0)
    assert float(found) == pytest.approx(np.log1p(np.exp(wrong - right)).mean(), rel=1e-5)


def test_no_sample_of_a_sentence_is_left_out_at_the_end() -> None:
    weights = gradient.batch_of(corpus(), CONFIG).weights
    np.testing.assert_array_equal(weights.sum(-1), [[10, 10, 13]] * TRIALS)


@pytest.mark.usefixtures("_given_shares")
def test_the_fit_loss_is_what_trials_left_out_leave_unexplained() -> None:
    """Ridge regression on the roots of the shares, fitted again for every trial."""
    batch = gradient.batch_of(corpus(), CONFIG)
    parameters = Parameters(gradient._free(preset()), jnp.zeros((150, 2)), jnp.zeros(2))
    found = jax.jit(lambda p: gradient.loss(CONFIG, GradientOptions(loss="fit"), p, batch, 1.0))(parameters)
    x, target = np.sqrt(SHARES.astype(np.float64) + 1e-4), np.eye(2)[Y]
    x = np.concatenate([x - x.mean((0, 1)), np.ones((TRIALS, SENTENCES, 1))], -1)
    penalty = RIDGE * TRIALS * SENTENCES * np.diag([1.0] * 150 + [1e-3])
    error = []
    for trial in range(TRIALS):
        others, classes = (np.delete(table, trial, 0).reshape(-1, table.shape[-1]) for table in (x, target))
        error.append(target[trial] - x[trial] @ np.linalg.solve(others.T @ others + penalty, others.T @ classes))
    spread = np.square(target - target.mean((0, 1))).sum()
    assert float(found) == pytest.approx(np.square(error).sum() / spread, rel=2e-5)


def test_the_root_of_a_share_has_a_slope_where_the_share_is_0(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradient, "soft_encode", lambda _, limits, *_args, **__: limits.limits[0, 0])
    monkeypatch.setattr(gradient, "soft_shares", lambda limit, _: jnp.asarray(SHARES).at[0].set(0) * limit)
    parameters = Parameters(gradient._free(preset()), jnp.zeros((150, 2)), jnp.zeros(2))
    batch = gradient.batch_of(corpus(), CONFIG)
    slope = jax.jit(jax.grad(lambda p: gradient.loss(CONFIG, GradientOptions(loss="fit"), p, batch, 1.0)))
    assert np.isfinite(slope(parameters).free).all()


@pytest.mark.usefixtures("_given_shares")
def test_a_step_sees_the_trials_of_its_batch_alone() -> None:
    """With vanishing rates the classifier stays as it began, so that the losses of a pass are those of the trials."""
    options = GradientOptions(steps=TRIALS, rate=1e-12, rate_weights=1e-12, batch=1, decay=0.0, seed=7)
    trained = calibrate(corpus(), CONFIG, preset(), options)
    start = gradient._first(np.asarray(gradient._free(preset()), np.float32), 2, options)
    assert (start.weights != gradient._first(np.asarray(start.free), 2, GradientOptions()).weights).all()
    logits = 4 * SHARES.astype(np.float64) @ np.asarray(start.weights)
    right, wrong = (np.take_along_axis(logits, y[..., None], -1) for y in (Y, 1 - Y))
    expected = np.log1p(np.exp(wrong - right)).mean((1, 2))
    losses = np.array(trained.history)[:, 1]
    np.testing.assert_allclose(np.sort(losses), np.sort(expected), rtol=1e-5)
    order = [next(rows).tolist() for rows in [gradient._orders(TRIALS, options)] for _ in range(TRIALS)]
    np.testing.assert_allclose(losses, expected[np.ravel(order)], rtol=1e-5)
    other = gradient._orders(TRIALS, GradientOptions(batch=1, seed=8))
    assert order != [next(other).tolist() for _ in range(TRIALS)]


def fake_training(monkeypatch: pytest.MonkeyPatch, loss: float = 1.0) -> dict[str, list[Any]]:
    """Steps that raise all limits by a tenth, and what they and the losses of other trials are given."""
    told: dict[str, list[Any]] = {"inside": [], "outside": [], "rows": []}

    def step(_c: Any, _o: Any, _s: Any, now: Parameters, state: Any, _b: Any, rows: Any, heat: Any, _r: Any) -> Any:
        told["inside"].append(float(heat))
        told["rows"].append(rows.tolist())
        return now._replace(free=now.free.at[:, 0].add(np.log(1.1))), state, jnp.float32(loss)

    def outside(_c: Any, _o: Any, _now: Parameters, _batch: Batch, heat: Any) -> jax.Array:
        told["outside"].append(float(heat))
        return jnp.float32(2.0)

    monkeypatch.setattr(gradient, "_step", step)
    monkeypatch.setattr(gradient, "_loss", outside)
    return told


def test_training_cools_by_equal_factors_and_tells_of_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    told, done = fake_training(monkeypatch), list[int]()
    options = GradientOptions(steps=3, temperature=(1.6, 0.1))
    trained = calibrate(corpus(), CONFIG, preset(), options, held_out=corpus(), progress=done.append)
    np.testing.assert_allclose(told["inside"], [1.6, 0.4, 0.1], rtol=1e-6)
    assert told["outside"] == told["inside"]
    assert told["rows"] == [list(range(TRIALS))] * 3
    assert done == [1, 1, 1]
    small = trained.path[:, :, 3] / LIMITS[:, 3]
    np.testing.assert_allclose(small, np.repeat([[1.1], [1.21], [1.331]], 6, 1), rtol=1e-5)
    np.testing.assert_array_equal(trained.thresholds.limits, trained.path[-1])
    seconds, inside, outside = zip(*trained.history, strict=True)
    assert (inside, outside) == ((1.0,) * 3, (2.0,) * 3)
    assert 0 <= seconds[0] <= seconds[1] <= seconds[2]


@pytest.mark.parametrize("loss", [np.nan, np.inf])
def test_a_training_that_diverges_is_refused(monkeypatch: pytest.MonkeyPatch, loss: float) -> None:
    fake_training(monkeypatch, loss)
    with pytest.raises(InputError, match="diverged"):
        calibrate(corpus(), CONFIG, preset(), GradientOptions(steps=1))


def test_a_start_of_the_other_rule_or_with_one_limit_twice_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_training(monkeypatch)
    with pytest.raises(InputError, match="gradient thresholds alone"):
        calibrate(corpus(), CONFIG, FitLimits(LIMITS, np.ones(6)), GradientOptions(steps=1))
    flat = LIMITS.copy()
    flat[2, 1] = flat[2, 0]
    with pytest.raises(
        InputError, match=r"strictly ordered thresholds; those of an axis are \[70.0, 70.0, 23.0, 1.0\]"
    ):
        calibrate(corpus(), CONFIG, GradientThresholds(flat), GradientOptions(steps=1))


@pytest.mark.parametrize(
    "wrong",
    [{"steps": 0}, {"batch": -1}, {"temperature": (1.0, 0.0)}, {"rate": 0.0}, {"rate_weights": 0.0}],
)
def test_options_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected positive numbers, of batch also 0"):
        GradientOptions(**wrong)


@pytest.mark.usefixtures("_given_shares")
def test_steps_go_against_the_penalties_at_rates_of_their_own_and_tell_the_loss_without_them() -> None:
    """Adam's first step has the size of its rate in every coordinate, against the sign of the derivative."""
    options = GradientOptions(steps=1, rate=0.01, rate_weights=0.3, decay=1e6)
    start = gradient._first(np.asarray(gradient._free(preset()), np.float32), 2, options)
    steep = RestSlopes(np.repeat(3 * LIMITS[:, 3:], 4, axis=1))  # rest is steeper than what is called constant
    trained = calibrate(corpus(), CONFIG, preset(), options, rest=steep)
    assert (trained.thresholds.limits[:, 3] > LIMITS[:, 3]).all()
    np.testing.assert_allclose(trained.parameters.weights, start.weights - 0.3 * np.sign(start.weights), rtol=1e-3)
    moved = np.abs(np.asarray(trained.parameters.free) - np.asarray(start.free))
    np.testing.assert_allclose(moved[moved > 0], 0.01, rtol=1e-3)
    alone = gradient.loss(CONFIG, options, start, gradient.batch_of(corpus(), CONFIG), 1.0)
    assert trained.history[0][1] == pytest.approx(float(alone), rel=1e-5)
