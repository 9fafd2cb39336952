"""Sources of wrenches: JSON lines, recordings, bags; the regulator that puts them on a grid."""

from __future__ import annotations

import io
import json
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Notice, SubtaskStarted, Word
from rcbht_jax.introspection import session as session_module
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.session import Session, Tare, paced
from rcbht_jax.io.messages import (
    LONGEST_SILENCE,
    Begin,
    Malformed,
    Reset,
    Sample,
    Silence,
    parse,
    read_lines,
    read_live,
)
from rcbht_jax.io.playback import play, read_folder
from rcbht_jax.io.store import read_recordings
from rcbht_jax.io.tare import tare as tare_of
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from tests.support.introspection_models import model, trial

DT = 0.005
ZERO = (0.0,) * 6


# --- JSON lines ------------------------------------------------------------------------------------------------------


def test_every_way_to_say_a_sample():
    six = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    force, torque = {"x": 1, "y": 2, "z": 3}, {"x": 4, "y": 5, "z": 6}
    assert parse('{"wrench": [1, 2, 3, 4, 5, 6]}') == Sample(six)
    assert parse(b'{"wrench": [1, 2, 3, 4, 5, 6.0], "time": 7}') == Sample(six, 7.0)
    assert parse(json.dumps({"force": force, "torque": torque, "time": 1.5})) == Sample(six, 1.5)
    ros2 = {"header": {"stamp": {"sec": 12, "nanosec": 500_000_000}}, "wrench": {"force": force, "torque": torque}}
    assert parse(json.dumps(ros2)) == Sample(six, 12.5)
    ros1 = {"header": {"stamp": {"secs": 12, "nsecs": 0}}, "wrench": {"force": force, "torque": torque}}
    assert parse(json.dumps(ros1)) == Sample(six, 12.0)
    assert parse('{"begin": true}') == Begin()
    assert parse('{"reset": true}') == Reset()
    missing = parse('{"wrench": [null, 2, 3, 4, 5, 6]}')
    assert isinstance(missing, Sample)
    assert math.isnan(missing.wrench[0])


@pytest.mark.parametrize(
    "line",
    [
        "", "nonsense", "[1,2,3,4,5,6]", '{"wrench": []}', '{"wrench": "123456"}', '{"wrench": [true,1,1,1,1,1]}',
        '{"begin": 1}', '{"wrench": [1,2,3,4,5,6], "time": "now"}', '{"wrench": {"force": 3}}', "[" * 60_000,
        '{"wrench": [1,2,3,4,5,1' + "0" * 5000 + ']}', "\xff\xfe", '{"a": {"a": {"a": 1}}}', "null", "NaN",
    ],
)  # fmt: skip
def test_what_is_no_message(line):
    found = parse(line)
    assert isinstance(found, Malformed)
    assert "Error" not in found.text  # of a class of Python


@given(st.binary(max_size=300))
def test_any_bytes_give_messages(data):
    for message in read_lines(io.BytesIO(data)):
        assert isinstance(message, Sample | Begin | Reset | Malformed)


def test_a_line_that_says_several_things_is_several_messages():
    reading = b'{"time": 1, "wrench": [1, 2, 3, 4, 5, 6], "begin": true, "reset": true}'
    sample = Sample((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), 1.0)
    assert list(read_lines(io.BytesIO(reading))) == [Reset(), Begin(), sample]
    assert parse(reading) == Malformed("a line has 3 messages; expected one")
    assert [type(m) for m in read_lines(io.BytesIO(b'{"begin": true, "wrench": 3}'))] == [Malformed]


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(
        st.sampled_from(["wrench", "time", "header", "stamp", "sec", "force", "torque", "x", "y", "z", "begin"]), inner
    ),
)  # fmt: skip


@given(json_values)
def test_any_json_gives_a_message(value):
    assert isinstance(parse(json.dumps(value)), Sample | Begin | Reset | Malformed)


def test_a_line_without_end_is_one_malformed_message():
    endless = b"x" * 1_000_000 + b'\n{"begin": true}\n' + b"y" * 70_000
    assert [type(m) for m in read_lines(io.BytesIO(endless))] == [Malformed, Begin, Malformed]


# --- session ---------------------------------------------------------------------------------------------------------


def samples_of(wrench: np.ndarray, begins: tuple[int, ...] = ()) -> list[object]:
    out: list[object] = []
    for k, row in enumerate(wrench.astype(float).tolist()):
        out += [Begin(f"at {k}")] * (k in begins) + [Sample(tuple(row), k * DT)]
    return out


def test_a_session_says_what_the_introspector_says():
    wrench = np.concatenate([trial(0, 50, 203), trial(1, 51, 300)])
    plain = Introspector(model())
    expected = [(type(e), e.sample) for e in plain.push(wrench[:203]) + plain.begin() + plain.push(wrench[203:])]
    events = list(Session(Introspector(model())).run(samples_of(wrench, (203,))))
    assert [(type(e), e.sample) for e in events] == expected
    a, b = ([e.probabilities for e in x if isinstance(e, Belief)] for x in (events, plain.latest.values()))
    assert a[-3:] == b
    assert SubtaskStarted(203, 202 * DT, 203, False, "at 203") in events


def beliefs(events: list[object]) -> list[tuple[object, ...]]:
    """Events in order, without the stamps, whose last digit depends on how the samples were cut."""
    return [(type(e), e.sample, getattr(e, "probabilities", getattr(e, "label", ()))) for e in events]


@pytest.mark.parametrize("begins", [(203,), (0, 60, 60, 150, 203)])
def test_a_tared_session_says_what_one_of_tared_trials_does(begins):
    """Also where a sub-task begins before the tare is complete, and in a trial that is shorter than the tare."""
    trials = [offset + trial(kind, 50 + kind, count) for kind, count, offset in ((0, 503, 2.0), (1, 110, -3.0))]
    by_hand = [wrench - wrench[:160].mean(0, dtype=np.float64).astype(np.float32) for wrench in trials]
    found = []
    for wrenches, seconds in ((trials, 160 * DT), (by_hand, 0.0), (trials, 0.0)):
        messages = [message for wrench in wrenches for message in (Reset(), *samples_of(wrench, begins))]
        session = Session(Introspector(model(), words=True), tare=seconds)
        found.append([*session.run(messages), *session.finish()])
    assert beliefs(found[0]) == beliefs(found[1])
    np.testing.assert_allclose([e.time for e in found[0]], [e.time for e in found[1]], atol=1e-9)
    assert beliefs(found[2]) != beliefs(found[0])


def test_a_gap_does_not_tare_anew():
    wrench = trial(1, 51, 400)
    readings = [*samples_of(wrench)[:200], *samples_of(wrench)[300:]]
    raw, tared = (Session(Introspector(model(), words=True), tare=seconds) for seconds in (0.0, 100 * DT))
    mean = wrench[:100].mean(0, dtype=np.float64).astype(np.float32)
    by_hand = [
        Sample(
            tuple((np.float32(one.wrench) - mean).tolist()),
            one.time,
        )
        for one in readings
    ]
    assert beliefs(list(tared.run(readings))) == beliefs(list(raw.run(by_hand)))
    assert tared.introspector.received == 100  # after the gap


def test_a_gap_during_the_tare_leaves_the_stamps_before_it():
    readings = samples_of(trial(1, 51, 100))
    late = [replace(one, time=one.time + 100.0) for one in readings[60:]]
    plain, tared = (Session(Introspector(model(), words=True), tare=seconds) for seconds in (0.0, 1.0))
    found = []
    for session in (plain, tared):
        words = [event for event in session.run([*readings[:60], *late]) if isinstance(event, Word)]
        found.append([(word.sample, word.time) for word in words if word.time < 50])
    assert found[0]
    assert np.array(found[1]) == pytest.approx(np.array(found[0]))


def test_a_stream_is_tared_as_a_store_is():
    """Models of tared stores read tared streams: the same bits."""
    wrench = (np.random.default_rng(0).normal(size=(400, 6)) + 50).astype(np.float32)
    stored = tare_of(Recordings.from_arrays(wrench[None], rate=200), 150).wrench[0]
    np.testing.assert_array_equal(np.concatenate(Tare(150).tared(wrench)), stored)


def test_a_recording_shorter_than_its_tare_is_tared_by_all_of_itself():
    recordings = Recordings.from_arrays([np.full((length, 6), 7.0) for length in (300, 100)], rate=200)
    assert not tare_of(recordings, 150).wrench.any()
    with pytest.raises(InputError, match="expected at least one"):
        tare_of(recordings, 0)


def test_the_tare_of_a_minute_is_exact():
    tare, level = Tare(60_000), np.float32(100.03)
    (rest,) = tare.tared(np.full((60_000, 2), level, np.float32))
    assert np.abs(rest).max() < 1e-5
    whole = Recordings.from_arrays(np.full((1, 60_000, 2), level, np.float32), rate=200)
    assert np.abs(tare_of(whole, 60_000).wrench).max() < 1e-5


@pytest.mark.parametrize("seconds", [-1.0, 601.0, math.nan])
def test_a_tare_out_of_range_is_refused(seconds):
    with pytest.raises(InputError, match="expected 0 to 600"):
        Session(Introspector(model()), tare=seconds)


def test_nothing_is_dropped_in_silence():
    """Whatever happens to a stream shows in its events, and the beliefs that follow are sound."""
    messages = samples_of(trial(0, 52, 400))
    messages[100:103] = [Malformed("x"), Sample((math.nan,) * 6, 101 * DT), messages[60]]
    messages.insert(100, Sample((1.0, 2.0, 3.0)))  # of another sensor
    del messages[201:301]
    messages[251:251] = [Silence(1.0), Silence(1.0)]
    session = Session(Introspector(model()))
    events = list(session.run(messages))
    kinds = [e.kind for e in events if isinstance(e, Notice)]
    assert kinds == ["malformed", "malformed", "not-finite", "late", "gap", "gap", "silent", "resumed"]
    assert session.introspector.received == 100  # everything after the long gap
    assert all(np.isfinite(e.probabilities).all() for e in events if isinstance(e, Belief))
    assert session.counts["malformed"] == 2
    known = ("sample", "malformed", "silence")
    assert sum(session.counts[kind] for kind in known) == len(messages)  # each message is counted once


def test_more_samples_than_the_encoder_counts_start_anew(monkeypatch):
    monkeypatch.setattr(session_module, "MOST_SAMPLES", 150)
    session = Session(Introspector(model()))
    events = list(session.run(samples_of(trial(0, 52, 400))))
    assert [(e.kind, e.sample) for e in events if isinstance(e, Notice)] == [("gap", 150), ("gap", 150)]
    assert session.introspector.received == 100


def test_pace():
    now, slept = [0.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    messages = [Sample(ZERO, 10 + 0.1 * k) for k in range(5)]
    assert list(paced(messages, 2.0, lambda: now[0], sleep)) == messages
    assert sum(slept) == pytest.approx(0.2)
    assert list(paced(messages, 0.0, lambda: now[0], sleep)) == messages
    assert sum(slept) == pytest.approx(0.2)


def test_pace_of_trials_and_of_clocks_that_jump():
    now = [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    def lasts(messages: list[object]) -> float:
        now[0] = 0.0
        assert list(paced(messages, 1.0, lambda: now[0], sleep)) == messages
        return now[0]

    trial_of_two = [Reset(), *(Sample(ZERO, 0.5 * k) for k in range(5))]
    assert lasts(trial_of_two * 3) == pytest.approx(6.0)
    for stamp in (3600.0, 1.7e9, 1e10, 1e300, -1e308, math.inf, math.nan):
        assert lasts([*trial_of_two, Sample(ZERO, stamp), Sample(ZERO, stamp + 1)]) < 4
    assert lasts([*trial_of_two, Sample(ZERO, 3600.0), Sample(ZERO, 3602.0)]) == pytest.approx(4.0)


class Slow:
    """A source that falls silent before its last line."""

    def __init__(self) -> None:
        self.lines = [b'{"begin": true}\n', b'{"reset": true}\n']

    def readline(self, size: int, /) -> bytes:
        if len(self.lines) == 1:
            time.sleep(0.25)
        return self.lines.pop(0) if self.lines else b""


def test_silence_of_a_live_source():
    said = list(read_live(Slow(), 0.1))
    assert [type(m) for m in said if not isinstance(m, Silence)] == [Begin, Reset]
    assert 1 <= said.count(Silence(0.1)) <= 2
    assert len(list(read_live(Slow(), LONGEST_SILENCE))) == 2
    for seconds in (0.0, math.nan, math.inf, 1e300):
        with pytest.raises(InputError, match="The silence is"):
            list(read_live(Slow(), seconds))


# --- recordings ------------------------------------------------------------------------------------------------------


def test_a_trial_without_the_arm_is_refused():
    """It was left out in silence where another of the chosen trials has the arm."""
    trials, arms = ["one", "two", "two"], ["left", "left", "right"]
    both = Recordings.from_arrays(np.zeros((3, 9, 6)), trial=trials, arm=arms)
    assert [m.trial for m in play(both, ("one", "two"), "left") if isinstance(m, Reset)] == ["one", "two"]
    assert [m.trial for m in play(both) if isinstance(m, Reset)] == ["two"]
    for chosen in (("one", "two"), ("one",)):
        with pytest.raises(InputError, match="no recording of right arm of the trial one"):
            next(play(both, chosen))


def test_store_and_folder_say_the_same(hiro_dir, hiro_recordings):
    name = "20121127-HIROSA-S-13"
    row = int(np.flatnonzero(hiro_recordings.trial == name)[0])
    from_store = list(play(hiro_recordings, (name,)))
    from_folder = list(read_folder(hiro_dir / "REAL_HIRO_ONE_SA_SUCCESS" / name))
    assert from_store.pop(0) == Reset(name)
    assert [type(m) for m in from_store] == [type(m) for m in from_folder]
    assert [m.label for m in from_store + from_folder if type(m) is Begin] == ["rotation", "insertion", "mating"] * 2
    wrench = np.array([m.wrench for m in from_folder if isinstance(m, Sample)], np.float32)
    np.testing.assert_array_equal(wrench, hiro_recordings.wrench[row, : hiro_recordings.length[row]])
    begins = [k for k, m in enumerate(from_store) if isinstance(m, Begin)]
    onsets = np.rint(hiro_recordings.starts(HARMONISED)[row, 1:] / DT).astype(int)
    assert begins == (onsets + np.arange(3)).tolist()
    assert Begin not in {type(m) for m in read_folder(hiro_dir / "REAL_HIRO_ONE_SA_SUCCESS" / name, starts="none")}
    for starts, learnt in (("harmonised", "states-merged"), ("states-merged", ""), ("recorded", ""), ("states", "")):
        folder = read_folder(hiro_dir / "REAL_HIRO_ONE_SA_SUCCESS" / name, starts=starts, learnt=learnt)
        store = list(play(hiro_recordings, (name,), starts=starts, learnt=learnt))[1:]
        assert [type(m) for m in folder] == [type(m) for m in store]
    with pytest.raises(InputError, match="no track 'phase'; there are states, states-harmonised, states-merged"):
        list(read_folder(hiro_dir / "REAL_HIRO_ONE_SA_SUCCESS" / name, starts="phase"))
    for wrong in (
        lambda: play(hiro_recordings, ("x",)), lambda: read_folder(hiro_dir), lambda: play(read_recordings(hiro_dir)),
    ):  # fmt: skip
        with pytest.raises(InputError):
            list(wrong())
