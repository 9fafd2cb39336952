"""The introspector: same beliefs in any chunking and from the batch, events, levels, model files."""

from __future__ import annotations

import asyncio
import itertools
import json
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.encoding import stream as stream_module
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.events import (
    AnomalyCleared,
    AnomalyRaised,
    Belief,
    EventHub,
    FailureType,
    Notice,
    SubtaskStarted,
)
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection.alarms import Alarm, Confidence
from rcbht_jax.introspection.chain import online_features
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.labels import AXES
from rcbht_jax.learning.model_io import write_archive
from tests.support.introspection_models import BY_PROGRESS, CONFIG, VIEW, archive_of, model, trial


def story() -> np.ndarray:
    return np.concatenate([trial(0, 90, 203), trial(1, 91, 301), trial(0, 92, 100), trial(2, 93, 223)])


def told(cuts: list[int], starts: tuple[int, ...] = (203, 504), rate: float | None = 10.0) -> list[object]:
    """All events when the samples come in pieces, and the controller tells when sub-tasks begin."""
    signal, introspector = story(), Introspector(model(), rate)
    events, edges = [], sorted({0, len(signal), *cuts, *starts})
    for a, b in itertools.pairwise(edges):
        if a in starts:
            events += introspector.begin()
        events += introspector.push(signal[a:b])
    return events


@settings(max_examples=8)
@given(st.lists(st.integers(1, 826), max_size=30))
def test_chunks_do_not_matter(cuts):
    assert told(cuts) == told([])


@pytest.mark.parametrize("rate", [2.0, 10.0, 100.0, None])
def test_equals_the_batch(rate):
    signal = story()
    events = told([7, 8, 400], rate=rate)
    beliefs = [e for e in events if isinstance(e, Belief)]
    every = {2.0: 100, 10.0: 20, 100.0: 2, None: 5}[rate]
    now = np.arange(every, len(signal) + 1, every)
    starts = np.array([0, 203, 504])
    assert [head.progress is not None for head in model().heads] == [False, False, True]
    for head, begin in zip(model().heads, (starts[np.searchsorted(starts, now) - 1], 0 * now, 0 * now), strict=True):
        mine = [b for b in beliefs if b.head == head.name]
        assert [b.sample for b in mine] == now.tolist()
        x = online_features(CONFIG, preset(), VIEW, signal, begin, now)
        np.testing.assert_allclose(
            [b.probabilities for b in mine], head.probability(x, (now - begin) * CONFIG.dt), atol=1e-4
        )
        assert all(b.label == b.classes[int(np.argmax(b.probabilities))] for b in mine)


def test_the_state_has_a_fixed_size():
    introspector = Introspector(model())
    shapes = set()
    for _ in range(50):
        introspector.push(trial(1, 5, 73))
        shapes.add(str([(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(introspector._state)]))
    assert len(shapes) == 1


@pytest.mark.parametrize("name", ["failure-type", "failure_type"])
def test_failure_raises_an_anomaly_once_and_tells_its_kind(name):
    """The column of the failure types has an underscore, and so has a classifier that was trained on it."""
    *others, kind = model().heads
    introspector = Introspector(replace(model(), heads=(*others, replace(kind, name=name))), hold=0.2)
    events = introspector.push(trial(1, 81))
    raised = [e for e in events if isinstance(e, AnomalyRaised)]
    assert len(raised) == 1
    assert raised[0].probability > 0.7
    sure = [e.sample for e in events if isinstance(e, Belief) and e.head == "outcome" and e.probabilities[1] > 0.7]
    assert raised[0].sample == sure[0] + 40  # held for 0.2 s
    kinds = [e for e in events if isinstance(e, FailureType)]
    assert kinds
    assert kinds[0].sample >= raised[0].sample
    introspector.reset()
    assert introspector.received == 0
    again = introspector.push(trial(0, 82))
    assert not [e for e in again if isinstance(e, AnomalyRaised | AnomalyCleared | FailureType)]
    assert introspector.latest["states"].label == "calm"


def test_events_carry_the_stamps_of_the_source():
    introspector = Introspector(model())
    events = introspector.push(trial(0, 1, 41), time=1000.0)
    assert [e.sample for e in events if e.head == "states"] == [20, 40]
    np.testing.assert_allclose([e.time for e in events if e.head == "states"], [1000 - 21 * 0.005, 1000 - 0.005])
    [begun] = introspector.begin()
    assert begun == SubtaskStarted(41, 1000.0, 41, False)


def test_wrong_samples_are_refused_and_change_nothing():
    introspector, clean = Introspector(model()), Introspector(model())
    signal = trial(1, 3, 200)
    events, expected = introspector.push(signal[:103]), clean.push(signal[:103])
    for wrong in (
        np.zeros(6),
        np.zeros((3, 5)),
        np.full((2, 6), np.nan),
        np.full((1, 6), np.inf),
        np.full((1, 6), 3e38),
    ):
        with pytest.raises(InputError):
            introspector.push(wrong)
    assert events + introspector.push(signal[103:]) == expected + clean.push(signal[103:])


@pytest.mark.parametrize(
    "make",
    [
        lambda: Introspector(model()),
        lambda: Encoder(EncoderConfig(), preset()),
        lambda: SnapDetector(200.0, AXES, 5.0, tolerance=[0.1] * 6),
    ],
)
def test_more_samples_than_can_be_counted_are_refused(make, monkeypatch):
    """Samples are counted in 32 bits; beyond, labels and beliefs would be wrong without a word."""
    monkeypatch.setattr(stream_module, "MOST_SAMPLES", 150)
    stream, signal = make(), trial(1, 3, 200)
    stream.push(signal[:103])
    with pytest.raises(InputError, match="More than 150 samples"):
        stream.push(signal[103:151])
    stream.push(signal[103:150])
    with pytest.raises(InputError, match="start a new one"):
        stream.push(signal[150:151])
    (stream.restart if isinstance(stream, Encoder) else stream.reset)()
    stream.push(signal[:150])


@pytest.mark.parametrize(
    "options", [{"rate": 0.0}, {"rate": 1000.0}, {"rate": 3.7e1}, {"k": 1.0}, {"margin": 0.3}, {"hold": -1.0}]
)
def test_options_that_make_no_sense(options):
    with pytest.raises(InputError):
        Introspector(model(), **options)


def test_levels_have_hysteresis():
    confidence = Confidence(0.7, 0.05)
    said = [confidence.update("a", p, float(t)) for t, p in enumerate([0.4, 0.6, 0.71, 0.66, 0.64, 0.69, 0.8])]
    assert [level for level, _ in said] == [
        "inadmissible", "uncertain", "certain", "certain", "uncertain", "uncertain", "certain",
    ]  # fmt: skip
    assert [since for _, since in said] == [0, 0, 0, 1, 0, 0, 0]
    assert confidence.update("b", 0.69, 8.0) == ("uncertain", 0.0)  # another label starts anew


def test_alarms_need_to_last():
    alarm = Alarm(0.7, 0.2)
    said = [alarm.update(p, 0.1 * t) for t, p in enumerate([0.8, 0.8, 0.6, 0.8, 0.8, 0.8, 0.6, 0.4, 0.4, 0.4, 0.4])]
    assert said == [None, None, None, None, None, True, None, None, None, False, None]
    assert Alarm(0.7, 0.0).update(0.8, 5.0) is True
    low = Alarm(0.3, 0.0)  # one that is raised early is not cleared by what raised it
    assert [low.update(p, float(t)) for t, p in enumerate([0.2, 0.35, 0.35, 0.25])] == [None, True, None, False]


def test_a_head_may_have_an_alarm_level_of_its_own(tmp_path):
    signal = trial(1, 81)
    heads = tuple(replace(head, alarm_level=0.999 if head.alarm else 0.0) for head in model().heads)
    strict = replace(model(), heads=heads)
    model_files.save(tmp_path / "m", strict)
    events = Introspector(model_files.load(tmp_path / "m"), k=0.6).push(signal)
    seen = [e.probabilities[1] for e in events if isinstance(e, Belief) and e.head == "outcome"]
    raised = any(isinstance(e, AnomalyRaised) for e in events)
    assert raised == (max(min(pair) for pair in itertools.pairwise(seen)) > 0.999)
    assert any(isinstance(e, AnomalyRaised) for e in Introspector(model(), k=0.6).push(signal))
    with pytest.raises(InputError, match="alarm level"):
        replace(heads[1], alarm_level=1.5)


def test_an_alarm_is_held_for_the_time_of_its_level(tmp_path):
    signal = trial(1, 81)
    heads = tuple(replace(head, alarm_hold=0.3 if head.alarm else 0.1) for head in model().heads)
    model_files.save(tmp_path / "m", replace(model(), heads=heads))
    back = model_files.load(tmp_path / "m")
    held, asked = Introspector(back).push(signal), Introspector(model(), hold=0.3).push(signal)
    assert held == asked
    assert held != Introspector(model()).push(signal)
    assert Introspector(back, hold=0.1).push(signal) == Introspector(model()).push(signal)
    for wrong in (-0.1, float("inf")):
        with pytest.raises(InputError, match="holds its alarm for"):
            replace(heads[1], alarm_hold=wrong)


def test_model_file_keeps_everything(tmp_path):
    path = tmp_path / "m"
    digests = np.arange(64, dtype=np.uint8).reshape(2, 32)
    model_files.save(path, replace(model(), digests=digests))
    back = model_files.load(path)
    signal = story()
    np.testing.assert_array_equal(back.digests, digests)
    assert Introspector(back).push(signal) == Introspector(model()).push(signal)
    assert (back.extra, back.data_hash, back.encoder) == (model().extra, "abc", CONFIG)
    assert [h.alarm for h in back.heads] == ["", "failure", ""]
    assert [h.progress for h in back.heads] == [None, None, BY_PROGRESS]


def test_files_of_0_1_are_read(tmp_path):
    path = tmp_path / "m"
    model_files.save(path, model())
    members, meta = archive_of(path)
    added = ("view", "alarm_level", "alarm_hold", "progress")  # since then
    heads = [{k: v for k, v in head.items() if k not in added} | {"sight": head["view"]} for head in meta["heads"]]
    del members["digests"]
    write_archive(path, meta | {"heads": heads}, members)
    back = model_files.load(path)
    assert back.digests.shape == (0, 32)
    assert [head.view for head in back.heads] == [head.view for head in model().heads]
    assert [head.progress for head in back.heads] == [None] * 3
    assert [head.alarm_hold for head in back.heads] == [0.1] * 3


def test_model_files_that_do_not_fit(tmp_path):
    path = tmp_path / "m"
    model_files.save(path, model())
    members, meta = archive_of(path)
    for wrong in ({"0.sigmoid": np.zeros((2, 2))}, {"limits": np.zeros((6, 4))}, {"1.dual": np.zeros((3, 3))}):
        write_archive(path, meta, members | wrong)
        with pytest.raises(InputError):
            model_files.load(path)
    heads, encoder = [{"heads": []}, {"heads": 3}], [{"encoder": {"window": 0}}, {"encoder": {"a": 1}}]
    for wrong in ({"format": "x"}, *heads, *encoder, {"extra": {"units": 0}}, {"extra": {"units": None}}):
        write_archive(path, meta | wrong, members)
        with pytest.raises(InputError):
            model_files.load(path)
    for wrong in ({"prior": [1.0]}, {"share": [2.0] * 4}, {"temperature": None}, {"planned": 0}, {"planned": "9.0"}):
        last = meta["heads"][2] | {"progress": meta["heads"][2]["progress"] | wrong}
        write_archive(path, meta | {"heads": [*meta["heads"][:2], last]}, members)
        with pytest.raises(InputError):
            model_files.load(path)
    write_archive(path, meta | {"heads": [head | {"alarm_level": "0.5"} for head in meta["heads"]]}, members)
    with pytest.raises(InputError, match=r"alarm_level is '0\.5', no finite number"):
        model_files.load(path)
    path.write_bytes(b"PK\3\4 nothing")
    with pytest.raises(InputError, match="not a readable model"):
        model_files.load(path)
    with pytest.raises(InputError, match="has no class"):
        replace(model().heads[0], alarm="fire")
    with pytest.raises(InputError, match="has the heads none; expected one or more"):
        replace(model(), heads=())


def test_events_are_json():
    for event in told([]):
        back = json.loads(json.dumps(event.to_json(), allow_nan=False))
        assert back["event"] == type(event).__name__


def test_callbacks_and_iterators():
    hub = EventHub(backlog=3)
    seen: list[object] = []
    end = hub.subscribe(seen.append, AnomalyRaised, Notice)
    everything: list[object] = []
    hub.subscribe(everything.append)
    raised, notice = AnomalyRaised(1, 0.1, "outcome", 0.9), Notice(2, 0.2, "gap", "a gap")
    begun = SubtaskStarted(3, 0.3, 3, False)

    async def read() -> list[object]:
        iterator = hub.events(AnomalyRaised, SubtaskStarted)
        hub.publish([raised, notice, begun])
        hub.close()
        return [event async for event in iterator]

    assert asyncio.run(read()) == [raised, begun]
    assert seen == [raised, notice]
    end()
    hub.publish([raised])
    assert seen == [raised, notice]
    assert len(everything) == 4


@pytest.mark.parametrize("unread", [0, 2, 3])
def test_a_hub_that_is_closed_ends_every_iterator_after_what_is_unread(unread: int) -> None:
    """A full backlog lost its oldest event to the end, the end was lost to later events, and new iterators waited."""
    hub, notices = EventHub(backlog=3), [Notice(n, 0.0, "gap", str(n)) for n in range(9)]

    async def read() -> list[list[object]]:
        before = hub.events()
        hub.publish(notices[:unread])
        hub.close()
        hub.close()
        hub.publish(notices)
        return [[event async for event in iterator] for iterator in (before, hub.events())]

    assert asyncio.run(asyncio.wait_for(read(), 10)) == [notices[:unread], []]
    assert hub.dropped == 0


def test_a_sleeping_reader_loses_the_oldest():
    hub = EventHub(backlog=3)
    notices = [Notice(n, 0.0, "gap", str(n)) for n in range(10)]

    async def read() -> list[object]:
        iterator = hub.events()
        hub.publish(notices)
        got = [await anext(iterator) for _ in range(3)]
        await iterator.aclose()
        hub.publish(notices)
        return got

    assert asyncio.run(read()) == notices[-3:]
    assert hub.dropped == 7
