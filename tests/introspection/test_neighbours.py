"""Distances to nominal recordings against loops over all moments that may be neighbours."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rcbht_jax.introspection.neighbours import distances, make_bank, nearest


@pytest.mark.parametrize(("slack", "drift"), [(0.0, 0.0), (1.5, 0.0), (1.0, 0.2), (0.0, 0.3)])
def test_distances_are_those_to_the_nearest_moment_that_may_be_early_or_late(slack: float, drift: float) -> None:
    """Nothing is before the beginning, and a recording that has ended stays as it ended."""
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(length, 2, 3)) for length in (9, 12, 7)]
    bank = make_bank(parts, np.arange(3), slack, drift, neighbours=2)
    test = rng.normal(size=(15, 2, 3))
    test[0] = parts[1][-1]  # a beginning that is like an end
    test[-1] = parts[2][0]
    found = distances(bank, test, np.arange(15))
    for time, row, channel in np.ndindex(15, 3, 2):
        now = min(time, 11)  # the longest lasts twelve moments
        far = min(slack + drift * time, math.ceil(slack + drift * 12))
        near = [
            np.sqrt(np.mean(((test[time, channel] - parts[row][min(u, len(parts[row]) - 1), channel]) / scale) ** 2))
            for u in range(40)
            for scale in [bank.scale[channel]]
            if abs(u - now) <= far
        ]
        assert found[time, row, channel] == pytest.approx(min(near), rel=1e-4, abs=1e-6)
    usual = nearest(found, 2)
    for time, channel in np.ndindex(15, 2):
        assert usual[time, channel] == pytest.approx(np.mean(sorted(found[time, :, channel])[:2]))


def test_where_recordings_agree_by_chance_half_of_the_median_distance_is_usual() -> None:
    """Otherwise the least deviation there would be an alarm."""
    rng = np.random.default_rng(1)
    parts = [np.concatenate([np.zeros((20, 1, 1)), rng.normal(size=(50, 1, 1))]) for _ in range(4)]
    bank = make_bank(parts, np.arange(4), slack=0.0, drift=0.0, neighbours=1)
    flat = np.array(parts)[..., 0, 0] / bank.scale[0, 0]
    apart = [
        min(abs(flat[row, t] - flat[other, t]) for other in range(4) if other != row) for row, t in np.ndindex(4, 70)
    ]
    assert bank.reference[0, 0] == pytest.approx(np.median(apart) / 2, rel=1e-5)
