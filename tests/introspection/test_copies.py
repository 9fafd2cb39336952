"""Copies of streams: they go on from where they are, and neither they nor the originals notice each other."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.events import Event
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
from rcbht_jax.introspection.words import Revisions, WordIntrospector
from rcbht_jax.io.messages import Sample
from tests.support.introspection_models import CONFIG, model, trial

NAMES = ["Fz"]
FORCE = np.interp(np.arange(403) / 200, [0, 0.5, 1.2, 1.23, 2], [0, 0, 9, 2, 2])[:, None]
FORCE += 0.02 * np.random.default_rng(0).normal(size=FORCE.shape)


def words(rule: str = "paper") -> WordIntrospector:
    if rule == "paper":
        return WordIntrospector(rj.EncoderConfig(), rj.preset("hiro", NAMES), NAMES)
    return WordIntrospector(FitConfig(), FitLimits(rj.preset("hiro", NAMES).limits, np.array([0.1])), NAMES)


def watch() -> NominalWatch:
    monitor = NominalMonitor(rate=200).fit(FORCE + 0.02 * np.random.default_rng(1).normal(size=(20, 403, 1)))
    return NominalWatch(MonitorFile(monitor, ("Fz",), ()))


def segmenter() -> SegmenterStream:
    recordings = rj.Recordings.from_arrays([FORCE] * 3, rate=200, axes=NAMES, units=["N"])
    fitted = WrenchSegmenter(trees=3).fit(recordings, [np.arange(403) // 202] * 3)
    return SegmenterStream(SegmenterFile.of(fitted, "phase", ("free", "contact")))


def pushed(stream: Any, samples: np.ndarray) -> list[Any]:
    found: list[Any] = stream.push(samples)
    if isinstance(stream, rj.Encoder):
        found += [stream.peek()]
    if isinstance(stream, WordIntrospector | Introspector):
        found += [*stream.provisional(), stream.labels.tolist()]
    return found


STREAMS: dict[str, Callable[[], Any]] = {
    "encoder": lambda: rj.Encoder(rj.EncoderConfig(), rj.preset("hiro", NAMES)),
    "words": words,
    "words of the fit rule": lambda: words("fit"),
    "snaps": lambda: SnapDetector(200.0, NAMES, least=3.0),
    "monitor": watch,
    "segmenter": segmenter,
    "together": lambda: Together(words(), readers=[SnapDetector(200.0, NAMES, least=3.0), watch()]),
}


@pytest.mark.parametrize("kind", STREAMS)
def test_a_copy_and_its_original_go_on_apart(kind: str) -> None:
    stream = STREAMS[kind]()
    alone = copy.deepcopy(stream)
    pushed(stream, FORCE[:203]), pushed(alone, FORCE[:203])  # 203: in the middle of a window
    other = copy.copy(stream)
    pushed(other, -FORCE[:101])
    other.restart() if kind == "encoder" else other.reset()
    pushed(other, FORCE[:2])
    kept = copy.copy(stream)
    expected = pushed(alone, FORCE[203:])
    assert expected
    assert pushed(stream, FORCE[203:]) == expected
    assert pushed(kept, FORCE[203:]) == expected


def test_copies_of_beliefs_go_on_apart_and_share_the_model() -> None:
    signal = np.concatenate([trial(0, 90, 203), trial(1, 91, 200)])
    stream, alone = Introspector(model(), 10.0), Introspector(model(), 10.0)
    for one in (stream, alone):
        one.begin()
        one.push(signal[:203])
    other = copy.copy(stream)
    assert other.model is stream.model
    other.begin()
    other.push(-3 * signal[:99])
    assert pushed(stream, signal[203:]) == pushed(alone, signal[203:])
    assert stream.latest == alone.latest
    assert stream.received == 403
    assert other.config == CONFIG


@pytest.mark.parametrize("tare", [0.0, 1.5])
def test_a_session_is_copied_with_all_that_it_feeds(tare: float) -> None:
    def fed(session: Session, first: int, last: int) -> list[Event]:
        return list(session.run(Sample(tuple(FORCE[k].tolist()), k / 200) for k in range(first, last)))

    session, alone = Session(words(), tare=tare), Session(words(), tare=tare)
    fed(session, 0, 203), fed(alone, 0, 203)
    fed(copy.copy(session), 203, 290)
    assert fed(session, 203, 403) + session.finish() == fed(alone, 203, 403) + alone.finish()
    assert session.counts == alone.counts


def test_revisions_are_copied() -> None:
    stream, seen = words(), Revisions()
    stream.push(FORCE[:200])
    seen.after_window(stream.provisional())
    copy.copy(seen).after_window(stream.provisional())
    assert seen.after_window(stream.provisional())  # reported at the second window
