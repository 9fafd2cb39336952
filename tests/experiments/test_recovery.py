"""The experiment on recovery: where the planner approaches anew, and why a part was lost."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.online import recovery
from experiments.online.recovery import LOSSES, STEP, Planner, loss, parts_of, summed
from rcbht_jax.events import Belief, EventHub
from rcbht_jax.introspection.introspector import FAILURE_TYPE

FAULT = np.array([0.0, 0.006])


def attempt(y: float, seated: bool = False) -> dict[str, object]:
    return {"deviation, mm": [0.0, y], "seated": seated}


def story(*attempts: dict[str, object], done: bool) -> dict[str, object]:
    return {"attempts": list(attempts), "believed done": done, "seated": done and attempts[-1]["seated"]}


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (story(attempt(6.0), attempt(0.5, seated=True), done=True), ""),
        (story(attempt(1.0, seated=True), attempt(9.0), done=True), LOSSES[0]),
        (story(attempt(6.0), attempt(3.0), done=True), LOSSES[1]),
        (story(attempt(6.0), attempt(9.0), done=False), LOSSES[2]),
        (story(attempt(6.0), attempt(3.0), done=False), LOSSES[3]),
    ],
)
def test_a_lost_part_has_one_cause(told: dict[str, object], expected: str) -> None:
    assert loss(told, FAULT) == expected


def test_the_planner_moves_against_what_all_beliefs_favour() -> None:
    hub = EventHub()
    planner = Planner(hub)
    for probability, expected in ((0.9, (0.0, -STEP)), (0.3, (0.0, -2 * STEP)), (0.02, (0.0, 3 * STEP))):
        likely = (probability, 1 - probability)
        belief = Belief(200, 1.0, FAILURE_TYPE, "+y", probability, "certain", 0.0, ("+y", "-y"), likely)
        hub.publish([belief])
        planner.next_approach()
        assert planner.correction == pytest.approx(expected)


def test_faults_are_on_either_side_and_counted_once() -> None:
    parts = parts_of(0, 5, 2)
    assert [side for side, _ in parts] == ["+y", "-y", "+y", "-y", "+y", "", ""]
    sizes = [size for side, size in parts if side]
    assert recovery.FAULT[0] <= min(sizes) < max(sizes) <= recovery.FAULT[1]
    assert parts_of(1, 5, 2) != parts
    runs = [
        {**one, "lost by": loss(one, FAULT)}
        for one in (
            story(attempt(6.0), attempt(0.0, seated=True), done=True),
            story(attempt(6.0), attempt(3.0), done=True),
            story(attempt(1.0, seated=True), done=True),
        )
    ]
    found = summed(runs)
    assert (found["seated without introspection"]["count"], found["seated with introspection"]["count"]) == (1, 2)
    assert found["lost by"] == {**dict.fromkeys(LOSSES, 0), LOSSES[1]: 1}
