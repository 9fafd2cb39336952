"""What all events say: when it was, which does not depend on how the samples were cut, and in which trial."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.errors import InputError
from rcbht_jax.events import AnomalyCleared, AnomalyRaised, Belief, SubtaskStarted, TrialStarted
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.nominal_file import MonitorFile
from rcbht_jax.introspection.nominal_watch import NominalWatch
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.introspection.segmenter_file import SegmenterFile
from rcbht_jax.introspection.segmenter_stream import SegmenterStream
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Begin, Malformed, Message, Reset, Sample
from rcbht_jax.labels import AXES, UNITS
from rcbht_jax.types import Recordings
from tests.io.test_stream_sources import samples_of
from tests.support.introspection_models import FIT, FIT_LIMITS, model, trial

WRENCH = np.concatenate([trial(2, 4, 200), trial(1, 5, 150)])
WRENCH[80:200, 2] += 8
KINDS = {"Word", "Belief", "Snap", "AnomalyScore", "AnomalyRaised", "AnomalyCleared"}
NOMINAL = np.stack([trial(2, seed, 350) for seed in range(30)])


def segmenter_at(rate: float) -> SegmenterStream:
    data = Recordings.from_arrays(NOMINAL[:4], rate)
    fitted = WrenchSegmenter(trees=5, words=False).fit(data, [np.arange(350) // 200] * 4)
    return SegmenterStream(SegmenterFile.of(fitted, "phase", ("before", "after")))


def watch_at(rate: float) -> NominalWatch:
    monitor = NominalMonitor(rate=rate, memory=0.1).fit(NOMINAL)
    return NominalWatch(MonitorFile(monitor, AXES, UNITS), 0.1)


@cache
def stream_at(rate: float) -> Together:
    """Every kind of stream; a model has its own rate, 200 Hz."""
    words = WordIntrospector(replace(FIT, dt=1 / rate), FIT_LIMITS)
    readers = [SnapDetector(rate, ["Fz", "My"], least=3.0), segmenter_at(rate), watch_at(rate)]
    return Together(Together(Introspector(model()), words) if rate == 200 else words, readers=readers)


def said(cuts: list[int], start: float | None, rate: float = 200.0, digits: int = 6) -> list[dict[str, Any]]:
    stream = stream_at(rate)
    stream.reset()
    events, end = [], 0
    for piece in np.split(WRENCH, sorted(cuts)):
        end += len(piece)
        events += stream.push(piece, None if start is None else round(start + (end - 1) / rate, digits))
    return [event.to_json() for event in [*events, *stream.finish(), *stream.reset()]]


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 350), max_size=40), st.sampled_from([None, 0.0, 12.3, 1.7e9 + 0.125]))
def test_events_are_the_same_however_the_samples_are_cut(cuts, start):
    """Every word, belief and snap, with its stamps, in order; the last digits of stamps were others."""
    events = said(cuts, start)
    assert {event["event"] for event in events} == KINDS
    assert events == said([], start)
    assert not any(repr(value) == "-0.0" for event in events for value in event.values())


@pytest.mark.parametrize("pieces", [7, 50])
def test_stamps_without_those_of_a_source_are_the_same_however_the_samples_are_cut(pieces: int) -> None:
    """At 240 Hz, where a sample does not last a whole number of nanoseconds."""
    events = said([*range(350 // pieces, 350, 350 // pieces)], None, 240.0)
    assert {event["event"] for event in events} == KINDS
    assert events == said([], None, 240.0)
    assert all(event["time"] == round(event["sample"] / 240, 9) for event in events)


def test_stamps_of_a_source_at_240_hz_are_the_same_sample_by_sample() -> None:
    """Where a stamp was that of the sample itself, it was not rounded, and differed from others in the last digits."""
    assert said([*range(1, 350)], 12.3, 240.0, 15) == said([], 12.3, 240.0, 15)


def test_events_say_which_trial_they_are_of():
    """Those of several trials, one after the other, could not be told apart; a trial without a reading has none."""
    session = Session(Introspector(model()))
    messages = [Reset("one"), *samples_of(trial(0, 1, 40)), Reset("none"), Reset("two"), Malformed("x")]
    events = list(session.run([*messages, *samples_of(trial(0, 2, 40))]))
    started = [(k, event) for k, event in enumerate(events) if isinstance(event, TrialStarted)]
    assert [event.to_json() for _, event in started] == [
        {"event": "TrialStarted", "sample": 0, "time": 0.0, "trial": name} for name in ("one", "two")
    ]
    assert started[0][0] == 0
    assert sum(isinstance(event, Belief) for event in events[: started[1][0]]) == 6


def test_a_trial_begins_before_its_first_sub_task_and_both_with_the_first_sample():
    """The sub-task came first, and at time zero, though the clock was a date."""
    session = Session(Introspector(model()))
    messages: list[Message] = []
    for start in (1.7e9, 1.7e9 + 100):
        readings = [replace(one, time=start + one.time) for one in samples_of(trial(0, 1, 40))]
        messages += [Reset(), Begin("first"), Sample((np.nan,) * 6, start - 1.0), Begin("last"), *readings]
    events = [event for event in session.run(messages) if isinstance(event, TrialStarted | SubtaskStarted)]
    assert [type(event) for event in events] == [TrialStarted, SubtaskStarted] * 2
    assert [event.time for event in events] == [1.7e9] * 2 + [1.7e9 + 100] * 2
    assert [event.label for event in events[1::2]] == ["last", "last"]  # the other one has no sample


def test_an_alarm_that_a_gap_or_a_trial_ends_is_cleared():
    """It was raised again, as if it had never been."""
    shaken = samples_of(trial(1, 40, 400))
    later = [replace(one, time=one.time + 5.0) for one in shaken]
    for message in ([], [Reset()]):
        events = list(Session(Introspector(model())).run([*shaken, *message, *later]))
        alarms = [event for event in events if isinstance(event, AnomalyRaised | AnomalyCleared)]
        assert [type(event) for event in alarms] == [AnomalyRaised, AnomalyCleared, AnomalyRaised]
        assert (alarms[1].sample, alarms[1].time, alarms[1].head) == (400, shaken[-1].time, "outcome")
        assert alarms[1].probability > 0.5


@cache
def streams() -> list[Introspector | WordIntrospector | SnapDetector | SegmenterStream | NominalWatch]:
    """Of all six axes."""
    words = WordIntrospector(FIT, FIT_LIMITS)
    return [
        Introspector(model()), words, SnapDetector(200.0, AXES, least=3.0), segmenter_at(200.0), watch_at(200.0)
    ]  # fmt: skip


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_stamp_that_is_no_time_is_refused(time: float) -> None:
    for stream in streams():
        stream.reset()
        with pytest.raises(InputError, match="expected a finite number"):
            stream.push(WRENCH[:40], time)
        events = stream.push(WRENCH)
        stream.reset()
        assert events == stream.push(WRENCH)  # nothing had been consumed


def test_axes_in_another_order_are_refused_by_every_stream() -> None:
    """They were read as those of the stream."""
    frame = pd.DataFrame(WRENCH, columns=AXES)
    for stream in streams():
        stream.reset()
        with pytest.raises(InputError, match=r"The samples have the axes Mz, .*; the stream has Fx"):
            stream.push(frame[[*AXES[::-1]]])
        assert stream.push(frame)


def test_a_frame_of_another_rate_is_refused_by_every_stream() -> None:
    """Two seconds at 100 Hz were read as one at 200 Hz."""
    slow, right = (pd.to_timedelta(np.arange(len(WRENCH)) / rate, unit="s") for rate in (100, 200))
    for stream in [*streams(), Encoder(FIT, FIT_LIMITS)]:
        stream.restart() if isinstance(stream, Encoder) else stream.reset()
        with pytest.raises(InputError, match="The rate is 200, but the time has 100 samples per second"):
            stream.push(pd.DataFrame(WRENCH, slow, AXES))
        assert stream.push(pd.DataFrame(WRENCH, right, AXES))
    together, timed = stream_at(200.0), pd.DataFrame(WRENCH, columns=AXES)
    together.reset()
    expected = together.push(WRENCH)
    together.reset()
    timed.insert(0, "time", np.arange(len(WRENCH)) / 200)  # a column that is no axis, for its readers neither
    assert together.push(timed) == expected
