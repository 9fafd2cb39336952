"""A nominal monitor in a stream: the events of its scores and alarms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.events import AnomalyCleared, AnomalyRaised, AnomalyScore
from rcbht_jax.introspection.alarms import conformal_p, conformal_threshold, trials_needed
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.nominal_file import MonitorFile
from rcbht_jax.introspection.nominal_watch import NominalWatch
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Reset, Sample

RNG = np.random.default_rng(0)
MONITOR = NominalMonitor(rate=20, score_rate=10, memory=0.5).fit(0.1 * RNG.normal(size=(30, 80, 2)))
FAULT = 0.1 * RNG.normal(size=(80, 2)) + np.array([3.0, 2.0]) * ((np.arange(80) >= 30) & (np.arange(80) < 40))[:, None]


def watch() -> NominalWatch:
    return NominalWatch(MonitorFile(MONITOR, ("Fz", "grip"), ()), 0.1)


def test_events_do_not_depend_on_pieces_and_agree_with_the_monitor() -> None:
    whole = watch().push(FAULT, 13.95)
    for pieces in (3, 7, 80):
        reader, parts = watch(), np.array_split(np.arange(80), pieces)
        assert [event for part in parts for event in reader.push(FAULT[part], 10 + 0.05 * part[-1])] == whole
    scores = [event for event in whole if isinstance(event, AnomalyScore)]
    assert [event.sample for event in scores] == list(range(2, 81, 2))
    assert [event.score for event in scores] == MONITOR.scores(FAULT)[1::2].tolist()
    (raised,) = [event for event in whole if isinstance(event, AnomalyRaised)]
    assert raised.sample * 0.05 == pytest.approx(MONITOR.detect(FAULT, 0.1))
    assert raised.time == pytest.approx(10 + (raised.sample - 1) * 0.05)
    (p_value,) = [score.p_value for score in scores if score.sample == raised.sample]
    assert raised.probability == 1 - p_value


def test_an_alarm_stands_until_no_score_has_exceeded_the_threshold_for_the_memory() -> None:
    events = watch().push(FAULT)
    scores = {event.sample: event for event in events if isinstance(event, AnomalyScore)}
    (raised,) = [event.sample for event in events if isinstance(event, AnomalyRaised)]
    (cleared,) = [event.sample for event in events if isinstance(event, AnomalyCleared)]
    latest = max(sample for sample, event in scores.items() if event.score > event.threshold)
    assert cleared == latest + 10  # 0.5 s
    assert raised == min(sample for sample, event in scores.items() if event.p_value <= 0.1)


@given(st.lists(st.integers(0, 9), min_size=4, max_size=40), st.integers(0, 10), st.floats(0.01, 0.9))
def test_the_p_value_is_small_just_where_the_threshold_is_exceeded(peaks, score, share):
    values = np.array(peaks, float)
    if len(peaks) >= trials_needed(share):
        assert (conformal_p(values, score) <= share + 1e-9) == (score > conformal_threshold(values, share))


def session_of(reader: NominalWatch) -> Session:
    words = WordIntrospector(EncoderConfig(dt=0.05), preset("hiro", ["Fz", "grip"]), ["Fz", "grip"])
    return Session(Together(Together(words, readers=[reader]), readers=[]))


@pytest.mark.parametrize(("jump", "silent"), [(1.0, True), (-100.0, False)])
def test_a_watch_is_silent_after_a_gap_until_the_next_trial(jump: float, silent: bool) -> None:
    """It took what followed for the beginning of the skill, and raised its alarm twice without clearing it."""
    readings = [Sample(tuple(row), 200 + 0.05 * k) for k, row in enumerate(FAULT.tolist())]
    rest = [Sample(one.wrench, one.time + jump) for one in readings[36:] if one.time is not None]
    events = list(session_of(watch()).run([*readings[:36], *rest, Reset(), *readings]))
    kinds = [type(event) for event in events if isinstance(event, AnomalyRaised | AnomalyCleared)]
    scores = [event.time for event in events if isinstance(event, AnomalyScore)]
    assert kinds[:2] == [AnomalyRaised, AnomalyCleared]
    assert kinds[-2:] == [AnomalyRaised, AnomalyCleared]
    cleared = next(event for event in events if isinstance(event, AnomalyCleared))
    assert (cleared.sample, cleared.time) == (36, readings[35].time)
    assert 0 < cleared.probability < 1
    assert len(scores) == 18 + (0 if silent else len(rest) // 2) + 40


@pytest.mark.parametrize(("which", "stamp", "scores"), [(0, 0.0, 19), (30, 0.0, 15), (30, 1e9, 15)])
def test_a_single_stray_stamp_is_no_beginning(which: int, stamp: float, scores: int) -> None:
    """At the beginning it leaves a trial of one sample less; later, a gap."""
    readings = [Sample(tuple(row), 200 + 0.05 * k) for k, row in enumerate(FAULT[:40].tolist())]
    readings[which] = Sample(readings[which].wrench, stamp)
    events = session_of(watch()).run(readings)
    assert sum(isinstance(event, AnomalyScore) for event in events) == scores


def test_a_stream_needs_its_axes_and_its_rate() -> None:
    assert watch().columns(("grip", "Fx", "Fz"), 0.05) == [2, 0]
    with pytest.raises(InputError, match=r"^The monitor needs the axes Fz, grip; the stream has Fz\.$"):
        watch().columns(("Fz",), 0.05)
    with pytest.raises(InputError, match=r"^The monitor needs samples at 20 Hz; the stream has 100 Hz\.$"):
        watch().columns(("Fz", "grip"), 0.01)


def test_a_stream_in_another_unit_is_refused() -> None:
    """The command refused it; the ROS 2 node, and Python, compared newtons with millinewtons without a word."""
    words = WordIntrospector(EncoderConfig(dt=0.05), preset("hiro", ["grip", "Fz"]), ["grip", "Fz"], ["", "N"])
    learned = MonitorFile(MONITOR, ("Fz", "grip"), (), ("mN", "mm"))
    with pytest.raises(InputError, match=r"^The stream has Fz in N; the model learned it in mN\.$"):
        Together(words, readers=[NominalWatch(learned, 0.1)])
    unstated = Together(words, readers=[NominalWatch(MonitorFile(MONITOR, ("Fz", "grip"), (), ("N", "mm")), 0.1)])
    assert any(isinstance(event, AnomalyScore) for event in unstated.push(FAULT[:, ::-1]))
