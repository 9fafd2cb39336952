"""Where the tolerance of the fit rule comes from: the recordings, the limits, or a number."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import checked_limits, limit_arrays, limits_for, limits_from
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance, noise_of
from rcbht_jax.errors import InputError
from tests.support.trees import assert_trees_equal

GRADIENTS = rj.preset("hiro", ["Fx", "Fz"]).limits
RAMP = np.linspace(0, 100, 1001)[:, None] * [1.0, 0.1]
LENGTH = np.array([1001])


def test_what_lies_beyond_the_length_does_not_matter() -> None:
    padded = np.full((2, 1500, 2), 1e6)
    padded[0, :1001], padded[1, :500] = RAMP, RAMP[:500]
    found = auto_tolerance(padded, np.array([1001, 500]), needed=5)
    together = np.concatenate([RAMP, RAMP[:500]])
    np.testing.assert_allclose(found, auto_tolerance(together[None], np.array([1501]), needed=5))
    np.testing.assert_array_equal(auto_tolerance(padded, np.array([0, 0]), needed=5), [1.0, 1.0])


def test_each_axis_has_a_share_of_its_own_range() -> None:
    wrench = np.zeros((1, 2000, 3))
    wrench[0, 1000] = 100.0, 10.0, 0.0  # outside the usual range, and no noise
    np.testing.assert_allclose(auto_tolerance(wrench, np.array([2000]), needed=5), [1.5, 0.15, 1.0])


def test_steps_from_one_recording_to_the_next_are_no_noise() -> None:
    levels = np.random.default_rng(0).permutation(101)[:, None, None] * np.ones((1, 3, 1))
    assert noise_of(list(levels)).tolist() == [0.0]
    np.testing.assert_allclose(auto_tolerance(levels, np.full(101, 3), needed=5), [0.015 * 98])


@pytest.mark.parametrize("repeats", [2, 3, 4, 8, (3, 4)])
def test_noise_of_a_slower_sensor_breaks_no_lines(repeats: int | tuple[int, int]) -> None:
    """Most second differences of values that are held are zero, so there seemed to be no noise."""
    own = np.random.default_rng(0).normal(size=(1000, 1)) * [1.0, 0.1]
    held = np.repeat(own, repeats if isinstance(repeats, int) else np.tile(repeats, 500), axis=0)
    other = np.random.default_rng(1).normal(size=(len(held), 1))  # an axis of another sensor
    wrench = np.concatenate([held, other], axis=1)
    times = int(np.median(repeats)) ** 0.5
    np.testing.assert_allclose(noise_of([wrench]), [times, 0.1 * times, 1.0], rtol=0.1)
    words = rj.encode(wrench, rate=200, rule="fit").primitive.label
    assert (words > 0).sum(1).max() < 0.01 * len(held)


def test_few_digits_are_no_slower_sensor() -> None:
    rng = np.random.default_rng(0)
    ramp = np.floor(np.linspace(0, 100, 1000))  # a new value every ten samples
    rare = np.cumsum(rng.random(4000) < 0.01) % 2.0
    for values in (ramp, rare, np.round(rng.normal(0, 0.2, 4000))):
        assert noise_of([values[:, None]]).tolist() == [0.0]


def test_a_configuration_that_asks_for_more_evidence_needs_less_tolerance() -> None:
    """White noise of deviation 1: a break saves as many squared tolerances as 20 variances."""
    noise = np.random.default_rng(0).normal(size=(1, 4000, 2))
    for evidence, tolerance in ((0.025, 2.0), (0.1, 1.0)):
        limits = limits_for(FitConfig(evidence=evidence), GRADIENTS, None, noise, np.array([4000]))
        assert isinstance(limits, FitLimits)
        np.testing.assert_allclose(limits.tolerance, [tolerance] * 2, rtol=0.05)


@pytest.mark.parametrize("bad", [math.inf, -math.inf, math.nan, 1e308])
def test_values_that_encoders_refuse_are_not_called_a_wrong_tolerance(bad: float) -> None:
    wrench = RAMP.copy()
    wrench[3:60:2] = bad
    assert auto_tolerance(wrench[None], LENGTH, needed=5).tolist() == [1.0, 1.0]
    with pytest.raises(InputError, match="Recording 0 holds values that are not finite numbers, or beyond"):
        rj.encode(wrench, rule="fit")


def test_a_number_replaces_the_tolerance_of_the_limits() -> None:
    fitted = FitLimits(GRADIENTS, np.array([0.3, 0.2]))
    for given, expected in ((None, [0.3, 0.2]), ("auto", [0.3, 0.2]), (2.0, [2.0, 2.0]), ([0.4, 0.5], [0.4, 0.5])):
        found = limits_for(FitConfig(), fitted, given, RAMP[None], LENGTH)
        assert isinstance(found, FitLimits)
        assert_trees_equal(found.stacked(), np.column_stack([GRADIENTS, expected]))


@pytest.mark.parametrize("rule", ["paper", "fit"])
def test_limits_that_make_no_sense_are_refused_before_they_are_used(rule: str) -> None:
    config: Any = FitConfig() if rule == "fit" else rj.EncoderConfig()
    with pytest.raises(InputError, match="belong to the fit rule" if rule == "paper" else "Tolerances are 0 to 1"):
        limits_for(config, FitLimits(GRADIENTS, np.array([0.0, 1.0])), None, RAMP[None], LENGTH)
    with pytest.raises(InputError, match="belongs to the fit rule" if rule == "paper" else "Tolerances are 0 to 0"):
        limits_for(config, GRADIENTS, 0.0, RAMP[None], LENGTH)


@pytest.mark.parametrize("tolerance", [None, 0.5, [0.5] * 2])
@pytest.mark.parametrize("wrong", [GRADIENTS[:1], GRADIENTS[None, None]])
def test_thresholds_of_another_shape_are_named_and_no_tolerance_is_blamed(wrong: Any, tolerance: Any) -> None:
    """Too few rows made tolerances wrong that nobody had given."""
    with pytest.raises(InputError, match=r"Thresholds have shape .*; expected \[2, 4\] or \[1, 2, 4\]"):
        rj.encode(RAMP, rule="fit", thresholds=wrong.tolist(), tolerance=tolerance)


def test_gradients_out_of_order_are_refused_beside_any_tolerance() -> None:
    with pytest.raises(InputError, match="ordered"):
        FitLimits(GRADIENTS[:, ::-1].copy(), np.ones(2)).stacked()


@pytest.mark.parametrize("tolerance", ["much", 1j, [[0.1], [0.1, 0.2]]])
def test_a_tolerance_that_is_no_number_is_named(tolerance: Any) -> None:
    with pytest.raises(InputError, match=r"The tolerance is .*; expected numbers, or 'auto'"):
        limits_for(FitConfig(), GRADIENTS, tolerance, RAMP[None], LENGTH)


def test_limits_come_back_from_their_arrays_digit_by_digit() -> None:
    for config, limits in (
        (rj.EncoderConfig(), GRADIENTS / 3),
        (FitConfig(), FitLimits(GRADIENTS / 3, np.array([0.1, 0.2]))),
    ):
        found = limits_from(config, limit_arrays(limits))
        np.testing.assert_array_equal(checked_limits(config, found), checked_limits(config, limits))
