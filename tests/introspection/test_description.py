"""Sentences about recordings: turning points against brute force, changes and ringings that were put in."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.description import (
    Change,
    Ringing,
    changes,
    describe_recording,
    sentences,
    turning_points,
    with_ringing,
)
from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings


@given(st.lists(st.integers(-9, 9), min_size=1, max_size=40), st.integers(1, 6))
def test_turning_points_alternate_and_leave_no_larger_swing_out(heights: list[int], least: int) -> None:
    values = np.array(heights, float)
    points = turning_points(values, least)
    assert points == sorted(set(points))
    steps = np.diff(values[points])
    assert (np.abs(steps) >= least).all()
    assert (steps[1:] * steps[:-1] < 0).all()
    # Between two turning points nothing turns back by as much, and before the first and after the last one neither.
    for first, last in pairwise(points):
        sign = np.sign(values[last] - values[first])
        way = values[first : last + 1] * sign
        assert (np.maximum.accumulate(way) - way).max() < least
    if len(points) == 1:
        assert np.ptp(values) < least
    else:
        assert np.ptp(values[: points[0] + 1]) < least
        assert np.ptp(values[points[-1] :]) < least


def test_times_are_those_of_a_tenth_and_nine_tenths() -> None:
    time = np.array([0.0, 2.0, 3.0, 9.0])
    assert changes("Fx", time, np.array([1.0, 1.0, -9.0, -9.0]), 2.0) == [Change("Fx", 2.1, 2.9, -10.0)]
    assert changes("Fx", time, np.array([1.0, 1.5, 1.0, 1.2]), 2.0) == []


def test_even_swings_ring_and_a_single_push_does_not() -> None:
    swings = [Change("Fz", 1 + k * 0.25, 1.1 + k * 0.25, 8.0 * (-1) ** k) for k in range(6)]
    push = Change("Fz", 0.0, 0.4, 40.0)
    told = with_ringing([push, *swings])
    assert told[0] == push
    assert isinstance(told[1], Ringing)
    assert (told[1].frequency, told[1].height, len(told)) == (pytest.approx(2.0), 8.0, 2)
    slow = [Change("Fz", k * 2.0, k * 2.0 + 1, 8.0 * (-1) ** k) for k in range(6)]
    assert with_ringing(slow) == slow


def test_no_ringing_is_faster_than_half_the_sampling_rate() -> None:
    swings = np.array([0.0, 0.0, 10.0, -10.0, 10.0, -10.0, 10.0, 0.0, 0.0])
    for first in range(400):
        found = with_ringing(changes("Fz", (first + np.arange(9)) / 200, swings, 1.0))
        assert [one.frequency for one in found if isinstance(one, Ringing)] == [pytest.approx(100.0)]


def test_a_press_a_snap_and_a_pull_do_not_ring_and_what_rings_after_a_new_push_does() -> None:
    rises = (7.0, -8.0, 20.0, -24.0)
    phases = [Change("Fz", k * 0.5, k * 0.5 + 0.3, rise) for k, rise in enumerate(rises)]
    assert with_ringing(phases) == phases
    after = [Change("Fz", 2.0 + k * 0.5, 2.3 + k * 0.5, 20.0 * (-0.8) ** k) for k in range(4)]
    told = with_ringing([*phases[:2], *after])
    assert told[:2] == phases[:2]
    assert isinstance(told[2], Ringing)
    assert (told[2].start, told[2].height) == (2.0, 20.0)


@given(st.lists(st.tuples(st.floats(0.01, 3.0), st.floats(0.1, 50.0)), max_size=12))
def test_no_change_is_lost_or_told_twice(steps: list[tuple[float, float]]) -> None:
    starts = np.cumsum([0.0, *(gap for gap, _ in steps)])[:-1]
    series = [Change("a", t, t + 0.005, h * (-1) ** k) for k, (t, (_, h)) in enumerate(zip(starts, steps, strict=True))]
    told = with_ringing(series)
    alone = [one for one in told if isinstance(one, Change)]
    rings = [one for one in told if isinstance(one, Ringing)]
    inside = [c for c in series if any(r.start <= c.start and c.end <= r.end for r in rings)]
    assert [c for c in series if c not in inside] == [c for c in alone if c not in inside]


def test_help_states_which_part_of_a_change_its_duration_is(capsys: pytest.CaptureFixture[str]) -> None:
    """All of a ramp of one second stands beside 0.8 s."""
    ramp = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 10.0, 10.0])
    assert sentences(changes("Fz", *ramp, 1.0), {"Fz": "N"}) == [(1.1, "Fz rises 10 N in 0.8 s")]
    assert main(["describe", "--help"]) == 0
    assert "duration is the time from a tenth to nine tenths of it" in " ".join(capsys.readouterr().out.split())


def test_axes_that_change_together_share_a_sentence() -> None:
    found = [Change("My", 1.05, 1.2, -0.4), Change("Fz", 1.0, 1.3, 131.7), Change("Fx", 1.2, 1.3, 2.0)]
    assert sentences(found, {"Fz": "N", "My": "Nm", "Fx": ""}) == [
        (1.0, "Fz rises 132 N in 0.3 s, My falls 0.4 Nm in 0.15 s"),
        (1.2, "Fx rises 2 in 0.1 s"),
    ]
    assert sentences([Change("Fz", 1.0, 1.3, 2.5e30)], {"Fz": "N"}) == [(1.0, "Fz rises 2.5e+30 N in 0.3 s")]


def test_a_recording_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.arange(1600) / 200
    ring = np.where(time > 4, 6 * np.exp(-(time - 4) / 2) * np.sin(2 * np.pi * 2.5 * (time - 4)), 0)
    push = np.interp(time, [0, 1, 1.2, 8], [0, 0, 15, 15])
    noise = np.random.default_rng(0).normal(size=1600) * 0.05
    recordings = Recordings.from_arrays([np.stack([push + ring + noise, noise * 0], 1)], axes=["grip", "off"])
    write_recordings(tmp_path / "one.zarr", recordings, {})
    assert main(["describe", str(tmp_path / "one.zarr"), str(recordings.trial[0]), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["sentences"]
    assert rows[0]["text"].startswith("grip rises 15 in 0.16 s")
    assert rows[0]["seconds"] == pytest.approx(1.02, abs=0.02)
    assert rows[1]["text"].startswith("grip rings at 2.5 Hz")
    assert not any("off" in row["text"] for row in rows)
    with pytest.raises(InputError, match="between 0 and 1"):
        describe_recording(recordings, 0, 1.5)


def test_samples_that_are_too_few_for_snaps_are_described_without_them() -> None:
    force = np.interp(np.arange(120) / 10, [0, 2, 8, 8.03, 12], [0, 0, 9, 2, 2])[:, None]
    recordings = Recordings.from_arrays([force], 10.0, axes=["Fz"], units=["N"])
    texts = [text for _, text in describe_recording(recordings, 0)]
    assert texts
    assert not any("snap" in text for text in texts)


def test_noise_is_no_change() -> None:
    """An axis of noise with a little drift, one with a push, and one with a step that stands out from its noise."""
    time = np.arange(3000) / 200
    noise = np.random.default_rng(0).normal(0, [0.02, 0.0007, 0.0007], (3000, 3))
    drift = 0.0007 * np.sin(2 * np.pi * time / 4)
    signal = np.stack([np.interp(time, [5, 6], [0, 20]), drift, np.interp(time, [9, 9.5], [0, 0.02])], 1)
    recordings = Recordings.from_arrays([signal + noise], 200.0, axes=["Fz", "Mz", "Mx"], units=["N", "Nm", "Nm"])
    texts = [text for _, text in describe_recording(recordings, 0)]
    assert [text.split(" in ")[0] for text in texts] == ["Fz rises 20 N", "Mx rises 0.02 Nm"]


def test_phases_that_begin_together_stay_in_their_order() -> None:
    marks = Annotations.from_starts("phase", ("touch", "search", "insert"), [[0.0, 0.0, 1.0]], [3.0])
    recordings = Recordings.from_arrays([np.zeros((600, 1))], 200.0, axes=["grip"], units=["N"], annotations=marks)
    said = describe_recording(recordings, 0)
    assert said == [(0.0, "[phase: touch]"), (0.0, "[phase: search]"), (1.0, "[phase: insert]")]


def test_a_recording_is_chosen_as_everywhere() -> None:
    marks = [(1, "phase", "push", 0.0, 1.0)]
    recordings = Recordings.from_arrays(np.zeros((2, 600, 1)), axes=["grip"], units=["N"], annotations=marks)
    assert describe_recording(recordings, -1) == describe_recording(recordings, 1) == [(0.0, "[phase: push]")]
    with pytest.raises(InputError, match="There are 2 recordings"):
        describe_recording(recordings, 2)


@pytest.mark.parametrize(("rise", "said"), [(99.4, "99"), (99.5, "100"), (99.7, "100"), (0.996, "1"), (3e6, "3e+06")])
def test_a_number_is_rounded_before_its_form_is_chosen(rise: float, said: str) -> None:
    """99.7 N was 1e+02 N."""
    assert sentences([Change("Fz", 0.0, 0.5, rise)], {"Fz": "N"}) == [(0.0, f"Fz rises {said} N in 0.5 s")]


def test_a_snap_by_more_than_its_load_is_marked_as_of_an_untared_sensor() -> None:
    """A first contact on a sensor with an offset of 2.4 N was called the release of a load, by an impossible size."""
    time = np.arange(600) / 200
    said = {}
    for offset in (0.0, 2.4, 4.0):
        force = offset + np.interp(time, [1.5, 1.53], [0.0, -3.5])
        recordings = Recordings.from_arrays([force[:, None]], 200.0, axes=["Fz"], units=["N"])
        said[offset] = [text for _, text in describe_recording(recordings, 0) if text.startswith("snap")]
    assert said[0.0] == []  # tared, a contact is none
    assert said[2.4][0].endswith('more than its load: the sensor looks untared, see "rcbht import --tare"')
    assert "untared" not in said[4.0][0]  # a release as large as most of its load may be one


@pytest.mark.parametrize("rate", [200.0, 20.0, 4.0, 2.0, 1.0])
def test_a_smooth_rise_is_given_in_full_at_any_rate(rate: float) -> None:
    """At 2 Hz every gap between two lines was a level stretch of half a second, and 60 N became 32 N."""
    time = np.arange(int(60 * rate)) / rate
    noise = np.random.default_rng(0).normal(size=len(time)) * 0.05
    smooth = 60 * (1 - np.cos(np.pi * np.clip((time - 20) / 20, 0, 1))) / 2
    for force, whole in ((smooth, 60.0), (40 * (1 - np.exp(-np.clip(time - 10, 0, None) / 6)), 40.0)):
        recordings = Recordings.from_arrays([(force + noise)[:, None]], rate, axes=["Fz"], units=["N"])
        [(_, text)] = describe_recording(recordings, 0)
        rise = float(text.split()[2])
        assert abs(rise - whole) <= 0.1 * whole


def test_one_sample_keeps_its_annotations() -> None:
    one = Recordings.from_arrays([np.zeros((1, 2))], 200.0, axes=["Fx", "Fz"])
    marks = Annotations.from_rows([(0, "phase", "touch", 0.0, 0.005)])
    assert describe_recording(replace(one, annotations=marks), 0) == [(0.0, "[phase: touch]")]
