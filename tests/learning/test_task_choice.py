"""Which task is meant where none is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.learning.task_choice import chosen_task, task_names
from rcbht_jax.types import Recordings


@pytest.mark.parametrize(
    ("tracks", "columns", "chosen"),
    [
        (("phase",), {"tool": ["a"]}, "phase"),
        (("phase", "phase-harmonised", "phase-merged"), {}, "phase"),
        (("phase", "states"), {}, "states"),
        (("phase", "op"), {"states": ["a"]}, "states"),
        ((), {}, "outcome"),
        ((), {"weight": [1.0]}, "outcome"),  # numbers are no classes
    ],
)
def test_the_task_that_is_plainly_meant_is_taken(
    tracks: tuple[str, ...], columns: dict[str, list[str] | list[float]], chosen: str
) -> None:
    rows = [(0, track, "push", 0.0, 1.0) for track in tracks]
    recordings = Recordings.from_arrays(np.zeros((1, 400, 6)), annotations=rows, **columns)
    assert chosen_task("", recordings) == chosen
    assert chosen_task("anything", recordings) == "anything"


def test_a_track_of_one_label_is_not_meant_where_another_has_several() -> None:
    """A simulated clip has phases, and a track that says when its only tab is beneath its lip."""
    rows = [(0, "phase", "push", 0.0, 1.0), (0, "phase", "rest", 1.0, 2.0), (0, "passing", "LATCH", 0.9, 2.0)]
    assert chosen_task("", Recordings.from_arrays(np.zeros((1, 400, 6)), annotations=rows)) == "phase"


@pytest.mark.parametrize(
    ("tracks", "columns", "names"),
    [(("phase", "op"), {}, "phase, op, outcome"), ((), {"tool": ["a"]}, "outcome, tool")],
)
def test_several_tasks_are_named_with_the_option_to_choose_one(
    tracks: tuple[str, ...], columns: dict[str, list[str]], names: str
) -> None:
    rows = [(0, track, "push", 0.0, 1.0) for track in tracks]
    recordings = Recordings.from_arrays(np.zeros((1, 400, 6)), annotations=rows, **columns)
    with pytest.raises(InputError, match=rf"^No task is named, .*; choose one of {names} with --task\.$"):
        chosen_task("", recordings)


@pytest.mark.parametrize(
    ("values", "is_task"),
    [
        (["0.1", "0.2", "0.3", "0.4", "", "0.1"], True),  # 4 of 5 trials
        (["0.1", "0.2", "0.3", "0.4", "0.5", ""], False),
        (["3", "3", "4", "4", "5", "5"], True),
        (["a", "b", "c", "d", "e", "f"], True),
        ([""] * 6, True),
    ],
)
def test_measured_values_stored_as_text_are_no_task(values: list[str], is_task: bool) -> None:
    """The seconds after which an anomaly began were offered as a task."""
    recordings = Recordings.from_arrays(np.zeros((6, 40, 6)), value=values)
    assert ("value" in task_names(recordings)) == is_task
    both = Recordings.join([replace(recordings, arm=np.full(6, arm)) for arm in "LR"])
    assert ("value" in task_names(both)) == is_task
