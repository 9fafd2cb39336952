"""The real physics in an environment: one compiled program for all of these tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sim_mjx import engines
from sim_mjx import env as environments
from sim_mjx.assembly.rollout import TrialParams
from sim_mjx.env.actions import joint_increments
from sim_mjx.env.config import EnvConfig
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.validation.engine_parity import FORCE_LIMIT, MOMENT_LIMIT

STEPS, LANES = 72, 16  # the lanes of the batch engine, whose compiled program other tests share


def short_trials() -> TrialParams:
    params, _ = get_scenario("B").draw_batch(0, range(4), DomainRandomization(nominal_share=1.0, longest=1.8))
    return replace(params, task=replace(params.task, way_time=params.task.way_time / 4))


@pytest.fixture(scope="module")
def episodes() -> tuple[Any, list[Any]]:
    """Four trials in sixteen lanes, the recorded controller alone; the last lane is steered."""
    env = environments.load("B", params=short_trials(), parallel=LANES)
    actions = np.zeros((LANES, 6), np.float32)
    actions[-1, 2] = 1.0
    step = environments.jit(jax.vmap(env.step))
    states = [jax.jit(jax.vmap(env.reset_to))(jnp.arange(LANES) % 4)]
    for _ in range(STEPS):
        states.append(step(states[-1], actions))
    return env, states


def test_the_recorded_controller_gives_the_wrench_of_the_batch_engine(episodes: tuple[Any, list[Any]]) -> None:
    env, states = episodes
    at = env.observation_slices
    found = np.stack([np.asarray(state.obs) for state in states[1:]], axis=1)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # MJX is not strict
        out = engines.simulate(get_scenario("B").scene(), short_trials(), "mjx")
    # a step shows the last of its five samples
    wrench, joints = out.wrench[:, 4 : 5 * STEPS : 5], out.joints[:, 4 : 5 * STEPS : 5]
    contact = int(out.onset[:, 1].min() / env.dt) - 1
    assert 10 < contact < STEPS
    error = np.abs(found[:4, :, at["wrench"]] - wrench)
    assert error[:, :contact, :3].max() < FORCE_LIMIT
    assert error[:, :contact, 3:].max() < MOMENT_LIMIT
    np.testing.assert_allclose(found[:4, :, at["joints"]], joints, atol=2e-4)
    assert np.abs(wrench).max() > 5  # there is a contact
    assert np.median(error[:, contact:]) < 0.05
    assert error.max() < 0.5
    phases = np.stack([np.asarray(state.info["phase"]) for state in states[1:]], axis=1)
    assert (phases[:4] > 0).argmax(1) * env.dt == pytest.approx(out.onset[:, 1], abs=2 * env.dt)


def test_lanes_are_the_same_and_a_steered_one_is_not(episodes: tuple[Any, list[Any]]) -> None:
    _, states = episodes
    last = np.asarray(states[-1].obs)
    np.testing.assert_allclose(last[:4], last[4:8], atol=1e-6)
    assert abs(last[-1, 6:12] - last[3, 6:12]).max() > 1.0


def test_an_episode_ends_by_time(episodes: tuple[Any, list[Any]]) -> None:
    _, states = episodes
    done = np.array([state.done for state in states])
    assert not done[:-1].any()
    assert done[-1].all()
    assert np.asarray(states[-1].info["truncation"]).all()
    assert not np.asarray(states[-1].info["diverged"]).any()


def test_the_jacobian_is_that_of_mujoco(episodes: tuple[Any, list[Any]]) -> None:
    """C MuJoCo's in the settled pose, which one step of the home pose hardly changes."""
    _, states = episodes
    expected = np.asarray(states[0].data.glance.jacobian)
    assert expected.shape == (LANES, 6, 6)
    np.testing.assert_allclose(states[1].data.glance.jacobian, expected, atol=1e-5)
    config = EnvConfig(action="cartesian", periods=1)
    action = np.float32([1, -1, 0.5, 0.2, 0.0, -1])
    moved = expected[0] @ np.asarray(joint_increments(config, jnp.asarray(action), jnp.asarray(expected[0])))
    wanted = action * np.repeat(np.float32([config.shift, config.turn]), 3)
    np.testing.assert_allclose(moved[3:], wanted[3:], atol=0.1 * config.turn)
    np.testing.assert_allclose(moved[:3], wanted[:3], atol=0.4 * config.shift)


def test_trials_settle_as_in_the_batch_engine(episodes: tuple[Any, list[Any]]) -> None:
    env, states = episodes
    assert abs(np.asarray(states[0].data.body.qvel)).max() < 1e-4
    assert env.trial_count == 4
    assert states[0].data.body.qpos.dtype == jnp.float32
