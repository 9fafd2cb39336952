"""What becomes of the readings of a source, and what is said of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax.errors import InputError
from rcbht_jax.events import Notice
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.opening import read_opening
from rcbht_jax.introspection.resampling import Resampler, resampled
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Sample
from tests.support.introspection_models import model

DT = 0.005
ZERO = (0.0,) * 6


def fed(readings: list[tuple[float | None, float]], **options: float) -> tuple[np.ndarray, list[str], int]:
    """First axis of the grid samples, kinds of reports, and how often everything started anew."""
    resampler, out, kinds, anew = Resampler(DT, **options), [], [], 0
    for stamp, value in readings:
        regular = resampler.feed(Sample((value,) * 6, stamp))
        out.append(regular.samples[:, 0])
        kinds += [report.kind for report in regular.reports]
        anew += regular.anew
    return np.concatenate(out), kinds, anew


@given(st.floats(-1e9, 2e9), st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=50))
def test_regular_readings_pass_unchanged(start, values):
    samples, kinds, _ = fed([(start + k * DT, v) for k, v in enumerate(values)])
    assert samples.tolist() == values
    assert not kinds
    untimed, kinds, _ = fed([(None, v) for v in values])
    assert untimed.tolist() == values
    assert not kinds


@given(st.lists(st.floats(-0.45, 0.45), min_size=10, max_size=60), st.floats(0.5, 4))
@example([0.0] * 60, 0.875)  # a faster source is noticed in the middle of a period
@example([0.0, 0.4] * 40, 0.6)
def test_a_straight_line_stays_straight_whatever_the_clock(off, pace):
    """Jitter and another sampling rate do not bend a ramp, and every grid time has one sample."""
    stamps = (np.arange(len(off)) + np.array(off)) * DT * pace
    stamps[0] = 0.0
    samples, _, anew = fed([(float(t), 100 * float(t)) for t in stamps])
    assert anew == 0
    count = round(stamps[-1] / DT)
    assert abs(len(samples) - 1 - count) <= 1
    np.testing.assert_allclose(samples, np.arange(len(samples)) * DT * 100, atol=100 * DT * 0.011)


def test_missing_repeated_late_and_bad_readings():
    samples, kinds, anew = fed([(0.0, 0.0), (DT, 1.0), (3 * DT, 3.0), (3 * DT, 9.0), (2 * DT, 9.0), (4 * DT, 4.0)])
    assert samples.tolist() == [0, 1, 2, 3, 4]
    assert kinds == ["gap", "repeated", "late"]
    samples, kinds, anew = fed([(0.0, 0.0), (DT, math.nan), (2 * DT, 2.0), (3 * DT, math.inf), (4 * DT, 4.0)])
    assert samples.tolist() == [0, 1, 2, 3, 4]
    assert kinds == ["not-finite", "gap", "not-finite"]  # the second gap is told later, with those that follow
    samples, kinds, anew = fed([(None, 0.0), (None, math.nan), (None, 1e30), (None, 3.0), (None, 4.0)])
    assert samples.tolist() == [0, 1, 2, 3, 4]
    assert anew == 0
    samples, kinds, _ = fed([(None, math.nan), (None, 0.0), (None, 1.0)])  # the first reading begins the grid
    assert (samples.tolist(), kinds) == ([0, 1], ["not-finite"])


def test_long_gaps_and_jumps_start_anew():
    samples, kinds, anew = fed([(0.0, 0.0), (0.06, 1.0), (-5.0, 2.0), (-5.0 + DT, 3.0)])
    assert samples.tolist() == [0, 1, 2, 3]
    assert kinds == ["gap", "gap"]
    assert anew == 2
    assert not any(fed([(k / 7, 0.0), (k / 7 + 0.05, 1.0)])[2] for k in range(50))  # as long as is bridged
    with pytest.raises(InputError):
        Resampler(DT, bridge=DT)


def test_jitter_is_reported_once_per_second():
    rng = np.random.default_rng(0)
    readings = [((k + rng.uniform(-0.4, 0.4)) * DT, 0.0) for k in range(1000)]
    kinds = fed(readings)[1]
    assert kinds.count("jitter") == 4
    assert not fed([((k + 0.001) * DT, 0.0) for k in range(1000)])[1]


@pytest.mark.parametrize("rate", [40, 125])
def test_a_source_of_another_rate_is_told_of_once_per_second(rate):
    """It was one notice for each reading of a slower source."""
    resampler = Resampler(DT)
    told = [report for k in range(10 * rate) for report in resampler.feed(Sample(ZERO, k / rate)).reports]
    assert 9 <= len(told) <= 20
    assert f"{rate} readings in 1 s" in told[-1].text
    bridged = sum(report.count for report in told + resampler.finish() if report.kind == "gap")
    assert bridged == {40: 4, 125: 1}.get(rate, 0) * (10 * rate - 1)


@pytest.mark.parametrize("rate", [250, 333, 500, 1000])
def test_of_a_faster_source_samples_are_means_over_a_period(rate):
    """They were single readings, so that a vibration of 200 Hz came into an encoder of 200 Hz as a constant force."""
    time = np.arange(3 * rate) / rate
    signal = np.interp(time, [0.5, 1.0, 2.0], [0.0, 5.0, -5.0])
    samples, kinds, _ = fed(list(zip(time, signal, strict=True)))
    assert kinds == ["faster"]
    assert 598 <= len(samples) <= 600
    fine = np.interp(np.arange(6000) / 2000, time, signal)  # mean of the ten twentieths of each period
    expected = [fine[max(10 * k - 5, 0) : 10 * k + 5].mean() for k in range(len(samples))]
    np.testing.assert_allclose(samples[51:], expected[51:], atol=0.02)
    level = [(moment + late, 3.0) for late in (0.0, 10.0, 20.0) for moment in time[:300].tolist()]
    samples, _, anew = fed(level)
    assert anew == 2
    np.testing.assert_allclose(samples, 3.0)  # also where a stretch begins
    vibration = fed(list(zip(time, np.sin(2 * np.pi * 200 * time + 1.0), strict=True)))[0]
    assert rate < 500 or np.abs(vibration[51:]).max() < 0.2  # 0.84 in single readings


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_a_source_is_faster_from_eleven_tenths_on(start: float) -> None:
    """It was from 1.111 times on; docs/online.md states 1.1."""
    later = [(start + min(k, 500 + k / 2) * DT, 0.0) for k in range(1150)]  # twice as fast from reading 1000 on
    assert "faster" in fed(later)[1]
    for rate, kinds in ((216, []), (220, ["faster"])):
        assert fed([(start + k / rate, 0.0) for k in range(200)])[1][:1] == kinds


def test_a_stream_that_repeats_the_values_of_a_slower_sensor_has_its_rate():
    values = np.repeat(np.random.default_rng(0).normal(size=(60, 6)), 10, axis=0)
    opening = read_opening(iter([Sample(tuple(value), k / 1000) for k, value in enumerate(values.tolist())]), 1.0)
    assert opening.rate() == 100


def test_jitter_is_reported_when_a_stretch_ends():
    """A pause, and the end, tell what less than a second of readings had to report."""
    stretch = [(k * 0.0065, 0.0) for k in range(90)]
    kinds = fed(stretch + [(5 + time, 0.0) for time, _ in stretch])[1]
    assert kinds == ["gap", "jitter"]
    session = Session(Introspector(model()))
    events = list(session.run([Sample(ZERO, time) for time, _ in stretch]))
    assert not [event for event in events if isinstance(event, Notice)]
    assert [event.kind for event in session.finish() if isinstance(event, Notice)] == ["jitter"]
    assert session.finish() == []


anything = st.floats() | st.sampled_from([0.0, DT, 2 * DT, 3 * DT, 1.0, -1e308, 1e308])


@given(st.lists(st.tuples(st.none() | anything, anything), max_size=60))
def test_any_readings_give_few_finite_samples(readings):
    resampler = Resampler(DT)
    for stamp, value in readings:
        regular = resampler.feed(Sample((value,) * 6, stamp))
        assert len(regular.samples) <= 12
        assert np.isfinite(regular.samples).all()
        assert regular.samples.dtype == np.float32


def test_a_source_too_slow_for_every_gap_is_told_what_helps() -> None:
    def said(bridge: float | None) -> list[str]:
        resampler = Resampler(0.005, bridge, 1)
        found = [resampler.feed(Sample((1.0,), time)) for time in (0.0, 0.005, 0.105, 0.205)]
        return [report.text for one in found for report in one.reports]

    first, second = said(None)
    assert first == "no reading for 0.100 s; everything starts anew"  # a gap of a source that is fast enough
    assert second == first + "; a source that is always so slow needs a longer --max-gap"
    assert not any("anew" in text for text in said(0.2))


def test_a_slow_recording_has_no_gaps_for_a_faster_encoder() -> None:
    """At 10 Hz every reading comes after more than the gap that is filled by default; the line between two is known."""
    force = np.interp(np.arange(600) * 0.1, [0, 20, 25, 60], [0, 0, 5, 5])
    slow = rj.Recordings.from_arrays([force[:, None]], rate=10, axes=("Fz",), units=("N",))
    made = resampled(slow, 100)
    assert (made.length.tolist(), made.dt) == ([5991], 0.01)
    np.testing.assert_allclose(made.wrench[0, ::10], slow.wrench[0], atol=1e-5)


def test_the_opening_is_bridged_as_the_stream_is() -> None:
    readings = [Sample((float(k),), 0.1 * k) for k in range(50)]
    opening = read_opening(iter(readings))
    assert opening.recordings(100.0, ("Fz",), bridge=0.2).length.tolist() == [491]
    assert opening.recordings(100.0, ("Fz",)).length.tolist() == [50]  # the stream begins anew with every reading
    untimed = read_opening(Sample(reading.wrench) for reading in readings)
    assert untimed.recordings(100.0, ("Fz",)).wrench[0, :, 0].tolist() == list(range(50))


@pytest.mark.parametrize(
    ("rate", "seconds", "read"), [(2.0, 0.0, 1), (None, 0.0, 50), (2.0, 3.0, 50), (100.0, 3.0, 300)]
)
def test_where_the_rate_is_known_the_first_reading_is_enough(rate: float | None, seconds: float, read: int) -> None:
    """Words of a slow source would wait for long, and nothing is learned from the readings."""
    taken: list[int] = []

    def source() -> Iterator[Sample]:
        for k in range(1000):
            taken.append(k)
            yield Sample((1.0, 2.0), k / (rate or 10.0))

    opening = read_opening(source(), seconds, rate)
    assert opening.wrench.shape[1] == 2
    assert len(taken) == pytest.approx(read, abs=1)
