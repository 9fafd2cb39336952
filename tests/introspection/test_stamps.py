"""Time stamps of events: like all else that is said, they do not depend on how the samples were cut."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from tests.support.introspection_models import FIT, FIT_LIMITS, model, trial

WRENCH = np.concatenate([trial(2, 4, 200), trial(1, 5, 150)])
WRENCH[80:200, 2] += 8
STREAM = Together(
    Together(Introspector(model()), WordIntrospector(FIT, FIT_LIMITS)),
    snaps=SnapDetector(200.0, ["Fz", "My"], least=3.0),
)


def said(cuts: list[int], start: float | None) -> list[dict[str, object]]:
    STREAM.reset()
    events, end = [], 0
    for piece in np.split(WRENCH, sorted(cuts)):
        end += len(piece)
        events += STREAM.push(piece, None if start is None else round(start + (end - 1) * 0.005, 6))
    return [event.to_json() for event in events + STREAM.finish()]


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 350), max_size=40), st.sampled_from([None, 0.0, 12.3, 1.7e9 + 0.125]))
def test_events_are_the_same_however_the_samples_are_cut(cuts, start):
    """Every word, belief and snap, with its stamps, in order; the last digits of stamps were others."""
    events = said(cuts, start)
    assert {event["event"] for event in events} == {"Word", "Belief", "Snap"}
    assert events == said([], start)
    assert not any(repr(value) == "-0.0" for event in events for value in event.values())
