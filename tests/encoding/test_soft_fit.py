"""Soft labels of the fit rule: against all sequences of breaks, the hard encoder, and central differences."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.encoding import fit, soft_runs
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.soft import SoftLabels, cell, overlaps, soft_encode, soft_shares
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYERS
from tests.encoding.test_fit import LIMITS, wrench_of
from tests.support.fit_oracle import least_squares

CONFIG = FitConfig()
LENGTH = np.array([300, 287, 7], np.int32)
EDGES = np.array([[0, 102, 290], [5, 77, 287], [0, 2, 7]], np.int32)
STACKED = LIMITS.stacked()

soft = jax.jit(soft_encode, static_argnums=0)
primitives = jax.jit(soft_runs.soft_primitives, static_argnums=(0, 5))


def signal() -> np.ndarray:
    """Random walks, steps and ramps ``[trial, time, axis]``."""
    return np.stack([wrench_of(seed, style)[:300] for seed, style in enumerate(("ramps", "noise", "steps"))])


def hard_at_samples(track) -> np.ndarray:
    """Label in force at each sample ``[trial, axis, time]``."""
    codes = np.zeros((*track.label.shape[:2], 300), int)
    for trial, axis, slot in np.argwhere(np.asarray(track.label) > 0):
        codes[trial, axis, track.t0[trial, axis, slot] : track.t1[trial, axis, slot]] = track.label[trial, axis, slot]
    return codes


def logistic(value: float) -> float:
    return 1 / (1 + np.exp(-np.clip(value, -700, 700)))


def soft_label(y: np.ndarray, limits: np.ndarray, temperature: float) -> np.ndarray:
    """The page's formulas for one run, in plain NumPy."""
    n, slope = len(y), least_squares(y)[1]
    size, tiny = abs(slope) / 0.005, 1e-4 * limits[3]
    above = [logistic((np.log(size + tiny) - np.log(limit + tiny)) / temperature) for limit in limits[:4]]
    up = logistic(40 * slope / 0.005 / (size + limits[3] * temperature))
    ramps = np.diff(above)
    made = np.array([*ramps * up, *ramps * (1 - up), 1 - above[3], above[0] * up, above[0] * (1 - up)])
    if n > 40:
        made[[0, 3]] += made[[7, 8]]
        made[[7, 8]] = 0
    deviation = abs(slope) * np.sqrt((n * n - 1) / 12)
    level = logistic((np.log(limits[4]) - np.log(max(deviation, 1e-300))) / temperature)
    made = made * (1 - level)
    made[6] += level
    return made


def every_history(y: np.ndarray, limits: np.ndarray, temperature: float) -> np.ndarray:
    """Distribution at each sample, summed over all sequences of breaks."""
    nows = [min(first + 5, len(y)) for first in range(0, len(y), 5)]
    total = np.zeros((len(y), 9))
    for history in itertools.product([False, True], repeat=len(nows)):
        start, weight, made = 0, 1.0, np.zeros((len(y), 9))
        for breaks, now in zip(history, nows, strict=True):
            places = range(max(start + 2, -(-now // 5) * 5 - 10), now - 1)
            saved = 0.0
            if places:
                apart = [least_squares(y[start:p])[2] + least_squares(y[p:now])[2] for p in places]
                saved = least_squares(y[start:now])[2] - min(apart)
            amplitude = np.log(np.sqrt(saved / 5) / limits[4]) if saved > 0 else -np.inf
            chance = logistic(amplitude / temperature) if saved > 0 else 0.0
            weight *= chance if breaks else 1 - chance
            if weight == 0:
                break
            if breaks:
                end = places[int(np.argmin(apart))]
                made[start:end] = soft_label(y[start:end], limits, temperature)
                start = end
        else:
            made[start:] = soft_label(y[start:], limits, temperature)
            total += weight * made
    return total


@pytest.mark.parametrize("temperature", [0.1, 0.6])
def test_soft_primitives_are_the_sum_over_all_sequences_of_breaks(temperature):
    wrench = signal()[:, :33]
    lanes, limits = np.swapaxes(wrench, 0, 1).reshape(33, 9), np.tile(STACKED, (3, 1))
    length = np.full(9, 33, np.int32)
    with jax.enable_x64(True):
        made, lost = primitives(CONFIG, jnp.asarray(limits), jnp.asarray(lanes), jnp.asarray(length), temperature, 40)
        assert lost.max() < 1e-9
        for lane in range(9):
            expected = every_history(lanes[:, lane], limits[lane], temperature)
            np.testing.assert_allclose(made[lane], expected, atol=1e-8)


def test_what_is_lost_is_how_far_few_candidates_are_from_many():
    lanes, limits = signal()[1, :120], jnp.asarray(STACKED, jnp.float32)
    length = jnp.full(3, 120, jnp.int32)
    many, few = (primitives(CONFIG, limits, jnp.asarray(lanes, jnp.float32), length, 0.5, k) for k in (64, 6))
    assert few[1].max() > 0.01 > 1e-4 > many[1].max()  # few are too few here, else the case shows nothing
    assert (np.abs(many[0] - few[0]).sum(-1).max(-1) <= 2 * few[1] + 1e-3).all()
    with pytest.raises(InputError, match="at least two"):
        soft_runs.init(CONFIG, (1,), 1)


def test_cold_labels_are_those_of_the_hard_encoder():
    wrench = signal().astype(np.float32)
    hard = encode_batch(CONFIG, LIMITS, wrench, LENGTH)
    limits = jnp.asarray(STACKED, jnp.float32)
    apart = []
    for temperature in (0.3, 0.03, 1e-5):
        made = soft(CONFIG, limits, jnp.asarray(wrench), jnp.asarray(LENGTH), temperature)
        apart.append([])
        for layer in LAYERS:
            x, codes = np.asarray(getattr(made, layer)), hard_at_samples(getattr(hard, layer))
            on = codes > 0
            np.testing.assert_allclose(x.sum(-1)[on], 1, atol=1e-5)
            assert not x[~on].any()
            apart[-1].append(np.abs(x[on] - np.eye(x.shape[-1])[codes[on] - 1]).sum(-1).mean() / 2)
    assert (np.diff(apart, axis=0) < 0).all()  # nearer with every step down
    np.testing.assert_allclose(apart[-1], 0, atol=1e-5)


def test_shares_of_hard_labels_are_those_of_the_words():
    wrench = signal().astype(np.float32)
    hard = encode_batch(CONFIG, LIMITS, wrench, LENGTH)
    grids = (hard_at_samples(getattr(hard, layer)) for layer in LAYERS)
    made = SoftLabels(*(jax.nn.one_hot(grid - 1, size) for grid, size in zip(grids, (9, 8, 8), strict=True)))
    shares = np.asarray(soft_shares(made, overlaps(jnp.asarray(EDGES), 300, cell(CONFIG))))
    codes = hard_at_samples(hard.llb)
    inside = codes[1, 2, EDGES[1, 1] : EDGES[1, 2]]
    np.testing.assert_allclose(
        shares[1, 1].reshape(-1)[-8:], np.bincount(inside, minlength=9)[1:] / len(inside), atol=1e-6
    )


def test_gradients_are_central_differences_in_double_precision():
    """Of all five numbers of each axis, through primitives, compositions and behaviours."""
    with jax.enable_x64(True):
        wrench, length = jnp.asarray(signal()[:2, :150]), jnp.asarray([150, 133], jnp.int32)
        weights = overlaps(jnp.asarray([[0, 60, 150], [5, 77, 133]], jnp.int32), 150, 1).astype(jnp.float64)
        mix = jnp.asarray(np.random.default_rng(1).normal(size=(2, 2, 3 * 25)))

        def value(logs):
            return jnp.sum(mix * soft_shares(soft_encode(CONFIG, jnp.exp(logs), wrench, length, 0.1), weights))

        def said(logs):
            limits = jnp.exp(logs)
            lanes = jnp.swapaxes(wrench, 0, 1).reshape(150, 6)
            stages = fit.scan_stages(CONFIG, jnp.tile(limits, (2, 1)).T, lanes, jnp.repeat(length, 3))
            return jnp.concatenate([jnp.stack([x.label, x.t0, x.t1]).ravel() for x in stages])

        run, labels = jax.jit(jax.value_and_grad(value)), jax.jit(said)
        at = jnp.log(jnp.asarray(STACKED))
        found = run(at)[1]
        scale, checked = float(jnp.abs(found).max()), 0
        for axis, k in itertools.product(range(3), range(5)):
            ends = [at.at[axis, k].add(sign * 1e-5) for sign in (1, -1)]
            if not (labels(ends[0]) == labels(ends[1])).all():
                continue  # a hard decision of the layers above changes in between
            slope = float(run(ends[0])[0] - run(ends[1])[0]) / 2e-5
            assert abs(float(found[axis, k]) - slope) <= 1e-4 * abs(slope) + 1e-6 * scale, (axis, k)
            checked += 1
        assert checked >= 13
        assert (jnp.abs(found) > 0).all()  # every limit and every tolerance matters


@jax.jit
def squares_and_gradient(limits, wrench, temperature):
    def value(limits):
        labels = soft_encode(CONFIG, limits, wrench, jnp.asarray(LENGTH), temperature)
        return jnp.sum(jnp.square(soft_shares(labels, overlaps(jnp.asarray(EDGES), 300, 1))))

    return jax.value_and_grad(value)(limits)


@pytest.mark.parametrize("kind", ["zero", "constant", "large", "mixed"])
def test_gradients_are_finite_for_strange_signals(kind):
    wrench = {
        "zero": np.zeros((3, 300, 3)),
        "constant": np.full((3, 300, 3), 7.0),
        "large": signal() * 1e9,
        "mixed": signal() * np.array([0, 1e-12, 1e5]),
    }[kind]
    for temperature in (1.0, 1e-3):
        out = squares_and_gradient(jnp.asarray(STACKED, jnp.float32), jnp.asarray(wrench, jnp.float32), temperature)
        assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(out))


def test_a_step_is_pure_keeps_its_size_and_can_be_mapped_over_limits():
    lanes, five = jnp.asarray(signal()[1, :60], jnp.float32), jnp.full(3, 5, jnp.int32)
    limits = jnp.asarray(STACKED[None] * np.array([1.0, 0.5, 2.0])[:, None, None], jnp.float32)

    @jax.jit
    def step(one, state, window):
        return soft_runs.step(CONFIG, one, state, window, five, 0.2)

    mapped = jax.jit(jax.vmap(step, in_axes=(0, 0, None)))
    alone = [soft_runs.init(CONFIG, (3,)) for _ in limits]
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *alone)
    sizes = jax.eval_shape(lambda: alone[0])
    for first in range(0, 60, 5):
        together, runs = mapped(limits, together, lanes[first : first + 5])
        single = [step(one, state, lanes[first : first + 5]) for one, state in zip(limits, alone, strict=True)]
        alone = [state for state, _ in single]
        for k in range(3):
            np.testing.assert_allclose(runs.weight[k], single[k][1].weight, atol=1e-4)
            np.testing.assert_allclose(together.weight[k].sum(0), 1, atol=1e-5)
    assert jax.eval_shape(lambda: alone[0]) == sizes  # shapes and types
    assert sum(leaf.size for leaf in jax.tree.leaves(alone[0])) < 400
