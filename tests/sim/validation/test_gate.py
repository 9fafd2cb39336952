"""The gate passes what is alike and none of what is nonsense."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.types import Recordings
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets.session import GateLimits
from sim_mjx.validation import gate, sessions
from sim_mjx.validation.dynamics import Dynamics, Ring, dynamics, ringing

LIMITS = GateLimits(coverage=0.75, w1_over_sd=0.4, dtw_over_sd=0.4, auc=0.85)
TRIALS = 14


def trials(seed: int, *, between: float = 0.5) -> np.ndarray:
    """Profiles with a mean course, differences between trials, and noise."""
    rng = np.random.default_rng(seed)
    course = np.sin(np.linspace(0, 3, 100))[:, None] * np.arange(1, 7) + np.arange(4)[:, None, None]
    offset = between * rng.normal(size=(TRIALS, 4, 1, 6))
    return course + offset + 0.1 * rng.normal(size=(TRIALS, 4, 100, 6))


def failed(found: dict[str, gate.Check]) -> set[str]:
    return {name for name, check in found.items() if not check.holds}


def test_what_is_alike_passes() -> None:
    assert failed(gate.checks(LIMITS, trials(0), trials(1))) == set()


def test_nonsense_fails_by_what_it_lacks() -> None:
    reference, rng = trials(0), np.random.default_rng(2)
    constant = np.broadcast_to(reference.mean((0, 2), keepdims=True), reference.shape) + 1e-9 * rng.normal(
        size=(14, 1, 1, 1)
    )
    assert {"AUC", "spread"} <= failed(gate.checks(LIMITS, reference, constant))
    mean = reference.mean(0) + 0.1 * rng.normal(size=reference.shape)
    assert "spread" in failed(gate.checks(LIMITS, reference, mean))
    shifted = trials(1)
    shifted[:, 2, :, 1] += 2.5  # one axis in one state
    assert failed(gate.checks(LIMITS, reference, shifted)) == {"AUC"}
    mirrored = trials(1)
    mirrored[:, 3, :, 3] *= -1
    assert "wrong signs" in failed(gate.checks(LIMITS, reference, mirrored))


def test_the_classifier_judges_each_trial_by_the_others() -> None:
    """With labels at random it finds nothing, although it has far more cells than trials."""
    pooled = np.concatenate([trials(0), trials(1)])
    rng = np.random.default_rng(0)
    areas = []
    for _ in range(12):
        order = rng.permutation(len(pooled))
        areas.append(gate.separability(pooled[order[:TRIALS]], pooled[order[TRIALS:]]))
    assert 0.25 < np.mean(areas) < 0.6


def test_a_small_moment_of_the_other_sign_is_forgiven() -> None:
    reference = trials(0)
    test = reference.copy()
    deviation = reference[..., 4].std((0, 2))[1]
    for size, wrong in ((0.4, False), (1.2, True)):
        for profiles, sign in ((reference, 1), (test, -1)):
            profiles[:, 1, :, 4] += sign * size * deviation / 2 - profiles[:, 1, :, 4].mean()
        assert gate.wrong_signs(reference, test)[1, 1] == wrong


@pytest.mark.parametrize(("value", "holds"), [(1.0, True), (2.0, True), (0.99, False), (2.01, False), (None, False)])
def test_limits_are_within_themselves(value: float | None, holds: bool) -> None:
    assert gate.Check(value, low=1.0, high=2.0).holds == holds


def test_measures_of_sets_that_differ_by_a_factor() -> None:
    reference = trials(0)
    mean = reference.mean(0)
    assert gate.spread(reference, mean + 2 * (reference - mean)) == pytest.approx(2.0)
    assert not gate.wrong_signs(reference, 4 * reference).any()  # far away, but of the same sign
    assert 0 <= gate.separability(reference[:3], reference[3:6]) <= 1  # as few as there may be
    assert not gate.Check(np.inf, low=1.0).holds


def test_quick_events_are_compared_where_there_are_any() -> None:
    ring, none = Ring(2.3, 40.0, 0.05), Dynamics(np.zeros(0), None)
    recorded = Dynamics(np.full(3, 20.0), ring)
    same = gate.checks(LIMITS, trials(0), trials(1), (recorded, recorded), (0.9, 0.85), 0.1)
    assert failed(same) == set()
    assert len(same) == 12
    other = Dynamics(np.full(3, 12.0), Ring(2.9, 60.0, 0.12))
    missed = {"first impact", "ring hertz", "ring peak", "ring damping", "snaps", "onsets"}
    assert failed(gate.checks(LIMITS, trials(0), trials(1), (recorded, other), (0.9, 0.4), 0.9)) == missed
    found = gate.checks(LIMITS, trials(0), trials(1), (recorded, other))
    assert found["first impact"].value == pytest.approx(12 / 20)  # of the simulated to the recorded one
    assert found["ring hertz"].value == pytest.approx(2.9 / 2.3)
    without = gate.checks(LIMITS, trials(0), trials(1), (recorded, none))
    assert failed(without) == {"first impact", "ring hertz", "ring peak", "ring damping"}
    assert gate.as_json(without)["first impact"]["value"] is None
    assert "ring hertz" not in gate.checks(LIMITS, trials(0), trials(1), (none, recorded))


def test_impact_and_ringing_are_measured() -> None:
    times = np.arange(1600) * CONTROL_PERIOD
    since = np.maximum(times - 3.0, 0)
    force = np.where(times < 1, 0.0, 5.0) + 15 * np.exp(-(((times - 1.2) / 0.02) ** 2))
    force = force + 10 * np.exp(-0.06 * 2 * np.pi * 2.5 * since) * np.sin(2 * np.pi * 2.5 * since)
    found = dynamics(np.stack([force, force]), np.array([1600, 1600]), np.array([1.0, np.nan]), np.array([3.0, np.nan]))
    np.testing.assert_allclose(found.impact, [20.0], rtol=1e-3)
    assert found.ring is not None
    np.testing.assert_allclose(found.ring, (2.5, force[600:800].max(), 0.06), rtol=0.05)


def test_only_what_is_in_time_and_in_the_record_is_measured() -> None:
    times = np.arange(1600) * CONTROL_PERIOD
    force = np.interp(times, [1.0, 1.2, 1.3, 1.4, 1.7, 2.0], [0.0, 5.0, 0.0, 7.0, 9.0, 0.0])
    impact = dynamics(np.stack([force, force]), np.array([1600, 270]), np.ones(2), np.full(2, np.nan)).impact
    np.testing.assert_allclose(impact, [np.interp(0.495, [0.4, 0.7], [7.0, 9.0]), 5.0])
    after = np.maximum(times - 3.0, 0.0)
    swing = 12 * np.exp(-after) * np.sin(2 * np.pi * 2.34 * after) + 20 * np.sin(2 * np.pi * 0.5 * after)
    ring = ringing(swing[None], np.array([1400]), np.array([3.0]))  # a trial that ends with the four seconds
    assert ring is not None
    assert ring.hertz == pytest.approx(2.34, abs=0.1)  # a slower and larger swing is none of it
    assert ringing(swing[None], np.array([1399]), np.array([3.0])) is None


def test_rings_on_a_slope_are_those_of_the_middle_trial() -> None:
    after = np.maximum(np.arange(1600) * CONTROL_PERIOD - 3.0, 0.0)
    ring = np.exp(-after) * np.sin(2 * np.pi * 2.34 * after)
    found = ringing(np.array([6.0, 12.0, 30.0])[:, None] * ring + 5 * after, np.full(3, 1600), np.full(3, 3.0))
    assert found is not None
    assert found.peak == pytest.approx((12 * ring + 5 * after)[600:800].max())  # the slope is higher later
    assert found.damping == pytest.approx(1 / (2 * np.pi * 2.34), rel=0.1)


def test_recordings_pass_their_own_gate(hiro_recordings: Recordings) -> None:
    for name, preset in ONE_ARM.items():
        assert preset.gate is not None
        profiles = sessions.recorded(hiro_recordings, name).profiles
        assert failed(gate.checks(preset.gate, profiles[::2], profiles[1::2])) == set(), name


def test_wrong_profiles_are_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        gate.checks(LIMITS, trials(0), trials(1)[:, :3])
    with pytest.raises(InputError, match="test 2; expected at least 3 of each"):
        gate.checks(LIMITS, trials(0), trials(1)[:2])
