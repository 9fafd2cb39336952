"""Frames of streams that end and begin again: every reading is shown, on the clock of its own trial."""

from __future__ import annotations

import pytest

from rcbht_jax.io.messages import Message, Reset, Sample
from tests.report.test_live_page import frames_of, words_only

DATE = 1.7e9


@pytest.mark.parametrize("stray", [0.0, 2e9])
def test_a_first_reading_of_another_clock_is_a_trial_of_its_own(stray: float) -> None:
    """As of a driver that has no clock yet: all later ticks were dates, and the next reading was not shown."""
    readings = [Sample((float(k),), DATE + 0.005 * k) for k in range(100)]
    frames, _ = frames_of(words_only(), [Sample((9.0,), stray), *readings])
    shown = [(frame["trial"], *reading) for frame in frames for reading in frame["wrench"]]
    assert shown == [(0, stray, 9.0), *((1, round(one.time or 0, 6), *one.wrench) for one in readings)]
    assert {frame["base"] for frame in frames if frame["trial"]} == {DATE}


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_trial_of_few_readings_is_ended_by_a_reset(count: int) -> None:
    messages: list[Message] = []
    for trial in range(3):
        messages += [Reset(f"t{trial}"), *(Sample((1.0,), 0.005 * k) for k in range(count))]
    frames, _ = frames_of(words_only(), messages)
    assert [frame["trial"] for frame in frames for _ in frame["wrench"]] == [k for k in range(3) for _ in range(count)]
    assert {event["trial"]: frame["trial"] for frame in frames for event in frame["events"]} == {
        f"t{k}": k for k in range(3)
    }
