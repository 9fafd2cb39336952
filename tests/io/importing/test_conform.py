"""One steady grid: against signals whose values are known at every time."""

from __future__ import annotations

from collections.abc import Callable

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import conform


def signal(time: np.ndarray, *hertz: float) -> np.ndarray:
    return np.stack([np.sin(2 * np.pi * f * time) for f in hertz], 1)


def test_a_higher_rate_is_filtered_so_that_nothing_folds_back() -> None:
    time = np.arange(4000) / 1000
    values = signal(time, 20, 180)
    source = conform.clock(time)
    assert source.period == 0.001
    moved, notes = conform.on_grid(time, values, source, 0.005)
    assert notes == ["filtered", "resampled:1000"]
    grid = np.arange(len(moved)) * 0.005
    middle = slice(40, -40)
    # 20 Hz passes without delay; 180 Hz, which would appear as 20 Hz, does not.
    np.testing.assert_allclose(moved[middle, 0], signal(grid, 20)[middle, 0], atol=0.01)
    assert np.abs(moved[middle, 1]).max() < 0.02
    assert np.abs(values[::5, 1]).max() > 0.9  # what leaving samples out would have given


def test_a_lower_rate_is_interpolated_and_said() -> None:
    time = np.arange(100) / 20
    moved, notes = conform.on_grid(time, signal(time, 0.5), conform.clock(time), 0.01)
    assert notes == ["resampled:20"]
    np.testing.assert_allclose(moved[:, 0], signal(np.arange(len(moved)) * 0.01, 0.5)[:, 0], atol=4e-3)
    source = conform.clock(time)
    for count in range(2, 100):  # the last sample is on the grid, however its time is rounded
        assert len(conform.on_grid(time[:count], time[:count, None], source, 0.01)[0]) == 5 * count - 4


def test_steady_samples_stay_as_they_are() -> None:
    for period in (0.001, 0.0016666667, 0.005, 0.021, 0.05):
        for origin in (0.0, 1.5e9):
            time = origin + np.round(np.arange(300) * period, 5)
            source = conform.clock(time - time[0])
            assert source.steady
            assert source.period == pytest.approx(period, rel=1e-4)
            values = np.random.default_rng(0).normal(size=(300, 2))
            moved, notes = conform.on_grid(time - time[0], values, source, source.period)
            assert moved is values
            assert notes == []


def test_jitter_is_interpolated_at_its_own_rate() -> None:
    time = np.sort(np.arange(2000) / 1000 + np.random.default_rng(0).uniform(-0.0004, 0.0004, 2000))
    source = conform.clock(time)
    assert not source.steady
    assert source.period == pytest.approx(0.001)
    moved, notes = conform.on_grid(time, signal(time, 5), source, 0.001)
    assert notes == ["uneven"]
    np.testing.assert_allclose(moved[:, 0], signal(time[0] + np.arange(len(moved)) * 0.001, 5)[:, 0], atol=1e-3)


@pytest.mark.parametrize("count", [7, 1200, 90000])
@pytest.mark.parametrize("rate", [300.0, 30.0, 240.0, 1 / 0.021, 125.0])
def test_a_rate_of_rounded_stamps_is_a_round_one(rate: float, count: int) -> None:
    assert conform.clock(np.round(np.arange(count) / rate, 5)).rate == pytest.approx(rate, rel=1e-12)


def test_gaps_are_noted() -> None:
    time = np.delete(np.arange(1000) * 0.005, np.r_[300:369, 500:510])
    source = conform.clock(time)
    _, notes = conform.on_grid(time, signal(time, 1), source, 0.005)
    assert notes == ["gap:0.35", "gaps:2", "uneven"]


def test_saturation() -> None:
    push = np.clip(40 * np.sin(np.linspace(0, 9, 900)), -30, 30)
    rest = np.maximum(40 * np.sin(np.linspace(0, 9, 900)), 0)
    few = np.repeat([0.0, 1.0, 2.0], 300)
    assert conform.saturated(np.stack([push, rest, few, np.zeros(900), rest + 5], 1)) == [0]


def test_an_axis_that_stops_changing_is_stuck() -> None:
    noise = np.random.default_rng(0).normal(size=(300, 3))
    noise[100:150, 0] = noise[100, 0]
    noise[-40:, 1] = 0.0  # at rest, as simulated sensors are
    steps = np.round(np.linspace(0, 9, 300))  # of a coarse sensor
    assert conform.stuck(np.column_stack([noise, steps])) == [0]
    assert conform.stuck(np.array([[0.0, 1.0, 3.0, *[2.0] * 20]]).T) == []  # hardly anything else to compare with


@pytest.mark.parametrize(("log", "sensor"), [(1000, 400), (500, 100), (500, 250)])
def test_repeats_of_a_slower_sensor_are_told_from_new_values(log: int, sensor: int) -> None:
    measured = np.random.default_rng(0).normal(size=(200, 2))
    number = np.arange(3, 200 * log // sensor) * sensor // log  # the log begins amid a value
    new = conform.fresh(measured[number])
    np.testing.assert_array_equal(measured[number][new], measured[number[new[0]] :])
    assert len(conform.fresh(measured)) == len(measured)
    assert conform.fresh(np.repeat(measured, 5, axis=0))[:2].tolist() == [0, 5]  # a first value that is held as long
    coarse = np.round(measured[:, :1])  # repeats by chance
    assert len(conform.fresh(coarse)) == len(coarse)
    ramp = np.repeat(np.arange(60.0), 5)[:, None]  # in whole numbers
    assert len(conform.fresh(ramp)) == len(ramp)


def test_missing_values_and_repeated_stamps() -> None:
    time = np.arange(50) * 0.1
    values = np.stack([time, 2 * time], 1)
    values[10:15, 1] = np.nan
    times = time.copy()
    times[20] = times[19]
    tidied, filled, notes = conform.tidy(times, values)
    assert notes == ["repeated:1", "missing:5"]
    assert len(tidied) == 49
    np.testing.assert_allclose(filled[:, 1], 2 * filled[:, 0])
    values[10:16, 1] = np.nan
    with pytest.raises(InputError, match="6 values in a row are missing, first at sample 10"):
        conform.tidy(time, values)
    with pytest.raises(InputError, match="3 values in a row are missing"):  # few, but all of a channel
        conform.tidy(time[11:14], values[11:14])


def test_a_few_samples_out_of_order_are_sorted() -> None:
    time = np.arange(300) * 0.01
    swapped = time.copy()
    swapped[[100, 101]] = swapped[[101, 100]]
    tidied, values, notes = conform.tidy(swapped, swapped[:, None])
    assert notes == ["unordered:1"]
    np.testing.assert_array_equal(tidied, time)
    np.testing.assert_array_equal(values[:, 0], time)
    with pytest.raises(InputError, match=r"starts anew at sample 150.*--group"):
        conform.tidy(np.concatenate([time[:150], time[:150]]), np.zeros((300, 1)))


def test_the_common_rate_is_that_of_most() -> None:
    steady = [conform.Clock(0.001, True)] + [conform.Clock(0.005, True)] * 2
    assert conform.common(steady) == 0.005
    assert conform.common([*steady, conform.Clock(0.001, True)]) == 0.005  # at a draw the lower rate
    uneven = [conform.Clock(1 / 38.5, False)] * 2 + [conform.Clock(0.025, False)] * 3
    assert conform.common(uneven) == 0.025
    assert conform.common([conform.Clock(0.02, False)] * 3 + [conform.Clock(0.01, True)]) == 0.01


@given(
    hnp.arrays(np.float64, st.integers(2, 60), elements=st.floats(1e-4, 5)),
    st.sampled_from([0.001, 0.01, 0.1, 1.0]),
)
def test_any_spacing_gives_finite_values_within_the_signals_range(steps: np.ndarray, period: float) -> None:
    time = np.cumsum(steps)
    values = np.sin(time)[:, None]
    source = conform.clock(time)
    try:
        moved, _ = conform.on_grid(time, values, source, period)
    except InputError:
        assert time[-1] - time[0] < period  # nothing but too short
        return
    assert np.isfinite(moved).all()
    assert len(moved) >= 2


def test_a_clock_that_hardly_moves_is_refused_without_a_warning() -> None:
    source = conform.clock(np.cumsum([0.0, 5e-324, 5e-324, 1.0]))
    with pytest.raises(InputError, match="the time step is"):
        conform.checked_period(conform.common([source]))
    assert conform.common([conform.Clock(0.0, False), conform.Clock(0.005, True)]) == 0.005
    assert not conform.agrees(source, 0.0)


def test_stamps_that_repeat_with_other_values_are_refused() -> None:
    """Two arms in one table, or stamps of whole seconds: half of the samples were left out and the others mixed."""
    arms, seconds = np.repeat(np.arange(300) * 0.005, 2), np.floor(np.arange(3000) * 0.01)
    for time, count in ((arms, "300 of 600"), (seconds, "2970 of 3000")):
        with pytest.raises(InputError, match=f"time stamps repeat {count} times, .*--group.*--source-rate"):
            conform.tidy(time, np.arange(len(time))[:, None] * 1.0)
    _, _, notes = conform.tidy(arms, np.stack([arms, np.full(600, np.nan)], 1)[:, :1])
    assert notes == ["repeated:300"]  # copies of samples are none of their own


@pytest.mark.parametrize("lost", [np.r_[100:150], np.random.default_rng(0).choice(np.arange(1, 1499), 60)])
def test_lost_samples_do_not_make_a_recording_slower(lost: np.ndarray) -> None:
    time = np.delete(np.arange(1500) / 250, lost)
    assert conform.clock(time).period == pytest.approx(1 / 250)


def test_a_clock_that_is_a_little_off_is_resampled() -> None:
    """Kept as they are, the samples of five minutes leave the annotations by a quarter of a second."""
    time = np.arange(60000) / 200.16
    moved, notes = conform.on_grid(time, time[:, None], conform.clock(time), 0.005)
    assert notes == ["resampled:200.16"]
    np.testing.assert_allclose(moved[:, 0], np.arange(len(moved)) * 0.005, atol=1e-9)


@pytest.mark.parametrize("share", [0.55, 0.6, 0.65])
@pytest.mark.parametrize("gap", [0, 2000])
def test_a_sensor_between_the_rows_of_a_faster_log_has_its_own_rate(share: float, gap: int) -> None:
    """The rate was that of every second row, with the note that its samples jitter."""
    rows = np.ceil(np.arange(1200) / share)  # each value is logged by the next row
    rows[700:] += gap
    source = conform.clock(rows / 500)
    assert (source.rate, source.steady) == (pytest.approx(500 * share), False)


@pytest.mark.parametrize("count", [2, 4, 8])
@pytest.mark.parametrize("extra", [0, 1])
@pytest.mark.parametrize("step", [1e-4, 2e-7])
def test_samples_in_bursts_have_their_mean_rate(count: int, extra: int, step: float) -> None:
    """The rate was that within a burst: 500 samples per second became 10,000, or the unit of time was doubted."""
    number = np.arange(1000 + extra)
    time = number // count * count * 0.002 + number % count * step
    time[500:] += 30.0  # a pause
    source = conform.clock(time)
    assert (source.rate, source.bursts) == (500.0, True)
    assert conform.clock(time[: 12 * count]).rate == 500.0  # the pauses between few bursts are fewer than the bursts


def test_a_gap_of_a_short_recording_makes_no_bursts() -> None:
    time = np.delete(np.arange(30) * 0.1, np.r_[10:18])
    assert conform.clock(time) == conform.Clock(0.1, False)
    often = np.arange(3000) / 250 + np.repeat(np.arange(15), 200)  # more gaps, but few beside the samples
    assert conform.clock(often) == conform.Clock(1 / 250, False)


@pytest.mark.parametrize(("rate", "tick"), [(750, 1e-3), (800, 1e-3), (900, 1e-3), (90, 1e-2), (240, 4e-3)])
@pytest.mark.parametrize("rounding", [np.floor, np.round])
def test_stamps_that_are_rounded_to_nearly_a_step_keep_the_rate(
    rate: float, tick: float, rounding: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> None:
    """800 samples per second whose stamps are in whole milliseconds were 1000."""
    time = rounding(np.arange(2000) / rate / tick) * tick
    assert conform.clock(time).rate == pytest.approx(rate, rel=0.01)
    lost = np.random.default_rng(0).random(2000) < 0.2  # samples that are lost do not make a rate lower
    assert conform.clock(np.arange(2000)[~lost] * tick).rate == pytest.approx(1 / tick, rel=0.01)


@pytest.mark.parametrize("rate", [10, 40, 50, 125, 200, 500])
def test_a_sample_that_is_lost_regularly_does_not_make_the_rate_lower(rate: float) -> None:
    """50 samples per second, of which every tenth was lost, were 45: no clock has ticks of 20 ms."""
    time = np.delete(np.arange(2000) / rate, np.s_[5::10])
    assert conform.clock(time).rate == pytest.approx(rate, rel=0.01)


def test_few_or_irregularly_lost_samples_are_no_rounded_stamps() -> None:
    """All steps are one or two ticks, as those of rounded stamps are."""
    apart = np.random.default_rng(0).choice(np.arange(2, 1998, 2), 60, replace=False)
    for lost, count in ((apart, 2000), (np.arange(5, 200, 10), 200)):
        assert conform.clock(np.delete(np.arange(count), lost) / 1000).rate == pytest.approx(1000, rel=0.01)
