"""Soft labels against the hard encoder and central differences; training by gradients."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.calibration import gradient
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.gradient import GradientOptions, _orders, calibrate
from rcbht_jax.calibration.label_durations import fit_windows, label_durations
from rcbht_jax.calibration.objective import shares
from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.encoding.soft import SoftLabels, overlaps, soft_encode, soft_shares, soft_windows
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError

CONFIG = EncoderConfig(window=5, dt=0.005)
LENGTH = np.array([303, 200, 298], np.int32)
EDGES = np.array([[0, 102, 303], [0, 77, 200], [0, 150, 290]], np.int32)
LIMITS = np.asarray(preset().limits)


def signal(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    busy = np.repeat(rng.choice([0.003, 0.05, 0.6], (3, 31, 6)), 10, axis=1)[:, :303]
    return np.cumsum(rng.normal(size=(3, 303, 6)) * busy, axis=1) * np.where(np.arange(6) < 3, 1, 0.1)


def hard_on_grid(track, windows: int) -> np.ndarray:
    """Label over each window ``[trial, axis, window]``, from the published spans."""
    grid = np.zeros((*track.label.shape[:2], windows), int)
    for index in np.argwhere(np.asarray(track.label) > 0):
        trial, axis, slot = index
        t0, t1 = int(track.t0[trial, axis, slot]), int(track.t1[trial, axis, slot])
        grid[trial, axis, t0 // 5 : -(-t1 // 5)] = int(track.label[trial, axis, slot])
    return grid


soft = jax.jit(soft_encode, static_argnums=0)


@pytest.fixture(scope="module")
def hard():
    wrench = jnp.asarray(signal(), jnp.float32)
    return jax.jit(encode, static_argnums=0)(CONFIG, jnp.asarray(LIMITS, jnp.float32), wrench, jnp.asarray(LENGTH))


def test_cold_labels_are_the_hard_ones(hard):
    wrench, limits = jnp.asarray(signal(), jnp.float32), jnp.asarray(LIMITS, jnp.float32)
    made = soft(CONFIG, limits, wrench, jnp.asarray(LENGTH), 1e-3)
    for layer, least in (("primitive", 1.0), ("mc", 0.995), ("llb", 0.995)):
        x = np.asarray(getattr(made, layer))
        grid = hard_on_grid(getattr(hard, layer), x.shape[2])
        on = grid > 0
        np.testing.assert_allclose(x.sum(-1)[on], 1, atol=1e-5)
        assert (x.sum(-1)[~on] == 0).all()
        assert (x.argmax(-1) + 1 == grid)[on].mean() >= least


def test_warm_labels_are_distributions_that_prefer_the_hard_label(hard):
    wrench, limits = jnp.asarray(signal(), jnp.float32), jnp.asarray(LIMITS, jnp.float32)
    made = soft(CONFIG, limits, wrench, jnp.asarray(LENGTH), 0.3)
    for layer in ("primitive", "mc", "llb"):
        x = np.asarray(getattr(made, layer))
        grid = hard_on_grid(getattr(hard, layer), x.shape[2])
        assert x.min() >= 0
        assert (x.argmax(-1) + 1 == grid)[grid > 0].mean() > 0.8
        assert np.sort(x[grid > 0], -1)[:, -2].max() > 0.05  # it is soft


def test_shares_of_hard_labels_are_the_shares_of_the_search(hard):
    wrench = signal().astype(np.float32)
    windows = fit_windows(CONFIG, wrench, LENGTH)
    limits = jnp.asarray(LIMITS, jnp.float32)
    times = label_durations(CONFIG, limits[None], windows, jnp.asarray(EDGES))[0]
    grids = (hard_on_grid(getattr(hard, layer), 61) for layer in ("primitive", "mc", "llb"))
    made = SoftLabels(*(jax.nn.one_hot(grid - 1, size) for grid, size in zip(grids, (9, 8, 8), strict=True)))
    weights = overlaps(jnp.asarray(EDGES), 61, 5)
    np.testing.assert_array_equal(weights.sum(-1), np.diff(EDGES))
    np.testing.assert_allclose(soft_shares(made, weights), shares(times), atol=1e-6)


def test_gradients_are_central_differences_in_double_precision():
    with jax.enable_x64(True):
        rng = np.random.default_rng(1)
        wrench, length = jnp.asarray(signal(2)), jnp.asarray(LENGTH)
        weights = overlaps(jnp.asarray(EDGES), 61, 5).astype(jnp.float64)
        mix = jnp.asarray(rng.normal(size=(3, 2, 150)))

        def value(log_limits, wrench):
            labels = soft_encode(CONFIG, jnp.exp(log_limits), wrench, length, 0.3)
            return jnp.sum(mix * soft_shares(labels, weights))

        def said(log_limits, wrench):
            tracks = encode(CONFIG, jnp.exp(log_limits), wrench, length)
            return jnp.concatenate([x.label.ravel() for x in (tracks.primitive, tracks.mc, tracks.llb)])

        run, grad, labels = jax.jit(value), jax.jit(jax.grad(value, argnums=(0, 1))), jax.jit(said)
        at = (jnp.log(jnp.asarray(LIMITS)), wrench)
        found = grad(*at)
        scale = [float(jnp.abs(g).max()) for g in found]
        checked = 0
        places = [(0, (axis, k)) for axis in range(6) for k in range(4)]
        places += [
            (1, (trial, int(t), axis)) for trial in range(3) for axis in range(6) for t in rng.integers(0, 195, 2)
        ]
        for which, place in places:
            step = 1e-5 if which == 0 else 1e-6
            ends = [[x if i != which else x.at[place].add(sign * step) for i, x in enumerate(at)] for sign in (1, -1)]
            if not (labels(*ends[0]) == labels(*ends[1])).all():
                continue  # a kink: a hard decision changes in between
            slope = float(run(*ends[0]) - run(*ends[1])) / (2 * step)
            one = float(found[which][place])
            assert abs(one - slope) <= 1e-4 * abs(slope) + 1e-7 * scale[which], (which, place)
            checked += 1
        assert checked >= 0.9 * len(places)
        assert (jnp.abs(found[0]) > 1e-6 * scale[0]).all()  # every threshold matters


@jax.jit
def squares_and_gradients(limits, wrench, temperature):
    def value(limits, wrench):
        labels = soft_encode(CONFIG, limits, wrench, jnp.asarray(LENGTH), temperature)
        return jnp.sum(jnp.square(soft_shares(labels, overlaps(jnp.asarray(EDGES), 61, 5))))

    return jax.value_and_grad(value, argnums=(0, 1))(limits, wrench)


@pytest.mark.parametrize("kind", ["zero", "constant", "huge", "mixed"])
def test_gradients_are_finite_for_strange_signals(kind):
    wrench = {
        "zero": np.zeros((3, 303, 6)),
        "constant": np.full((3, 303, 6), 7.0),
        "huge": signal() * 1e20,
        "mixed": signal() * np.array([0, 1e-20, 1, 1e6, 1e-6, 1]),
    }[kind]
    for temperature in (1.0, 1e-3):
        out = squares_and_gradients(jnp.asarray(LIMITS, jnp.float32), jnp.asarray(wrench, jnp.float32), temperature)
        assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(out))


def test_windows_are_even_at_a_boundary_and_symmetric():
    limits = jnp.asarray(LIMITS[0], jnp.float32)
    for k, pair in enumerate([(7, 0), (0, 1), (1, 2), (2, 6)]):  # the labels on the two sides of each limit
        at = np.asarray(soft_windows(limits[k], limits, 0.02))
        np.testing.assert_allclose(at[list(pair)], 0.5, atol=1e-3)
    up, down = soft_windows(jnp.float32(30.0), limits, 0.3), soft_windows(jnp.float32(-30.0), limits, 0.3)
    np.testing.assert_allclose(up, down[jnp.array([3, 4, 5, 0, 1, 2, 6, 8, 7])], atol=1e-6)


def two_class_corpus(trials: int, seed: int) -> CalibrationData:
    """Sentences whose classes differ by slopes on one axis that the preset calls by one name."""
    rng = np.random.default_rng(seed)
    # N/s per window; both are "small positive", and the rests between keep them from merging into one item.
    rise = np.repeat([2.0, 0.0, 9.0, 0.0], [20, 10, 20, 10])
    slope = np.repeat(rise, 5)[None] * rng.uniform(0.7, 1.4, (trials, 300))
    wrench = np.zeros((trials, 300, 6), np.float32)
    wrench[..., 0] = np.cumsum(slope * 0.005, 1)
    wrench[..., 1:] = np.cumsum(rng.normal(size=(trials, 300, 5)), 1) * 1e-4  # constant on all other axes
    length = np.full(trials, 300, np.int32)
    edges = np.tile(np.array([0, 150, 300], np.int32), (trials, 1))
    y = np.tile(np.array([0, 1], np.int32), (trials, 1))
    names = np.array([f"t{k}" for k in range(trials)])
    return CalibrationData(wrench, fit_windows(CONFIG, wrench, length), edges, y, ("slow", "fast"), names)


@pytest.mark.parametrize(("kind", "batch"), [("logistic", 0), ("logistic", 4), ("fit", 0)])
def test_training_moves_a_limit_between_the_classes(kind, batch):
    start = preset()
    options = GradientOptions(steps=40, rate=0.15, loss=kind, temperature=(0.7, 0.1), batch=batch)
    held_out = two_class_corpus(4, 1) if kind == "logistic" else None
    trained = calibrate(two_class_corpus(6, 0), CONFIG, start, options, held_out=held_out)
    assert trained.history[-1][1] < 0.5 * trained.history[0][1]
    assert held_out is None or trained.history[-1][2] < trained.history[0][2]
    between = (trained.thresholds.limits[0] > 2.8) & (trained.thresholds.limits[0] < 7)
    assert between.any()
    assert not ((LIMITS[0] > 2.8) & (LIMITS[0] < 7)).any()


def test_training_begins_and_goes_alike_in_64_bit_mode():
    data, options = two_class_corpus(2, 0), GradientOptions(steps=2, rate=0.15)
    plain = calibrate(data, CONFIG, preset(), options)
    with jax.enable_x64(True):
        np.testing.assert_allclose(calibrate(data, CONFIG, preset(), options).path, plain.path, rtol=1e-5)


def test_batches_see_every_trial_before_any_comes_again():
    rows = _orders(6, GradientOptions(batch=4))
    seen = [next(rows) for _ in range(3)]
    assert [len(some) for some in seen] == [4, 4, 4]
    np.testing.assert_array_equal(np.sort(np.concatenate(seen)), np.repeat(np.arange(6), 2))
    more = _orders(6, GradientOptions(batch=8))  # than there are
    assert [sorted(next(more)) for _ in range(3)] == [list(range(6))] * 3


def test_training_needs_a_strictly_ordered_start():
    flat = np.asarray(preset().limits).copy()
    flat[2, 1] = flat[2, 0]
    with pytest.raises(InputError, match="strictly ordered"):
        calibrate(two_class_corpus(2, 0), CONFIG, GradientThresholds(flat), GradientOptions(steps=1))


def test_the_first_step_of_training_is_that_of_its_definition():
    """Losses of both corpora before it, by NumPy from the soft shares; Adam's first step is a rate, down the slope."""
    data, held_out = two_class_corpus(2, 0), two_class_corpus(3, 1)
    options = GradientOptions(1, 0.02, 0.07, temperature=(0.8, 0.3), decay=1e6, seed=3)
    start = gradient._first(np.asarray(gradient._free(preset()), np.float32), 2, options)
    start_limits = gradient.limits_from(start.free)
    expected = []
    for corpus in (data, held_out):
        batch = gradient.batch_of(corpus, CONFIG)
        assert batch.weights.shape[2] == -(-corpus.wrench.shape[1] // CONFIG.window)
        labels = soft(CONFIG, start_limits, batch.wrench, batch.length, jnp.float32(0.8))
        logits = 4 * np.asarray(soft_shares(labels, batch.weights), np.float64) @ np.asarray(start.weights, np.float64)
        right = np.take_along_axis(logits, corpus.y[..., None], -1)[..., 0]
        wrong = np.take_along_axis(logits, 1 - corpus.y[..., None], -1)[..., 0]
        expected.append(np.log1p(np.exp(wrong - right)).mean())
    trained = calibrate(data, CONFIG, preset(), options, held_out=held_out)
    np.testing.assert_allclose(trained.history[0][1:], expected, rtol=1e-4)  # without the penalty
    moved = np.abs(np.asarray(trained.parameters.free) - start.free)
    assert moved.max() == pytest.approx(0.02, rel=1e-2)
    # the penalty is larger than all else, so that all weights get smaller
    np.testing.assert_allclose(trained.parameters.weights, start.weights - 0.07 * np.sign(start.weights), atol=1e-4)
