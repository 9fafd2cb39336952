"""Words of a stream without a model: those of the batch encoder, however the samples are cut, with their times."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.rules import config_of, limits_for
from rcbht_jax.encoding.stream import _held as held_by_a_stream
from rcbht_jax.errors import InputError
from rcbht_jax.events import Event, SubtaskStarted, Word
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.opening import READINGS, read_opening
from rcbht_jax.introspection.words import Revisions, WordIntrospector
from rcbht_jax.io.messages import Malformed, Message, Sample
from rcbht_jax.labels import LAYERS
from tests.support.introspection_models import CONFIG, model, trial


def batch(wrench: np.ndarray) -> set[tuple[str, str, int, int, int, int]]:
    """Layer, axis, code, span and sample of publication of all words of a recording."""
    tracks = rj.encode(wrench, rate=200)
    return {
        (layer, rj.labels.AXES[a], *(int(getattr(track, leaf)[a, k]) for leaf in ("label", "t0", "t1", "emit")))
        for layer in LAYERS
        for track in [getattr(tracks, layer)]
        for a, k in zip(*np.nonzero(track.label), strict=True)
    }


def told(events: list[Event]) -> list[tuple[str, str, int, int, int, int]]:
    return [(e.layer, e.axis, e.code, e.begin, e.end, e.sample) for e in events if isinstance(e, Word)]


WRENCH = np.concatenate([trial(2, 4, 90), trial(1, 5, 73)])


@settings(max_examples=8)
@given(st.lists(st.integers(1, 60), max_size=6))
def test_words_are_those_of_the_batch_encoder(cuts):
    stream = WordIntrospector(CONFIG, rj.preset())
    stream.push(WRENCH[:31])
    stream.reset()  # what was before is forgotten
    events: list[Event] = []
    for piece in np.split(WRENCH, np.minimum(np.cumsum(cuts, dtype=int), len(WRENCH))):
        events += stream.push(piece)
    assert stream.received == len(WRENCH)
    latest = stream.labels.copy()
    words = told(events + stream.finish())
    assert set(words) == batch(WRENCH)
    assert len(words) == len(set(words))
    for l, layer in enumerate(LAYERS):
        mine = [e for e in events if isinstance(e, Word) and (e.layer, e.axis) == (layer, "Fz")]
        assert latest[l, :, 2].tolist() == ([mine[-1].code, mine[-1].begin, mine[-1].end] if mine else [0, 0, 0])


def test_a_model_reports_the_same_words():
    introspector = Introspector(model(), words=True)
    events = introspector.push(WRENCH)
    assert set(told(events + introspector.finish())) == batch(WRENCH)
    silent = Introspector(model())
    assert [e for e in events if not isinstance(e, Word)] == silent.push(WRENCH)
    assert silent.finish() == []


def test_times_are_those_of_the_samples():
    """Stamps of the first sample and of the one after the last, on the clock of the source."""
    for stream in (WordIntrospector(CONFIG, rj.preset()), Introspector(model(), words=True)):
        events = [e for e in stream.push(WRENCH, 100 + 0.005 * (len(WRENCH) - 1)) if isinstance(e, Word)]
        events += [e for e in stream.finish() if isinstance(e, Word)]
        np.testing.assert_allclose([e.start for e in events], [100 + 0.005 * e.begin for e in events])
        np.testing.assert_allclose([e.stop for e in events], [100 + 0.005 * e.end for e in events])
        np.testing.assert_allclose([e.time for e in events], [100 + 0.005 * (e.sample - 1) for e in events])


def test_sub_tasks_and_wrong_input():
    stream = WordIntrospector(CONFIG, rj.preset("hiro", ["a", "Fz"]), ["a", "Fz"])
    assert stream.units == ("", "N")
    stream.push(np.zeros((7, 2)))
    assert stream.begin() == [SubtaskStarted(7, 7 * CONFIG.dt, 7, False)]
    with pytest.raises(InputError, match="shape"):
        stream.push(np.zeros((7, 3)))
    with pytest.raises(InputError, match="not a finite"):
        stream.push([[np.nan, 0.0]])
    assert stream.received == 7
    stream.reset()
    assert stream.received == 0
    with pytest.raises(InputError, match=r"expected \[3, 4\]"):
        WordIntrospector(CONFIG, rj.preset("hiro", ["a", "b"]), ["a", "b", "c"])
    with pytest.raises(InputError, match="2 axes are called Fz"):
        WordIntrospector(CONFIG, rj.preset("hiro", ["Fz", "Fz"]), ["Fz", "Fz"])


# --- the beginning of a stream ---------------------------------------------------------------------------------------


def readings(count: int, dt: float | None = 0.01, axes: int = 2) -> list[Message]:
    return [Sample((float(k),) * axes, None if dt is None else 5 + dt * k) for k in range(count)]


def test_an_opening_loses_nothing():
    messages: list[Message] = [Malformed("x"), Sample((np.nan, 0.0)), *readings(300)]
    opening = read_opening(iter(messages), seconds=2.0)
    assert len(opening.wrench) == 201
    assert opening.rate() == 100
    again = list(opening.messages)
    assert len(again) == len(messages)
    assert again[2:] == messages[2:]
    assert len(read_opening(iter(readings(300))).wrench) == READINGS
    assert len(read_opening(iter(readings(3)), seconds=2.0).wrench) == 3  # the stream ends before


def test_an_opening_without_stamps_or_readings():
    opening = read_opening(iter(readings(500, None)), seconds=2.0, rate=50.0)
    assert len(opening.wrench) == 100
    with pytest.raises(InputError, match="--sampling-rate"):
        opening.rate()
    with pytest.raises(InputError, match="ended and has no reading"):
        read_opening(iter([Malformed("x")]))


def test_thresholds_know_rest_and_survive_a_dead_axis():
    rng = np.random.default_rng(0)
    wrench = np.full((1000, 2), 0.3)  # a bias whose slope is rounding
    wrench[:, 0] = rng.normal(size=1000) * 0.3 + np.repeat([0.0, 50.0], 500)
    found = auto_thresholds(rj.Recordings.from_arrays([wrench], 100, axes=["a", "dead"]), 5)
    quiet, dead = np.asarray(found.limits)
    steepest = np.abs([np.polyfit(np.arange(5) * 0.01, part, 1)[0] for part in wrench[:495, 0].reshape(-1, 5)])
    assert np.quantile(steepest, 0.98) < quiet[3] < 5 * np.quantile(steepest, 0.98)
    assert quiet[0] > 200  # of the step, which is smeared over a window
    assert dead.tolist() == [70, 46, 23, 1]


@pytest.mark.parametrize("rule", ["paper", "fit"])
def test_running_words_are_told_at_their_second_window_and_when_they_change(rule: str) -> None:
    config = config_of(rule, CONFIG.window, CONFIG.dt)
    limits = limits_for(config, rj.preset(), None, WRENCH[None], np.array([len(WRENCH)]))
    stream, seen, told, latest = WordIntrospector(config, limits), Revisions(), [], {}
    shown: dict[tuple[str, str, int], list[int]] = {}
    for window in WRENCH[: len(WRENCH) // CONFIG.window * CONFIG.window].reshape(-1, CONFIG.window, 6):
        stream.push(window)
        held = stream.provisional()
        events = seen.after_window(held)
        told += events
        for word in held:
            shown.setdefault((word.layer, word.axis, word.begin), []).append(word.code)
        for event in events:
            key = event.layer, event.axis, event.begin
            # Also of words that were for a while part of the one before them.
            assert event.revision == sum(a != b for a, b in pairwise(shown[key][1:]))
            latest[key] = event.code
        # What has been told so far is what is held now, but for words in their first window.
        for word in held:
            key = word.layer, word.axis, word.begin
            assert latest.get(key, word.code) == word.code
            assert (key in latest) == (len(shown[key]) > 1)
    assert any(event.revision for event in told)


@pytest.mark.parametrize("rule", ["paper", "fit"])
def test_a_stream_that_is_warm_compiles_nothing_at_its_first_gap(rule):
    """The words that end there took seconds, in the middle of a live stream."""
    axes = [f"a{k}" for k in range(3 if rule == "paper" else 4)]  # that no other test compiles, with this window
    config, limits = config_of(rule, 4, 0.01), rj.preset("hiro", axes)
    wrench = np.zeros((1, 9, len(axes)))
    stream = WordIntrospector(
        config, limits_for(config, limits, 0.5 if rule == "fit" else None, wrench, np.array([9])), axes
    )
    stream.warm_up()
    programs = held_by_a_stream.on("cpu")._cache_size()
    stream.push(np.cumsum(np.ones((50, len(axes))), 0))
    assert [event for event in stream.finish() if isinstance(event, Word)]
    assert held_by_a_stream.on("cpu")._cache_size() == programs
    assert [event for event in stream.provisional() if isinstance(event, Word)]
    assert held_by_a_stream.on("cpu")._cache_size() == programs
