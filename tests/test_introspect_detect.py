"""Sub-tasks that nobody announces: only forwards, only when certain, and the same as if they had been announced."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from introspect_models import head, model, trial

from rcbht_jax.errors import InputError
from rcbht_jax.introspect.events import Belief, SubtaskStarted
from rcbht_jax.introspect.introspector import PHASE, Introspector
from rcbht_jax.introspect.levels import Phases
from rcbht_jax.introspect.model import IntrospectionModel
from rcbht_jax.introspect.train import HeadSpec, from_the_beginning, streamed
from rcbht_jax.tasks import TaskSpec

HOLD = 0.2


@cache
def with_phases() -> IntrospectionModel:
    phases = head(PHASE, "trial", ("calm", "push", "shake"), "linear")
    return replace(model(), heads=(model().heads[0], phases))


def story() -> np.ndarray:
    return np.concatenate([trial(0, 70, 300), trial(1, 71, 500), trial(2, 72, 400)])


def test_phases_go_forwards_when_certain_long_enough():
    phases = Phases(("a", "b", "c", "d"), 0.2)
    told = [
        ("a", 9.0, True), ("b", 0.1, True), ("b", 0.5, False), ("b", 0.2, True), ("b", 0.3, True), ("a", 9.0, True),
        ("d", 0.2, True), ("c", 9.0, True),
    ]  # fmt: skip
    assert [phases.update(*one) for one in told] == [False, False, False, True, False, False, True, False]
    assert phases.current == 3
    phases.reset()
    assert phases.update("b", 0.2, True)
    with pytest.raises(InputError, match="held"):
        Phases(("a", "b"), -1.0)


@pytest.mark.parametrize("cuts", [[], [7, 300, 301, 555]])
def test_noticed_is_as_good_as_told(cuts):
    signal, introspector = story(), Introspector(with_phases(), hold=HOLD, detect=True)
    events = []
    for a, b in itertools.pairwise([0, *cuts, len(signal)]):
        events += introspector.push(signal[a:b])
    starts = [e for e in events if isinstance(e, SubtaskStarted)]
    assert starts
    assert all(e.detected and e.begin == e.sample for e in starts)

    # What the beliefs of the head say, by the rule.
    phases, expected = Phases(("calm", "push", "shake"), HOLD), []
    for e in events:
        if isinstance(e, Belief) and e.head == PHASE and phases.update(e.label, e.certain_for, e.level == "certain"):
            expected.append(e.sample)
    assert [e.begin for e in starts] == expected

    told, same = Introspector(with_phases(), hold=HOLD), []
    for a, b in itertools.pairwise([0, *expected, len(signal)]):
        same += told.push(signal[a:b])
        if b in expected:
            told.begin()
    beliefs = [e for e in events if isinstance(e, Belief)]
    assert beliefs == [e for e in same if isinstance(e, Belief)]

    introspector.reset()
    again = introspector.push(signal)
    assert [e.begin for e in again if isinstance(e, SubtaskStarted)] == expected


def test_a_model_that_cannot():
    with pytest.raises(InputError, match="train-online --detect"):
        Introspector(model(), detect=True)


def test_a_phase_is_seen_from_the_beginning_of_its_trial():
    spec = HeadSpec(TaskSpec(), phase=True)
    assert (spec.name, spec.scope) == (PHASE, "trial")
    assert (HeadSpec(TaskSpec()).name, HeadSpec(TaskSpec()).scope) == ("states", "subtask")
    from test_introspect_train import sentences_of

    looks = streamed(sentences_of([200, 300, 100, 400]), 20)
    whole = from_the_beginning(looks)
    assert (whole.begin == 0).all()
    assert sorted(zip(whole.recording, whole.now, whole.sentence, strict=True)) == list(
        zip(whole.recording, whole.now, whole.sentence, strict=True)
    )
    assert sorted(whole.now) == sorted(looks.now)
