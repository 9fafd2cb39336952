"""Intervals of tracks at the ends of the record."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings


def test_an_interval_that_begins_before_the_record_is_cut_at_its_first_sample() -> None:
    rows = [(0, "phase", "reach", -0.1, 1.0), (0, "phase", "push", 1.0, 9.0), (1, "phase", "reach", -0.5, -0.1)]
    rows += [(1, "phase", "push", 0.5, 2.0)]
    data = Recordings.from_arrays(np.zeros((2, 400, 6)), 200, annotations=Annotations.from_rows(rows))
    items = labelled_intervals(data, TaskSpec("phase"))
    (only,) = items.intervals
    assert [items.classes[k] for k in items.y] == ["reach", "push", "push"]
    assert (only.start.tolist(), only.end.tolist()) == ([0, 200, 100], [200, 400, 400])
    assert items.dropped == {"intervals, empty, outside the record or without a known end": 1}


def _two_sources(outcome: list[str], tracks: list[str]) -> Recordings:
    """Four recordings, two of each source, with the phases of a track each."""
    rows = [(row, track, *part) for row, track in enumerate(tracks) for part in (("reach", 0, 1), ("push", 1, 2))]
    return Recordings.from_arrays(
        np.zeros((4, 400, 6)), 200, annotations=Annotations.from_rows(rows), outcome=outcome,
        source=["own", "own", "simulated", "simulated"], trial=["a", "b", "a", "b"],
    )  # fmt: skip


def test_recordings_that_nobody_judged_are_no_failures() -> None:
    """Beside successes they are left out; that a whole source is, is said."""
    data = _two_sources(["unknown", "unknown", "success", "failure"], ["phase"] * 4)
    left = labelled_intervals(data, TaskSpec("phase")).dropped
    assert left == {"outcome not success": 1, "outcome unknown": 2, "all of the source own": 2}
    assert labelled_intervals(data, TaskSpec("phase", outcomes=())).dropped == {}
    assert "all of the source own" not in labelled_intervals(data, TaskSpec("phase", sources=("simulated",))).dropped


def test_a_source_that_nobody_judged_teaches_nothing_and_the_error_says_why() -> None:
    data = _two_sources(["unknown", "unknown", "success", "failure"], ["phase"] * 4)
    with pytest.raises(InputError, match=r"no known class in 0 chosen trials.* Left out: 2 trials \(outcome unknown"):
        labelled_intervals(data, TaskSpec("phase", sources=("own",)))


def test_a_source_without_the_track_is_named() -> None:
    data = _two_sources(["success"] * 4, ["phase", "phase", "states", "states"])
    left = labelled_intervals(data, TaskSpec("states")).dropped
    assert left == {"no annotation of the track states": 2, "all of the source own": 2}


def test_a_source_of_failures_alone_is_left_out_as_asked() -> None:
    data = _two_sources(["failure", "failure", "success", "success"], ["phase"] * 4)
    assert labelled_intervals(data, TaskSpec("phase")).dropped == {"outcome not success": 2}


def test_a_column_of_numbers_is_no_task_and_the_error_says_what_is() -> None:
    graded = Recordings.from_arrays(np.zeros((2, 400, 6)), grade=[0, 1])
    with pytest.raises(InputError, match=r"no track or column of text 'grade'; choose one of outcome"):
        labelled_intervals(graded, TaskSpec("grade"))


def test_trials_that_are_left_out_do_not_have_the_only_class() -> None:
    recordings = Recordings.from_arrays(np.zeros((4, 400, 6)), outcome=["success", "unknown", "unknown", "unknown"])
    with pytest.raises(InputError, match=r"the class success alone in 1 trial\. Left out: 3 trials"):
        labelled_intervals(recordings, TaskSpec("outcome"))
