"""Streams whose beginning would never be over: nothing is waited for, or held, without a limit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, count

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.introspection import opening
from rcbht_jax.introspection.opening import read_opening
from rcbht_jax.introspection.resampling import Resampler
from rcbht_jax.io.messages import Malformed, Message, Reset, Sample, parse


def still() -> Iterator[Message]:
    return (Sample((float(k % 7),), 5.0) for k in count())


def test_readings_of_a_clock_that_stands_still_are_counted() -> None:
    assert len(read_opening(still(), seconds=2.0).wrench) == 400
    assert len(read_opening(still(), seconds=2.0, rate=50.0).wrench) == 100


def test_a_clock_that_stands_still_is_named() -> None:
    with pytest.raises(InputError, match="time stamp 5 s: the clock of the source stands still"):
        read_opening(still()).rate()


@pytest.mark.parametrize("message", [Malformed("x"), Sample((float("nan"),), 0.0)])
def test_a_stream_without_readings_ends(message: Message, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "MOST", 300)
    with pytest.raises(InputError, match="The first 300 messages of the stream have no reading"):
        read_opening(message for _ in count())


@pytest.mark.parametrize(
    "line", ['{"force": [0, 0, 5], "torque": [0, 0, 0]}', '{"Fz": 5}', '{"wrench": {"force": {"x": 1}}}']
)
def test_a_stream_of_other_lines_is_told_what_a_reading_is(line: str) -> None:
    expected = r"first problem: .*expected wrench: a list of numbers, or force and torque with x, y and z\.$"
    with pytest.raises(InputError, match=expected):
        read_opening(iter([parse(line)]))


def test_a_clock_that_hardly_moves_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "MOST", 300)
    begun = read_opening((Sample((1.0,), 1e-9 * k) for k in count()), seconds=10.0)
    assert len(begun.wrench) == 300
    assert len([next(begun.messages) for _ in range(400)]) == 400  # nothing is lost


def test_absurd_readings_and_stamps_do_not_decide() -> None:
    """They are left out of the stream, too; NumPy warned about them on the terminal."""
    with np.errstate(all="raise"):
        readings = [Sample((1.0,), 0.005 * k) for k in range(100)]
        begun = read_opening(iter([Sample((1e300,), 0.0), *readings, Sample((2.0,), -1e308), Sample((2.0,), 1e308)]))
        assert begun.rate() == 200
        assert begun.recordings(200.0, begun.axes).wrench.max() == 1
        late = read_opening(iter([Sample((2.0,), 1e308), Sample((2.0,), -1e308), *readings]))
        assert late.rate() == 200


def test_stamps_of_another_unit_are_named() -> None:
    with pytest.raises(InputError, match=r"time step is 5e\+06 s; .* Is the unit of time right"):
        read_opening(Sample((1.0,), 5e6 * k) for k in count()).rate()
    with pytest.raises(InputError, match=r"one every 200 s\. Are its time stamps in seconds"):
        Resampler(200.0)
    Resampler(20.0)  # whose fourfold is more than is bridged


def test_lost_readings_do_not_make_a_stream_slower() -> None:
    kept = (k for k in count() if k not in (20, 40))
    assert read_opening(Sample((1.0,), k / 500) for k in kept).rate() == pytest.approx(500)


def trials(count: int, seconds: float, rate: float = 200.0, resets: bool = True) -> Iterator[Message]:
    """Trials whose stamps begin anew, each at another moment within a period."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield from [Reset()] * resets
        start = float(rng.uniform(0, 1 / rate))
        yield from (Sample((float(rng.normal()),), start + k / rate) for k in range(round(seconds * rate)))


@pytest.mark.parametrize(("seconds", "resets"), [(2.0, True), (2.0, False), (0.5, True)])
def test_each_trial_of_an_opening_has_a_clock_of_its_own(seconds: float, resets: bool) -> None:
    """Their stamps were pooled: three trials gave three times the rate, and readings of short ones were late."""
    begun = read_opening(trials(40, seconds, resets=resets), seconds=6.0)
    assert begun.rate() == pytest.approx(200)
    assert len(begun.wrench) == pytest.approx(1200, abs=20)
    assert len(begun.recordings(200.0, begun.axes).wrench[0]) == pytest.approx(1200, abs=20)


@pytest.mark.parametrize("first", [[0.0], [1.7e9 - 300 + 0.005 * k for k in range(20)], [2e9]])
def test_one_stamp_of_another_clock_or_a_pause_does_not_end_an_opening(first: list[float]) -> None:
    """Thresholds were taken from 50 readings in place of ten seconds."""
    stamps = chain(first, (1.7e9 + 0.005 * k for k in count()))
    begun = read_opening((Sample((float(k % 7),), stamp) for k, stamp in enumerate(stamps)), seconds=10.0)
    assert len(begun.wrench) >= 1800
    assert begun.rate() == pytest.approx(200)


def test_readings_that_come_twice_do_not_end_an_opening_early() -> None:
    begun = read_opening((Sample((float(k),), 0.005 * (k // 2)) for k in count()), seconds=2.0)
    assert len(begun.wrench) == 801


@pytest.mark.parametrize("before", [0, 3])
def test_an_interruption_comes_after_the_readings_before_it(before: int) -> None:
    def interrupted() -> Iterator[Message]:
        yield from (Sample((1.0,), 0.1 * k) for k in range(before))
        raise KeyboardInterrupt

    if not before:
        with pytest.raises(KeyboardInterrupt):
            read_opening(interrupted())
        return
    begun, found = read_opening(interrupted()), list[Message]()
    with pytest.raises(KeyboardInterrupt):
        found.extend(begun.messages)
    assert (len(begun.wrench), len(found)) == (before, before)


def test_readings_of_another_width_than_most_are_left_out_of_an_opening() -> None:
    begun = read_opening(Sample((1.0,) * (1 if k == 7 else 2), 0.1 * k) for k in range(20))
    assert begun.wrench.shape == (19, 2)
    assert len(list(begun.messages)) == 20
