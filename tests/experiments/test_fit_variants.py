"""The NumPy program of the fit rule's variants: equal to the encoder where nothing is changed."""

from __future__ import annotations

import numpy as np
import pytest

import rcbht_jax as rj
from experiments._lib.fit_variants import Noise, SumsOfAxes, Variant, breaks
from rcbht_jax.encoding.fit import FitConfig

SMALL = np.ones(2)


def signal(samples: int = 403, seed: int = 0) -> np.ndarray:
    """Two axes of ramps and jumps with noise ``[time, axis]``."""
    rng = np.random.default_rng(seed)
    slopes = np.repeat(rng.normal(0, 0.2, (samples // 13 + 1, 2)), 13, axis=0)[:samples]
    return slopes.cumsum(0) + rng.normal(0, 0.05, (samples, 2))


def test_the_line_through_a_span_is_that_of_least_squares() -> None:
    y = signal()
    slope, residual = SumsOfAxes(y).line(np.array([7]), np.array([31]), np.array([1]))
    (expected,), found = (
        np.polyfit(np.arange(24), y[7:31, 1], 1, full=True)[1],
        np.polyfit(np.arange(24), y[7:31, 1], 1),
    )
    assert slope[0] == pytest.approx(found[0])
    assert residual[0] == pytest.approx(expected)


@pytest.mark.parametrize("window", [2, 5])
def test_without_a_change_the_breaks_are_the_encoders(window: int) -> None:
    y, config = signal(), FitConfig(window)
    found, tolerance = breaks(y, config, np.array([0.1, 0.2]), SMALL, Variant())
    limits = np.array([[70.0, 46.0, 23.0, 1.0]] * 2)
    tracks = rj.encode(y, rate=200, window=window, rule="fit", thresholds=limits, tolerance=[0.1, 0.2])
    for axis in range(2):
        label, t0 = tracks.primitive.label[axis], tracks.primitive.t0[axis]
        assert found[axis] == t0[label > 0].tolist()
        assert len(found[axis]) > 10
    np.testing.assert_array_equal(tolerance, [0.1, 0.2])


def test_a_shared_break_is_decided_by_the_sum_of_what_axes_save() -> None:
    y, config, shared = signal(), FitConfig(), Variant(shared=1)
    own = breaks(y[:, :1], config, np.array([0.1]), SMALL[:1], Variant())[0][0]
    still = np.stack([y[:, 0], np.zeros(len(y))], axis=1)
    assert breaks(still, config, np.array([0.1, 0.1]), SMALL, shared)[0] == [own, own]
    twice = np.stack([y[:, 0], y[:, 0]], axis=1)  # two axes save twice as much, as one does with a finer tolerance
    finer = breaks(y[:, :1], config, np.array([0.1 / 2**0.5]), SMALL[:1], Variant())[0][0]
    assert breaks(twice, config, np.array([0.1, 0.1]), SMALL, shared)[0] == [finer, finer]
    assert finer != own
    assert breaks(twice, config, np.array([0.1, 0.1]), SMALL, Variant(shared=2))[0] == [own, own]


@pytest.mark.parametrize("track", ["at rest", "median"])
def test_a_tracked_tolerance_is_twice_the_noise_but_never_less_than_the_given_one(track: str) -> None:
    noise = np.random.default_rng(1).normal(0, [0.05, 0.001], (2000, 2))
    tolerance = breaks(noise, FitConfig(), np.array([0.06, 0.06]), SMALL * 1e3, Variant(track=track))[1]  # type: ignore[arg-type]
    assert tolerance[0] == pytest.approx(0.1, rel=0.2)
    assert tolerance[1] == 0.06


def test_noise_is_not_taken_from_axes_that_move() -> None:
    y, config = np.random.default_rng(2).normal(0, 1, (100, 2)), FitConfig()
    noise = Noise(y, config, Variant(track="at rest"))
    for begin in range(0, 100, 5):
        known = noise.after(begin, begin + 5, np.array([True, False]))
    assert known[0] == pytest.approx(1, rel=0.3)
    assert known[1] == 0
