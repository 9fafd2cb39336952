"""Calibration of the fit rule: times per label, search, rest and gradients, all with a tolerance."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.calibration import rest_runs
from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.gradient import FIT_TEMPERATURE, GradientOptions, calibrate
from rcbht_jax.calibration.label_durations import fit_windows, label_durations
from rcbht_jax.calibration.rest import rest_not_constant, rest_thresholds
from rcbht_jax.calibration.rest_runs import RestRuns, fit_rest_limits
from rcbht_jax.calibration.search import TOLERANCES, SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYERS, Primitive
from rcbht_jax.types import Recordings

CONFIG = FitConfig(window=5, dt=0.005)
LENGTHS = np.array([203, 150, 201], np.int32)  # partial windows of 3, 0 and 1 samples
EDGES = np.array([[0, 100, 101, 203], [5, 50, 60, 145], [0, 20, 90, 201]], np.int32)
BASE = FitLimits(preset().limits, np.array([0.2, 0.2, 0.2, 0.02, 0.02, 0.02]))


@pytest.fixture(scope="module")
def made() -> CalibrationData:
    """Quiet and busy stretches, so that every layer has long and short labels."""
    rng = np.random.default_rng(3)
    busy = np.repeat(rng.choice([0.003, 0.05, 0.6], (3, 21, 6)), 10, axis=1)[:, :203]
    wrench = np.cumsum(rng.normal(size=(3, 203, 6)) * busy, axis=1) * np.where(np.arange(6) < 3, 1, 0.1)
    wrench = wrench.astype(np.float32)
    y = np.tile(np.arange(3, dtype=np.int32), (3, 1))
    windows = fit_windows(CONFIG, wrench, LENGTHS)
    return CalibrationData(wrench, windows, EDGES, y, tuple("abc"), np.array(list("xyz")))


def candidates() -> FitLimits:
    """The base, and two others on both sides of its tolerance."""
    limits = np.stack([BASE.gradients, BASE.gradients / 3, BASE.gradients * 2])
    return FitLimits(limits, BASE.tolerance * np.array([1, 0.3, 2.5])[:, None])


@pytest.mark.parametrize("samples", [10, 99])
def test_rest_shorter_than_half_a_second_is_refused(samples):
    short = Recordings.from_arrays(np.random.default_rng(0).normal(size=(2, samples, 2)), axes=["Fz", "grip"])
    with pytest.raises(InputError, match=r"Fz is never at rest for 0\.5 s"):
        fit_rest_limits(short, CONFIG)


@pytest.mark.parametrize("group", [1, 2])
def test_times_per_label_are_those_of_the_published_words(made, group):
    limits = candidates()
    some = jnp.asarray(np.stack([one.stacked() for one in each(limits)]), jnp.float32)
    times = np.asarray(label_durations(CONFIG, some, made.signal(CONFIG), jnp.asarray(EDGES), group=group))
    for number, one in enumerate(each(limits)):
        tracks = encode_batch(CONFIG, one, made.wrench, LENGTHS)
        start = 0
        for layer, size in zip(LAYERS, (9, 8, 8), strict=True):
            track = getattr(tracks, layer)
            for trial, axis, sentence in np.ndindex(3, 6, 3):
                first, last = EDGES[trial, sentence : sentence + 2]
                inside = np.minimum(track.t1, last) - np.maximum(track.t0, first)
                spent = np.clip(inside[trial, axis], 0, None)
                expected = np.bincount(track.label[trial, axis], spent, minlength=size + 1)[1:]
                got = times[number, trial, sentence, axis, start : start + size]
                np.testing.assert_array_equal(got, expected)
            start += size


def each(limits: FitLimits) -> list[FitLimits]:
    return [jax.tree.map(lambda leaf, k=k: leaf[k], limits) for k in range(len(limits.tolerance))]


def test_a_space_of_the_fit_rule_has_a_tolerance_of_its_own_in_each_group():
    space = SearchSpace(BASE, (0, 0, 0, 1, 1, 1))
    limits = [0.9, 0.6, 0.5, 0.2]
    points = np.array([[*limits, 0.0, *limits, 1.0], [*limits, 0.5, *limits, 0.25]])
    made = space.thresholds(points)
    low, high = TOLERANCES
    factors = np.array([[low, high], [(low * high) ** 0.5, low**0.75 * high**0.25]])
    np.testing.assert_allclose(made.tolerance, BASE.tolerance * np.repeat(factors, 3, axis=1))
    np.testing.assert_allclose(made.gradients[0], made.gradients[1])
    for row, point in enumerate(points):
        one = FitLimits(made.gradients[row], made.tolerance[row])
        np.testing.assert_allclose(space.point(one), point, atol=1e-12)


def test_a_search_varies_tolerances_too_and_never_loses_to_its_base(made):
    space = SearchSpace(BASE, (0, 0, 0, 1, 1, 1))
    points = np.random.default_rng(0).random((40, space.dimensions))
    spread = space.thresholds(points)
    ratio = np.asarray(spread.tolerance) / BASE.tolerance
    assert TOLERANCES[0] <= ratio.min() < 0.2 < 2 < ratio.max() <= TOLERANCES[1]
    np.testing.assert_array_equal(np.ptp(ratio[:, :3], 1) < 1e-12, True)
    back = space.thresholds(space.point(BASE)[None])
    np.testing.assert_allclose(back.tolerance[0], BASE.tolerance, rtol=1e-9)
    np.testing.assert_allclose(back.gradients[0], BASE.gradients, rtol=1e-9)

    options = SearchOptions(space=space, candidates=8, generations=1, population=4)
    found = search(made, CONFIG, options, chunk=8)
    assert isinstance(found.thresholds, FitLimits)
    assert found.value >= found.start_value
    again = score_candidates(made, CONFIG, jax.tree.map(lambda leaf: leaf[None], found.thresholds), chunk=8)[0]
    assert found.value == pytest.approx(float(again @ options.objective.weights()), abs=1e-5)
    with pytest.raises(InputError, match="FitLimits"):
        score_candidates(made, CONFIG, preset().limits[None])


def at_rest(seed: int, noise: float) -> Recordings:
    """Rest of coloured noise, a push, and rest again, on two axes of very different units."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(4, 801, 2))
    wrench = noise * (white[:, 1:] + white[:, :-1])
    wrench[:, 400:440] += np.linspace(0, 20, 40)[None, :, None]
    wrench[:, 440:] += 20
    return Recordings.from_arrays(wrench * np.array([1, 1e-3]), rate=200, axes=("grip", "twist"))


def test_rest_is_constant_with_the_tolerance_of_rest():
    recordings = at_rest(0, 0.05)
    found = fit_rest_limits(recordings, CONFIG)
    rest = rest_thresholds(recordings, 5, "fit")
    np.testing.assert_array_equal(found.limits.gradients, rest.thresholds.limits)
    tracks = encode_batch(CONFIG, found.limits, recordings.wrench, recordings.length)
    moving = rest_not_constant(tracks.primitive, rest.rest, 5, Primitive.CONS)
    assert (moving < 0.05).all()
    np.testing.assert_allclose(found.constant, 1 - moving, atol=0.01)
    assert (
        2 * 0.05 * 2**0.5 * 0.9 < found.limits.tolerance[0] < 4 * 0.05 * 2**0.5
    )  # two deviations of the noise, or more
    long = (tracks.primitive.t1 - tracks.primitive.t0)[(tracks.primitive.label == Primitive.CONS)]
    assert long.mean() > 50  # rest is a few words, not many that are called constant
    np.testing.assert_allclose(found.limits.tolerance[1], found.limits.tolerance[0] * 1e-3, rtol=0.5)
    twice = fit_rest_limits(at_rest(0, 0.1), CONFIG).limits.tolerance
    np.testing.assert_allclose(twice, 2 * found.limits.tolerance, rtol=0.05)


def test_the_least_tolerance_by_which_rest_is_constant_is_taken_or_the_best_one(monkeypatch):
    """The first axis is calm from the fifth of the 13 tolerances on, the second never is, and most by the third."""
    shares = np.ones((13, 2))
    shares[:4, 0], shares[4, 0], shares[:, 1], shares[2, 1] = 0.94, 0.95, 0.3, 0.9
    steep = np.where(np.arange(200) < 200 * shares[..., None], 0.0, np.inf)
    monkeypatch.setattr(rest_runs, "_runs", lambda _r, _c, tried, _: RestRuns(tried, steep))
    recordings = at_rest(0, 0.05)
    noise = rest_runs._rest_noise(recordings, rest_thresholds(recordings, 5, "fit").rest, CONFIG)
    found = fit_rest_limits(recordings, CONFIG)
    np.testing.assert_allclose(found.limits.tolerance / noise, [4.0, 2.0])
    np.testing.assert_allclose(found.constant, [0.95, 0.9])


def test_noise_at_rest_is_that_of_the_blocks_at_rest():
    """At 2 Hz, a window is longer than the blocks of rest, and two samples are too few for a line."""
    rng = np.random.default_rng(0)
    wrench = rng.normal(size=(4, 1200, 1)) * 0.01
    wrench[:, 600:] += np.cumsum(rng.normal(size=(4, 600, 1)) * 3, 1)
    recordings = Recordings.from_arrays(wrench, rate=2, axes=["grip"])
    rest = {window: rest_thresholds(recordings, window).rest for window in (2, 4)}
    found = {w: rest_runs._rest_noise(recordings, calm, FitConfig(w, recordings.dt))[0] for w, calm in rest.items()}
    assert found[2] < 2 * found[4] < 0.2


def test_noise_at_rest_is_what_a_line_leaves_wherever_it_lies():
    noise = np.random.default_rng(0).normal(size=(2, 1000, 1)) * 0.01
    calm = np.ones((2, 200, 1), bool)
    placed = noise + 50 + 0.3 * np.arange(1000)[:, None] / 200
    found = [
        rest_runs._rest_noise(Recordings.from_arrays(wrench, rate=200, axes=["grip"]), calm, CONFIG)
        for wrench in (noise, placed)
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-3)


def test_penalties_are_the_share_of_rest_that_words_do_not_call_constant():
    recordings = at_rest(1, 0.2)
    runs = RestRuns.of(recordings, CONFIG, weight=2.0)
    rest = rest_thresholds(recordings, 5, "fit").rest
    gradients = np.tile([80.0, 40.0, 20.0, 0.5], (2, 1)) * np.array([1, 1e-3])[:, None]
    shares = []
    for tolerance in runs.tolerance[[0, 4, 8, 12]]:
        limits = FitLimits(gradients, tolerance)
        tracks = encode_batch(CONFIG, limits, recordings.wrench, recordings.length)
        shares.append(rest_not_constant(tracks.primitive, rest, 5, Primitive.CONS).mean())
        assert float(runs.penalty(limits)) == pytest.approx(2 * shares[-1], abs=0.02)
    assert shares[0] > 0.5 > 0.1 > shares[-1]
    several = FitLimits(np.tile(gradients, (4, 1, 1)), np.asarray(runs.tolerance)[[0, 4, 8, 12]])
    np.testing.assert_allclose(runs.penalty(several), 2 * np.array(shares), atol=0.02)
    ends = [float(runs.penalty(FitLimits(gradients, runs.tolerance[k]))) for k in (0, 4, 5, -1)]
    between = [runs.tolerance[4] ** (1 - part) * runs.tolerance[5] ** part for part in (0.25, 0.75)]
    found = [
        float(runs.penalty(FitLimits(gradients, t))) for t in (runs.tolerance[0] / 9, *between, runs.tolerance[-1] * 9)
    ]
    expected = [ends[0], 0.75 * ends[1] + 0.25 * ends[2], 0.25 * ends[1] + 0.75 * ends[2], ends[3]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert ends[1] - ends[2] > 0.05

    with jax.enable_x64(True):
        at = FitLimits(jnp.asarray(gradients), jnp.asarray(runs.tolerance[4] * 1.1))
        found = jax.grad(runs.soft_penalty)(at)
        assert (found.tolerance < 0).all()
        assert (found.gradients[:, 3] < 0).all()
        assert 2 * replace(runs, weight=1.0).soft_penalty(at) == runs.soft_penalty(at)
        step = 1e-6 * at.tolerance[0]
        ends = [replace(at, tolerance=at.tolerance.at[0].add(sign * step)) for sign in (1, -1)]
        slope = (runs.soft_penalty(ends[0]) - runs.soft_penalty(ends[1])) / (2 * step)
        np.testing.assert_allclose(found.tolerance[0], slope, rtol=1e-5)
    with pytest.raises(InputError, match="tolerance for every axis"):
        runs.penalty(GradientThresholds(gradients))


def waves(seed: int) -> CalibrationData:
    """One class is at rest, the other rises and falls by less than the initial tolerance."""
    rng, trials = np.random.default_rng(seed), 3
    wrench = np.zeros((trials, 120, 6))
    wave = np.interp(np.arange(60), [0, 20, 40, 60], [0, 0.3, 0, 0.3])
    wrench[:, 60:, 0] = wave * rng.uniform(0.8, 1.2, (trials, 1))
    wrench = (wrench + rng.normal(size=wrench.shape) * 0.004).astype(np.float32)
    length, edges = np.full(trials, 120, np.int32), np.tile(np.array([0, 60, 120], np.int32), (trials, 1))
    y = np.tile(np.array([0, 1], np.int32), (trials, 1))
    names = np.array([f"t{k}" for k in range(trials)])
    return CalibrationData(wrench, fit_windows(CONFIG, wrench, length), edges, y, ("rest", "waves"), names)


def test_training_lowers_a_tolerance_that_hides_a_class():
    start = FitLimits(preset().limits, np.full(6, 0.5))
    data = waves(0)
    options = GradientOptions(steps=20, rate=0.2, loss="fit", temperature=FIT_TEMPERATURE)
    trained = calibrate(data, CONFIG, start, options)
    assert trained.path.shape == (20, 6, 5)
    assert isinstance(trained.thresholds, FitLimits)
    assert trained.thresholds.tolerance[0] < 0.25
    assert trained.history[-1][1] < 0.5 * trained.history[0][1]
    both = jax.tree.map(lambda *leaves: np.stack(leaves), start, trained.thresholds)
    before, after = score_candidates(waves(1), CONFIG, both)[:, 1]  # explained variance on other trials
    assert before < 0.1 < 0.5 < after
