"""The public face of the offline taxonomy: input, results, tracks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.reference import MIN_SAMPLES, OfflineLabels, encode, sample_times, state_vector, to_tracks

DT = 0.005
ONSET = [0.0, 1.0, 2.0, 3.0]


def _wrench(n: int = 900, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(size=(n, 6)), axis=0)


def _encode(n: int = 900, seed: int = 0, **options: Any) -> OfflineLabels:
    return encode(sample_times(n, DT), _wrench(n, seed), ONSET, **options)


def test_sample_times_are_decimal_numbers() -> None:
    times = sample_times(20_000, DT)
    assert times.tolist() == [float(f"{k * DT:.6f}") for k in range(20_000)]
    assert np.any(times != np.arange(20_000) * DT)


@pytest.mark.parametrize(
    ("onset", "states"),
    [
        ([0.0], [0.0, 9.0]),
        ([0.0, 2.0], [0.0, 2.0, 9.0]),
        ([0.0, 99.0], [0.0, 99.0, 9.0]),
        ([0.0, 9.0], [0.0, 9.0]),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0, 9.0]),
        ([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 2.0, 3.0, 9.0]),
        ([0.0, 1.0, np.nan, np.nan], [0.0, 1.0, 9.0]),
    ],
)
def test_state_vector(onset: list[float], states: list[float]) -> None:
    assert state_vector(onset, 9.0) == states


def test_results_have_the_documented_layout() -> None:
    labels = _encode(limits=preset("hiro").limits)
    widths = {"prim_raw": 7, "prim": 7, "mc_raw": 11, "mc": 11, "llb_raw": 17, "llb": 17}
    for name, width in widths.items():
        tables = getattr(labels, name)
        assert len(tables) == 6
        assert all(table.dtype == np.float64 and table.shape == (len(table), width) for table in tables)
    np.testing.assert_array_equal(labels.thresholds[3], [7, 4.6, 2.3, 0.1, -0.1, -2.3, -4.6, -7])
    assert (labels.version, labels.clean, labels.samples, labels.time_start) == ("master", False, 900, 0.0)
    assert labels.states.tolist() == [*ONSET, 4.495]


def test_axes_are_independent() -> None:
    wrench = _wrench()
    whole = encode(sample_times(900, DT), wrench, ONSET)
    wrench[:, 1:] = 0.0
    alone = encode(sample_times(900, DT), wrench, ONSET)
    for layer in ("prim_raw", "mc", "llb"):
        np.testing.assert_array_equal(getattr(whole, layer)[0], getattr(alone, layer)[0])


def test_the_robot_selects_the_limits() -> None:
    assert _encode(robot="pa10").thresholds[0, 0] == 1000
    assert _encode(robot="baxter").thresholds[0, 0] == 70
    assert _encode(calibrated=True).thresholds[0, 0] == 27.31592


def test_an_old_ending_without_any_segment_gives_empty_tables() -> None:
    labels = encode(sample_times(101, DT), np.zeros((101, 6)), ONSET, version="wip")
    assert all(len(getattr(labels, layer)[0]) == 0 for layer in ("prim_raw", "prim", "mc", "llb"))
    assert not np.any(to_tracks(labels, DT).llb.label)


@given(st.integers(0, 10**6), st.integers(MIN_SAMPLES, 40))
def test_the_shortest_recordings_are_labelled(seed: int, n: int) -> None:
    for version in ("master", "a1ca1d1", "wip"):
        for clean in (False, True):
            labels = _encode(n, seed, version=version, clean=clean)
            assert all(np.all(np.isfinite(table)) for table in labels.llb)


def test_layers_cover_the_recording_without_gaps() -> None:
    labels = _encode()
    for table in labels.prim_raw:
        assert table[0, 3] == 0.0
        assert table[-1, 4] == 4.495
        regular = table[:-1, 4] != 1.05 * table[:-1, 3]
        np.testing.assert_array_equal(table[:-1, 4][regular], table[1:, 3][regular])


def test_tracks_cover_the_samples_in_order() -> None:
    labels = _encode()
    tracks = to_tracks(labels, DT)
    for name, table in (("primitive", labels.prim), ("mc", labels.mc), ("llb", labels.llb)):
        track = getattr(tracks, name)
        assert track.label.dtype == np.int8
        assert track.t0.dtype == track.t1.dtype == track.emit.dtype == np.int32
        assert track.label.shape == (6, max(len(axis) for axis in table))
        for axis in range(6):
            n = len(table[axis])
            assert np.all(track.label[axis, :n] > 0)
            for field in ("label", "t0", "t1", "emit", "vmax", "vmin", "avg", "grad"):
                assert not np.any(getattr(track, field)[axis, n:])
            assert np.all(track.emit[axis, :n] == -1)
            assert np.all(track.t1[axis, :n] > track.t0[axis, :n])
            assert np.all(np.diff(track.t0[axis, :n]) >= 0)
            assert (track.t0[axis, 0], track.t1[axis, n - 1]) == (0, 900)


def test_tracks_of_a_ramp_carry_its_numbers() -> None:
    n = 200
    wrench = np.zeros((n, 6))
    wrench[:, 0] = 30.0 * sample_times(n, DT)
    tracks = to_tracks(encode(sample_times(n, DT) + 3.0, wrench, ONSET), DT)
    for track in (tracks.primitive, tracks.mc, tracks.llb):
        assert (track.t0[0, 0], track.t1[0, 0]) == (0, n)
        assert track.vmax[0, 0] == pytest.approx(29.85)
        assert track.vmin[0, 0] == pytest.approx(0.0, abs=1e-6)
        assert track.avg[0, 0] == pytest.approx(29.85 / 2)
        assert track.grad[0, 0] == pytest.approx(30.0)


def test_the_slope_of_a_composition_is_weighted_by_duration() -> None:
    labels = _encode()
    tracks = to_tracks(labels, DT)
    for axis in range(6):
        steps = np.zeros(900)
        prim = tracks.primitive
        for t0, t1, grad in zip(prim.t0[axis], prim.t1[axis], prim.grad[axis], strict=True):
            steps[t0:t1] = grad
        for k in range(len(labels.mc[axis])):
            mean = steps[tracks.mc.t0[axis, k] : tracks.mc.t1[axis, k]].mean()
            assert tracks.mc.grad[axis, k] == pytest.approx(mean, rel=1e-4, abs=1e-4)


GOOD = {"time": sample_times(50, DT), "wrench": np.ones((50, 6)), "onset": ONSET}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wrench": np.ones((50, 5))}, r"shape \(50, 5\); expected \[samples, 6\]"),
        ({"wrench": np.ones(6)}, r"shape \(6,\)"),
        ({"time": sample_times(49, DT)}, r"Time has shape \(49,\); expected \[50\]"),
        ({"time": sample_times(6, DT), "wrench": np.ones((6, 6))}, "6 samples; expected at least 7"),
        (
            {"wrench": np.where(np.arange(300).reshape(50, 6) == 61, np.nan, 0.0)},
            "sample 10 is not",
        ),
        ({"time": np.where(np.arange(50) == 7, np.inf, 1.0)}, "time of sample 7 is not"),
        ({"time": sample_times(50, DT)[::-1]}, "does not increase after sample 0"),
        ({"time": np.minimum(sample_times(50, DT), 0.1)}, "does not increase after sample 20"),
        ({"time": sample_times(50, DT) - 1}, "starts at -1.0 s"),
        ({"onset": []}, "state vector is empty"),
        ({"onset": [np.nan, np.nan]}, "state vector is empty"),
        ({"onset": [0.0, np.nan, 2.0]}, "one to five finite"),
        ({"onset": np.zeros(6)}, "one to five finite"),
        ({"version": "v9"}, "Version 'v9' does not exist; expected one of master"),
        ({"robot": "r2d2"}, "'r2d2' has no thresholds"),
        ({"limits": np.ones((5, 4))}, r"shape \(5, 4\); expected \[6, 4\]"),
        ({"limits": -np.ones((6, 4))}, "positive"),
        ({"limits": np.ones((6, 4)), "calibrated": True}, "Both limits and calibrated"),
    ],
)
def test_bad_input_is_one_sentence(change: dict[str, Any], message: str) -> None:
    arguments = {**GOOD, **change}
    positional = [arguments.pop(name) for name in ("time", "wrench", "onset")]
    with pytest.raises(InputError, match=message):
        encode(*positional, **arguments)


def test_tracks_need_a_sample_period() -> None:
    with pytest.raises(InputError, match=r"sample period is 0\.0 s"):
        to_tracks(_encode(50), 0.0)
