"""Snaps in a force: found where a tab gives way, and nowhere in the ringing of a force loop."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.types import Recordings
from sim_mjx.assembly import sensor
from sim_mjx.assembly.rollout import as_float32
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import preset
from sim_mjx.validation import sessions, snaps

TIMES = np.arange(3000) * CONTROL_PERIOD


def held(level: float, since: float) -> np.ndarray:
    """A force that is built up in a second and held."""
    return level * np.clip((TIMES - since), 0.0, 1.0)


def ringing(since: float, size: float, hertz: float = 2.34) -> np.ndarray:
    after = np.maximum(TIMES - since, 0.0)
    return size * np.exp(-1.5 * after) * np.sin(2 * np.pi * hertz * after)


def test_a_snap_is_found_with_its_numbers() -> None:
    force = held(17.0, 1.0)
    force = force - 11.0 * ((TIMES >= 8.0) & (TIMES < 8.1))  # falls within a period, reloads after 0.1 s
    (snap,) = snaps.find(force, touch=1.0)
    assert snap.time == pytest.approx(8.0, abs=2 * CONTROL_PERIOD)
    assert snap.release == pytest.approx(17.0)
    assert snap.drop == pytest.approx(11.0)
    assert snaps.as_recorded(snap)


def test_a_slower_fall_is_counted_to_its_end() -> None:
    force = held(17.0, 1.0) - np.interp(TIMES, [8.0, 8.1, 8.2], [0.0, 11.0, 0.0])
    (snap,) = snaps.find(force, touch=1.0)
    assert (snap.release, snap.drop) == pytest.approx((17.0, 11.0))


def test_snaps_are_in_time_order_and_fall_well_below_their_level() -> None:
    falls = [(TIMES - since >= 0) & (TIMES - since < 0.1) for since in (8.0, 11.0)]
    found = snaps.find(held(17.0, 1.0) - 9.0 * falls[0] - 12.0 * falls[1], touch=1.0)
    assert [round(snap.drop) for snap in found] == [9, 12]
    assert snaps.find(held(40.0, 1.0) - 8.0 * falls[0], touch=1.0) == []  # to 0.8 of the level


def test_overshoot_and_first_touch_are_no_snaps() -> None:
    push = held(10.7, 1.0) + 15.0 * (TIMES >= 6.0) + ringing(6.0, 14.0)  # session A's mating: 39.5 N, then 19 N
    assert push.max() > 35
    assert snaps.find(push, touch=1.0) == []
    bounce = held(12.0, 1.0) - 9.0 * ((TIMES >= 2.1) & (TIMES < 2.2))
    assert snaps.find(bounce, touch=1.0) == []
    assert snaps.find(np.zeros(3000)) == []
    assert snaps.find(held(4.0, 1.0)) == []


def test_ringing_after_a_snap_is_not_counted_again() -> None:
    force = held(17.0, 1.0) - 12.0 * ((TIMES >= 8.0) & (TIMES < 8.1)) + ringing(8.1, 7.0, 3.5)
    later = force - 10.0 * ((TIMES >= 11.0) & (TIMES < 11.1))
    assert len(snaps.find(force, touch=1.0)) == 1
    assert [round(snap.time) for snap in snaps.find(later, touch=1.0)] == [8, 11]


def test_the_filter_is_inverted_exactly() -> None:
    rng = np.random.default_rng(0)
    true = np.cumsum(rng.normal(0, 1, (300, 6)), axis=0)
    params = replace(
        preset("A").sensor, delay=np.array(0), noise=np.zeros(6), step=np.full(6, 1e-6), tared=np.array(0.0),
        reference=np.zeros(3), bias=np.zeros(6),
    )  # fmt: skip
    single = as_float32(params)
    state = sensor.begin(single, jnp.asarray(true[0], jnp.float32))
    logged = []
    for now in true:
        state, out = sensor.read(single, state, jnp.asarray(now, jnp.float32), jnp.zeros(6), jnp.eye(3))
        logged.append(np.asarray(out))
    np.testing.assert_allclose(snaps.unfiltered(np.array(logged).T, params), true.T, atol=2e-3)


def test_summary_counts() -> None:
    few = snaps.Snap(8.0, 17.0, 11.0)
    found = snaps.summary([[], [few], [few, few._replace(release=30.0)], [few] * 4])
    assert found["trials_with_0_1_2_more"] == [1, 1, 1, 1]
    assert found["trials_with_a_snap_as_recorded"] == 3
    assert found["drop_N_5_50_95_percent"] == [11.0, 11.0, 11.0]
    assert snaps.share(snaps.summary([])) == 0.0
    many = snaps.summary([[few._replace(drop=float(drop))] for drop in range(101)])
    assert many["drop_N_5_50_95_percent"] == [5.0, 50.0, 95.0]
    assert snaps.summary([[]])["release_N_5_50_95_percent"] == []


@pytest.mark.parametrize(
    ("release", "drop", "expected"),
    [
        (11.0, 10.0, True), (10.9, 10.0, False), (18.0, 10.0, True), (18.1, 10.0, False), (15.0, 7.0, True),
        (15.0, 6.9, False), (15.0, 17.0, True), (15.0, 17.1, False),
    ],
)  # fmt: skip
def test_recorded_snaps_release_at_11_to_18_newtons_and_drop_by_7_to_17(
    release: float, drop: float, expected: bool
) -> None:
    assert snaps.as_recorded(snaps.Snap(8.0, release, drop)) == expected


def test_recorded_snaps_are_those_of_the_event_table(hiro_recordings: Recordings) -> None:
    """Session B: two snaps of about 17 N in most seated trials (measured apart: release 17.2 N, drop 11.9 N)."""
    found = sessions.recorded(hiro_recordings, "B").snaps
    assert found is not None
    assert found["trials_with_a_snap_as_recorded"] >= 0.85 * found["trials"]
    assert found["release_N_5_50_95_percent"][1] == pytest.approx(17.2, abs=1.0)
    assert found["drop_N_5_50_95_percent"][1] == pytest.approx(11.9, abs=1.5)
    ring = sessions.recorded(hiro_recordings, "A").snaps
    assert ring is not None
    assert ring["trials_with_a_snap_as_recorded"] == 0  # its large peaks are overshoot
