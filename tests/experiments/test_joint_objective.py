"""Joint fits: whose parameter is whose, and what the loss notices."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from experiments._lib import joint_objective as joint
from experiments._lib.joint_objective import IMPOSSIBLE, JointObjective, Share, physical, quickest_fall
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import HOOKED
from sim_mjx.validation import sessions, snaps

SESSION_B = HOOKED["hooked-B"]


def share(**changes: Any) -> Share:
    target: Any = SimpleNamespace(session=SESSION_B, snaps={"trials": 2, "trials_with_a_snap_as_recorded": 2})
    return replace_all(Share(target, ((0, 0), (0, -2)), 2), changes)


def replace_all(value: Share, changes: dict[str, Any]) -> Share:
    return value._replace(**changes)


def rollouts(wrench: np.ndarray, seated: np.ndarray) -> Rollouts:
    count, time, _ = wrench.shape
    onset = np.tile([0.0, 0.1, 0.2, 0.3], (count, 1))
    length = np.full(count, time, np.int32)
    past = np.zeros((count, time, 4), np.bool_)
    joints, diverged = np.zeros((count, time, 6), np.float32), np.zeros(count, np.bool_)
    return Rollouts(wrench, joints, length, onset, seated, diverged, past)


def test_own_parameters_belong_to_their_session_only() -> None:
    values = {"parts.friction": 0.3, "hooked-A:parts.roll": 0.01, "hooked-B:parts.roll": 0.02}
    assert physical(values, "hooked-A") == (("parts.friction", 0.3), ("parts.roll", 0.01))
    assert physical(values, "hooked-C") == (("parts.friction", 0.3),)
    ranges = {"parts.hook_overlap[2:4]": 8e-4, "hooked-B:parts.lip_impedance[0:2]": 0.98}  # their colons are no owner's
    assert physical(ranges, "hooked-A") == (("parts.hook_overlap[2:4]", 8e-4),)
    assert physical(ranges, "hooked-B") == (("parts.hook_overlap[2:4]", 8e-4), ("parts.lip_impedance[0:2]", 0.98))


def test_outcomes_are_those_of_the_placements() -> None:
    wrench = np.zeros((2, 10, 6), np.float32)
    right = np.array([[True] * 4, [True, False, True, True]])
    assert joint.outcome_loss(share(), rollouts(wrench, right)) == 0.0
    assert joint.outcome_loss(share(), rollouts(wrench, ~right)) == 0.5  # none of four; not all is as recorded
    assert joint.outcome_loss(share(), rollouts(wrench, np.ones((2, 4), np.bool_))) == 0.5


def test_quickest_fall_is_the_largest_difference_within_a_snap() -> None:
    rng = np.random.default_rng(0)
    force = rng.normal(size=(3, 80))
    begin, end = np.array([0.05, 0.0, np.nan]), np.array([0.4, 0.3, 0.4])
    found = quickest_fall(force, begin, end)
    for row in range(2):
        pairs = [
            force[row, i] - force[row, i + snaps.FALL]
            for i in range(80 - snaps.FALL)
            if begin[row] <= i * CONTROL_PERIOD < end[row] - (snaps.FALL + 1) * CONTROL_PERIOD
        ]
        assert found[row] == pytest.approx(max([0.0, *pairs]))
    assert found[2] == 0.0


def test_a_tab_that_gives_way_counts_and_ringing_does_not() -> None:
    time = np.arange(1000) * CONTROL_PERIOD
    force = {
        "level": np.full_like(time, 18.0),
        "snap": np.where(time < 2.5, 18.0, 8.0 + 10.0 * np.clip((time - 2.6) / 1.0, 0.0, 1.0)),
        "ringing": 18.0 + 12.0 * np.sin(2 * np.pi * 3.0 * time),
    }
    seated = np.ones((2, 4), np.bool_)
    missing = {}
    for name, values in force.items():
        wrench = np.zeros((2, len(time), 6), np.float32)
        wrench[..., 2] = values
        missing[name] = joint._missing_snaps(share(), rollouts(wrench, seated))
    assert missing["level"] > 0.95
    assert missing["ringing"] > 0.9
    assert missing["snap"] < 0.1


def test_the_wait_for_the_last_tab_is_compared_with_the_recorded_one() -> None:
    samples, mating = 4000, 0.3
    run = rollouts(np.zeros((2, samples, 6), np.float32), np.ones((2, 4), np.bool_))
    wrong = {}
    for wait in (-0.2, joint.WAIT / 4, joint.WAIT):
        run.past[...] = False
        run.past[:, round((mating + wait) / CONTROL_PERIOD) :] = True
        wrong[wait] = joint._wrong_wait(share(), run)
    run.past[...] = False  # none passes
    assert wrong[joint.WAIT] < 0.01 < wrong[joint.WAIT / 4] < 0.5
    assert wrong[-0.2] == joint._wrong_wait(share(), run) == 1.0


def test_impossible_parts_are_the_worst_and_others_are_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def simulate(scene: Any, params: Any, engine: str) -> Rollouts:
        seen.append(np.asarray(params.parts.stop_play))
        return rollouts(np.zeros((2, 20, 6), np.float32), np.ones((2, 4), np.bool_))

    monkeypatch.setattr(joint.engines, "simulate", simulate)
    monkeypatch.setattr(joint, "Parallel", lambda n_jobs: list)
    monkeypatch.setattr(joint, "delayed", lambda function: lambda *arguments: float(len(arguments[1].length)))
    objective = JointObjective(hooked(), {"hooked-B": share()})
    losses = objective([{"parts.stop_play": 2e-4}, {"parts.stop_play": -1.0}])
    np.testing.assert_array_equal(losses, [2.0, IMPOSSIBLE])
    np.testing.assert_allclose(seen, [[2e-4, 2e-4]])


def test_a_population_of_impossible_parts_is_not_simulated() -> None:
    objective = JointObjective(hooked(), {"hooked-A": share(), "hooked-B": share()})
    np.testing.assert_array_equal(objective([{"parts.stop_play": -1.0}] * 3), [2 * IMPOSSIBLE] * 3)


def test_a_cut_trial_ends_in_good_time() -> None:
    whole = sessions.trials_of(SESSION_B, 1)
    cut = sessions.trials_of(SESSION_B, 1, longest=13.0)
    assert float(cut.task.mating_time[0]) == 13.0
    assert float(cut.task.timeout[0]) == SESSION_B.mating_begins + sessions.SLACK + 13.0 < float(whole.task.timeout[0])
    short = replace(SESSION_B.task, mating_time=np.array(2.0))
    assert float(sessions.trials_of(replace(SESSION_B, task=short), 1, longest=13.0).task.mating_time[0]) == 2.0
