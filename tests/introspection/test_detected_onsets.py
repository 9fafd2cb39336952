"""Sub-tasks that nobody announces: only forwards, by all that was seen, and the same as if they had been announced."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, SubtaskStarted
from rcbht_jax.introspection.alarms import LEAST, PhaseFilter
from rcbht_jax.introspection.introspector import PHASE, Introspector
from rcbht_jax.introspection.model import IntrospectionModel
from rcbht_jax.introspection.training import HeadSpec, regular_snapshots, since_trial_start
from rcbht_jax.learning.tasks import TaskSpec
from tests.support.introspection_models import BY_PROGRESS, head, model, trial


@cache
def with_phases() -> IntrospectionModel:
    phases = head(PHASE, "trial", ("calm", "push", "shake"), "linear")
    return replace(model(), heads=(model().heads[0], phases))


def story() -> np.ndarray:
    return np.concatenate([trial(0, 70, 300), trial(1, 71, 500), trial(2, 72, 400)])


BELIEFS = st.lists(
    st.tuples(st.floats(0.02, 0.5), st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)), min_size=1, max_size=4
)


@given(BELIEFS)
def test_the_filter_sums_over_all_ways_to_go_forwards(snapshots):
    stay, memory = 0.7, 0.15
    phases, time = PhaseFilter(("a", "b", "c"), stay, memory), 0.0
    for passed, p in snapshots:
        time += passed
        phases.update(p, time)
    weight = np.zeros(3)
    for path in itertools.combinations_with_replacement(range(3), len(snapshots)):
        total = 1.0
        for before, after, (passed, p) in zip((0, *path), path, snapshots, strict=False):
            mean, steps = passed / stay, after - before
            if after == 2:  # the last stays, however many would follow
                moved = 1.0 - sum(math.exp(-mean) * mean**k / math.factorial(k) for k in range(steps))
            else:
                moved = math.exp(-mean) * mean**steps / math.factorial(steps)
            total *= moved * max(p[after], LEAST) ** min(passed / memory, 1.0)
        weight[path[-1]] += total
    np.testing.assert_allclose(phases.filtered, weight / weight.sum(), rtol=1e-6, atol=1e-12)


def test_phases_go_forwards_and_no_single_look_decides():
    phases, time, began = PhaseFilter(("a", "b", "c", "d")), 0.0, []
    for wanted in [*"aaaaa", "c", *"aaa", *"bbb", *"aaaaaaaa", *"ddddd", *"ccc"]:
        time += 0.1
        began.append(phases.update([0.85 if name == wanted else 0.05 for name in "abcd"], time))
    assert not any(began[:9])  # the look at c was an accident
    assert sum(began[9:12]) == 1
    assert not any(began[12:20])  # none comes back
    assert phases.current == 3
    assert not any(began[25:])
    phases.reset()
    assert phases.current == 0
    for stay, memory in ((0.0, 0.1), (1.0, -1.0), (np.inf, 0.1)):
        with pytest.raises(InputError, match="positive"):
            PhaseFilter(("a", "b"), stay, memory)


@pytest.mark.parametrize("cuts", [[], [7, 300, 301, 555]])
def test_noticed_is_as_good_as_told(cuts):
    signal, introspector = story(), Introspector(with_phases(), detect=True)
    events = []
    for a, b in itertools.pairwise([0, *cuts, len(signal)]):
        events += introspector.push(signal[a:b])
    starts = [e for e in events if isinstance(e, SubtaskStarted)]
    assert starts
    assert all(e.detected and e.begin == e.sample for e in starts)

    # What the beliefs of the head say, by the rule.
    phases, expected = PhaseFilter(("calm", "push", "shake")), []
    for e in events:
        if isinstance(e, Belief) and e.head == PHASE and phases.update(e.probabilities, e.time):
            expected.append(e.sample)
    assert [e.begin for e in starts] == expected

    told, same = Introspector(with_phases()), []
    for a, b in itertools.pairwise([0, *expected, len(signal)]):
        same += told.push(signal[a:b])
        if b in expected:
            told.begin()
    beliefs = [e for e in events if isinstance(e, Belief)]
    assert beliefs == [e for e in same if isinstance(e, Belief)]

    introspector.reset()
    again = introspector.push(signal)
    assert [e.begin for e in again if isinstance(e, SubtaskStarted)] == expected

    introspector.reset()
    stamped = introspector.push(signal, time=1.7e9)
    assert [e.begin for e in stamped if isinstance(e, SubtaskStarted)] == expected


def test_a_model_that_cannot():
    with pytest.raises(InputError, match="train-online --detect"):
        Introspector(model(), detect=True)
    column = replace(head(PHASE, "trial", ("test", "run", "halt"), "linear"), progress=BY_PROGRESS)
    with pytest.raises(InputError, match="train-online --detect"):  # it is about whole trials, and detects nothing
        Introspector(replace(model(), heads=(*model().heads, column)), detect=True)


def test_a_phase_is_seen_since_trial_start_of_its_trial():
    spec = HeadSpec(TaskSpec(), phase=True)
    assert (spec.name, spec.scope) == (PHASE, "trial")
    assert (HeadSpec(TaskSpec()).name, HeadSpec(TaskSpec()).scope) == ("states", "subtask")
    # A track of the user may have the name of the classifier.
    names = {HeadSpec(TaskSpec("phase"), phase=phase).name for phase in (False, True)}
    assert len(names) == 2
    from tests.introspection.test_training import sentences_of

    snapshots = regular_snapshots(sentences_of([200, 300, 100, 400]), 20)
    whole = since_trial_start(snapshots)
    assert (whole.begin == 0).all()
    assert sorted(zip(whole.recording, whole.now, whole.interval, strict=True)) == list(
        zip(whole.recording, whole.now, whole.interval, strict=True)
    )
    assert sorted(whole.now) == sorted(snapshots.now)
