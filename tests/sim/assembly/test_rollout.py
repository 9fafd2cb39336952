"""The simulated assembly: seats when it should, fails when it cannot, and its times are the recorded ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.assembly import parts
from sim_mjx.assembly.rollout import Rollouts, TrialParams, stack
from sim_mjx.assembly.scene import one_arm
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets import preset

RECORDED_A = (0.0, 7.065, 15.38, 16.32)  # s, medians of session A


def trial(shift: tuple[float, float] = (0.0, 0.0), **changes: np.ndarray) -> TrialParams:
    task = preset("A").task
    moved = task.way_position + np.array([*shift, 0.0])
    task = replace(task, way_position=moved, mating_time=np.array(4.0), timeout=np.array(22.0))
    part = replace(preset("A").parts, **changes)
    return TrialParams(task, preset("A").sensor, part, np.array(5, np.int32), np.array([0, 1], np.uint32))


@pytest.fixture(scope="module")
def run() -> Rollouts:
    overlap = preset("A").parts.hook_overlap.copy()
    overlap[2] *= -1
    return native.simulate(
        one_arm(), stack([trial(), trial(hook_overlap=overlap), trial(shift=(0.0, 0.009)), trial(shift=(0.03, 0.0))])
    )


def test_nominal_trial_seats_all_tabs_at_the_recorded_times(run: Rollouts) -> None:
    assert run.seated[0].all()
    np.testing.assert_allclose(run.onset[0], RECORDED_A, atol=0.3)
    assert not run.diverged.any()


def test_nothing_touches_before_the_contact(run: Rollouts) -> None:
    before = int(run.onset[0, 1] / CONTROL_PERIOD) - 20
    assert np.abs(run.wrench[0, :before, :3]).max() < 0.6
    assert run.wrench[0, before:, 2].max() > 20


def test_a_missing_tab_does_not_snap(run: Rollouts) -> None:
    assert not run.seated[1, 2]


def test_a_far_offset_does_not_seat(run: Rollouts) -> None:
    assert not run.seated[2].all()
    assert not run.seated[3].all()


def test_rows_beyond_the_end_are_zero(run: Rollouts) -> None:
    for row in range(len(run.length)):
        assert not run.wrench[row, run.length[row] :].any()


@pytest.mark.parametrize(
    "changes",
    [
        {"tab_stiffness": np.full(4, -1.0)}, {"friction": np.array(np.nan)},
        {"hook_overlap": np.full(4, 0.01)}, {"slot_play": np.array(0.0)},
    ],
)  # fmt: skip
def test_parts_that_cannot_be_are_refused(changes: dict) -> None:
    with pytest.raises(InputError):
        parts.check(replace(preset("A").parts, **changes))
