"""The environment's own part, on physics that need no compiling: actions, observations, ends, purity."""

from __future__ import annotations

import inspect
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.labels import LAYER_SIZES
from sim_mjx import env as environments
from sim_mjx.env.actions import DAMPING, with_set_points
from sim_mjx.env.config import EnvConfig
from tests.support.fake_physics import DEPTH, environment, model, trials

JOINT = EnvConfig(action="joint", controller="none", observe=("joints", "wrench"), angle=0.02, hold=0.1)
STEERED = EnvConfig(observe=("joints", "wrench"))


@cache
def compiled(config: EnvConfig, mapped: bool = False, models: bool = False) -> tuple[Any, Any, Any]:
    env = environment(config, model=model() if models else None)
    reset, step = (jax.vmap(env.reset_to), jax.vmap(env.step)) if mapped else (env.reset_to, env.step)
    return env, environments.jit(reset), environments.jit(step)


def run(config: EnvConfig, actions: np.ndarray, row: int = 0, models: bool = False) -> list[Any]:
    _, reset, step = compiled(config, models=models)
    states = [reset(jnp.int32(row))]
    for action in actions:
        states.append(step(states[-1], action))
    return states


def assert_equal(first: Any, second: Any) -> None:
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(one, other)


def test_sizes_are_those_of_what_comes_out() -> None:
    env, reset, _ = compiled(EnvConfig(), models=True)
    state = reset(jnp.int32(1))
    assert state.obs.shape == (env.observation_size,)
    slices = env.observation_slices
    assert {part: at.stop - at.start for part, at in slices.items()} == {
        "joints": 6, "wrench": 6, "words": 6 * sum(LAYER_SIZES), "beliefs": 3 + 2,
    }  # fmt: skip
    np.testing.assert_array_equal(state.obs[slices["joints"]], np.float32(trials().task.home[1]))
    assert not state.obs[slices["wrench"]].any()
    assert not state.obs[slices["words"]].any()
    np.testing.assert_allclose(state.obs[slices["beliefs"]], [1 / 3] * 3 + [1 / 2] * 2)
    assert (env.action_size, env.dt, env.sim_dt, env.trial_count) == (6, 0.025, 0.0025, 3)
    assert int(state.info["trial"]) == 1


def test_a_step_changes_nothing_but_what_it_returns() -> None:
    _, reset, step = compiled(STEERED)
    state = reset(jnp.int32(0))
    before = [np.array(leaf) for leaf in jax.tree.leaves(state)]
    first, second = (step(state, jnp.full(6, 0.3)) for _ in range(2))
    assert_equal(state, before)
    assert_equal(first, second)


def test_mapped_environments_are_the_single_ones() -> None:
    _, reset, step = compiled(STEERED, mapped=True)
    rows, rng = np.array([2, 0, 1, 0]), np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (12, 4, 6)).astype(np.float32)
    many = [reset(jnp.asarray(rows))]
    for action in actions:
        many.append(step(many[-1], action))
    for lane, row in enumerate(rows):
        alone = run(STEERED, actions[:, lane], int(row))
        for one, all_of_them in zip(alone, many, strict=True):
            np.testing.assert_allclose(one.obs, all_of_them.obs[lane], rtol=1e-5, atol=1e-5)
            assert [float(one.info[name]) for name in one.info] == [
                float(one_of[lane]) for one_of in all_of_them.info.values()
            ]


def test_joint_increments_arrive_after_the_commands_delay() -> None:
    actions = np.random.default_rng(1).uniform(-1, 1, (8, 6)).astype(np.float32)
    actions[:, 5] = abs(actions[:, 5])
    states = run(JOINT, actions)
    delay = int(trials().command_delay[0])
    references = np.cumsum(np.repeat(actions, JOINT.periods, 0) * JOINT.angle / JOINT.periods, 0)
    home = np.asarray(trials().task.home[0])
    for number, state in enumerate(states[1:], start=1):
        # joints are measured before a period's physics: those of the period before, late by the delay
        last = number * JOINT.periods - 1 - 1 - delay
        wanted = home + (references[last] if last >= 0 else 0.0)
        np.testing.assert_allclose(state.obs[:6], wanted, atol=1e-6)


def test_references_are_interpolated_between_control_periods() -> None:
    """A joint that lags shows where its reference was in the middle of a period, too."""
    env = environment(JOINT, lag=0.5)
    actions = np.random.default_rng(2).uniform(0, 1, (5, 6)).astype(np.float32)
    state, step = env.reset_to(jnp.int32(0)), environments.jit(env.step)
    for action in actions:
        state = step(state, action)
    delay = int(trials().command_delay[0])
    moved = np.repeat(actions, JOINT.periods, 0) * JOINT.angle / JOINT.periods
    references = np.concatenate([np.zeros((delay + 2, 6)), np.cumsum(moved, 0)])
    place = np.zeros(6)
    for before, after in pairwise(references[1 : len(moved) + 2]):
        for share in (0.5, 1.0):
            place = 0.5 * (place + before + share * (after - before))
    np.testing.assert_allclose(state.data.body, place, atol=1e-6)


def test_increments_are_added_to_the_recorded_controller() -> None:
    config = replace(JOINT, controller="recorded")
    still, moved = (run(config, np.tile(np.float32([value, 0, 0, 0, 0, 0]), (4, 1))) for value in (0.0, 1.0))
    recorded = run(STEERED, np.zeros((4, 6), np.float32))
    np.testing.assert_allclose(still[-1].obs, recorded[-1].obs, atol=1e-6)
    late = int(trials().command_delay[0]) + 1
    added = config.angle * (4 - late / config.periods)
    np.testing.assert_allclose(moved[-1].obs[:6] - still[-1].obs[:6], [added, 0, 0, 0, 0, 0], atol=1e-6)


def test_cartesian_increments_go_through_the_jacobian() -> None:
    config = replace(JOINT, action="cartesian", shift=0.01, turn=0.02)
    actions = np.zeros((6, 6), np.float32)
    actions[0] = [1.0, 0.0, -0.5, 0.0, 0.0, 1.0]
    found = run(config, actions)[-1].obs[:6] - np.float32(trials().task.home[0])
    gain = np.array([2.0, 1.0, 1.0, 1.0, 1.0, 0.5])
    twist = actions[0] * np.array([0.01] * 3 + [0.02] * 3)
    np.testing.assert_allclose(found, gain / (gain**2 + DAMPING**2) * twist, atol=1e-6)


def test_set_points_are_those_of_a_trial_that_has_them() -> None:
    action = np.float32([0.5, -1.0, 0.25, 0.1, -0.2, 1.0])
    params = trials()
    offset = action * np.repeat(np.float32([STEERED.force, STEERED.moment]), 3)
    changed = with_set_points(params, np.tile(offset, (3, 1)))
    np.testing.assert_allclose((changed.task.force - params.task.force)[2], [[10.0, -20.0, 5.0]] * 4, rtol=1e-6)
    env = environment(STEERED, changed)
    state, step = env.reset_to(jnp.int32(2)), environments.jit(env.step)
    acted = run(STEERED, np.tile(action, (30, 1)), row=2)
    plain = run(STEERED, np.zeros((30, 6), np.float32), row=2)
    for _ in range(30):
        state = step(state, jnp.zeros(6))
    np.testing.assert_allclose(acted[-1].obs, state.obs, rtol=1e-5, atol=1e-5)
    assert abs(np.asarray(acted[-1].obs - plain[-1].obs)).max() > 1e-3
    np.testing.assert_array_equal(acted[-1].data.params.task.force, params.task.force[2].astype(np.float32))


def test_actions_beyond_one_are_clipped() -> None:
    wild, full = (run(STEERED, np.full((1, 6), value, np.float32))[-1] for value in (7.0, 1.0))
    np.testing.assert_array_equal(wild.obs, full.obs)


def test_an_action_may_be_a_list() -> None:
    env, reset, step = compiled(STEERED)
    raw = inspect.unwrap(environments.Environment.step)  # the annotations of the tests' run refuse a list
    unchecked = environments.jit(partial(raw, env))
    state = reset(jnp.int32(0))
    np.testing.assert_array_equal(unchecked(state, [0.5] * 6).obs, step(state, np.full(6, 0.5, np.float32)).obs)


@pytest.mark.parametrize("config", [JOINT, STEERED], ids=["joint", "set-points, which are not read before contact"])
def test_nan_as_an_action_ends_the_episode_with_finite_numbers(config: EnvConfig) -> None:
    last = run(config, np.float32([[0] * 6, [np.nan] * 6]))[-1]
    assert (float(last.done), float(last.info["diverged"]), float(last.reward)) == (1.0, 1.0, 0.0)
    assert np.isfinite(last.obs).all()


@pytest.mark.parametrize(("config", "size"), [(STEERED, 1), (STEERED, 7), (JOINT, 1), (JOINT, 12)])
def test_actions_of_another_size_are_refused(config: EnvConfig, size: int) -> None:
    env, reset, _ = compiled(config)
    with pytest.raises(InputError, match=rf"An action has shape \({size},\); expected \(6,\)"):
        jax.eval_shape(env.step, reset(jnp.int32(0)), jnp.zeros(size))


def test_a_program_in_double_precision_gets_the_same_episode() -> None:
    env, reset, step = compiled(EnvConfig(), models=True)
    action = np.full(6, 0.3)
    expected = step(step(reset(jnp.int32(1)), np.float32(action)), np.float32(action))
    with jax.enable_x64(True):
        begun = jax.jit(env.reset_to)(jnp.asarray(1))
        found, _ = environments.jit(jax.lax.scan, static_argnums=0)(
            lambda state, given: (env.step(state, given), None), begun, jnp.asarray([action, action])
        )
    assert [leaf.dtype for leaf in jax.tree.leaves(found)] == [leaf.dtype for leaf in jax.tree.leaves(expected)]
    assert_equal(found, expected)


def test_success_takes_all_tabs_and_time() -> None:
    states = run(JOINT, np.tile(np.float32([1, 1, 1, 1, 0, 0]), (9, 1)))
    seated = [float(state.metrics["seated"]) for state in states]
    first = seated.index(1.0)
    assert set(seated) == {0.0, 1.0}
    done = [float(state.done) for state in states]
    steps = round(JOINT.hold / JOINT.dt)
    assert done.index(1.0) in (first + steps - 1, first + steps)
    last = states[done.index(1.0)]
    assert (float(last.metrics["success"]), float(last.info["truncation"])) == (1.0, 0.0)
    assert sum(float(state.reward) for state in states[: done.index(1.0) + 1]) == 2.0
    three = run(JOINT, np.tile(np.float32([1, 1, 1, 0, 0, 0]), (9, 1)))
    assert [float(three[-1].metrics[name]) for name in ("seated", "success")] == [0.75, 0.0]
    assert float(three[-1].reward) == 0.0
    assert float(states[-1].data.body[0]) > DEPTH


def test_success_takes_a_control_period_however_short_the_hold() -> None:
    brief = replace(JOINT, hold=0.001)
    idle, seating = (run(brief, np.tile(np.float32(way), (9, 1))) for way in ([0] * 6, [1, 1, 1, 1, 0, 0]))
    assert not any(float(state.metrics["success"]) for state in idle)
    assert float(seating[-1].metrics["success"]) == 1.0


@pytest.mark.parametrize("data", ["data", "pipeline_state"])  # names of MuJoCo Playground and of Brax
def test_wrappers_reset_data_alone_and_add_their_own(data: str) -> None:
    """As ``wrap_for_brax_training`` of MuJoCo Playground: metrics and info of the ended episode stay."""
    env, reset, _ = compiled(JOINT)
    first = reset(jnp.int32(0))
    first.metrics["reward"], first.info["steps"] = first.reward, jnp.float32(0)

    def step(state: Any, action: Any) -> tuple[Any, Any]:
        state = env.step(state.replace(done=jnp.zeros_like(state.done)), action)
        again = state.replace(**{data: getattr(first, data)}, obs=first.obs)
        return jax.tree.map(lambda new, old: jnp.where(state.done > 0.5, new, old), again, state), state

    actions = np.tile(np.float32([1, 1, 1, 1, 0, 0]), (20, 1))
    last, seen = jax.lax.scan(step, first, actions)
    assert {"reward", "seated"} <= set(last.metrics)
    assert "steps" in last.info
    ends = np.flatnonzero(seen.done > 0.5)
    assert len(ends) >= 2
    np.testing.assert_array_equal(np.diff(np.cumsum(seen.reward)[ends]), 2.0)  # each episode's reward is its own
    assert env.unwrapped is env
    assert env.n_substeps * env.sim_dt == pytest.approx(env.dt)


def test_the_memory_of_a_first_state_may_be_donated() -> None:
    """No leaf shares its buffer with another one or with the environment, whose next episodes begin as before."""
    env, *_ = compiled(JOINT)
    step = environments.jit(env.step, donate_argnums=0)
    ends = []
    for _ in range(2):
        state = env.reset_to(jnp.int32(0))
        for _ in range(2):
            state = step(state, jnp.zeros(6))
        ends.append(state)
    assert_equal(*ends)


def test_time_truncates() -> None:
    states = run(JOINT, np.zeros((40, 6), np.float32))
    done = [float(state.done) for state in states]
    assert done.index(1.0) == round(1.0 / JOINT.dt)
    last = states[done.index(1.0)]
    assert [float(last.info[name]) for name in ("truncation", "time_out", "time")] == [1.0, 1.0, 1.0]
    assert (float(last.metrics["success"]), float(last.info["diverged"])) == (0.0, 0.0)


def test_divergence_ends_an_episode_with_finite_numbers() -> None:
    states = run(JOINT, np.tile(np.float32([0, 0, 0, 0, 0, -1]), (8, 1)))
    done = [float(state.done) for state in states]
    last = states[done.index(1.0)]
    assert 1 < done.index(1.0) < 8
    assert [float(last.info[name]) for name in ("diverged", "truncation", "time_out")] == [1.0, 0.0, 0.0]
    assert np.isfinite(last.obs).all()
    assert np.isfinite([last.reward, *last.metrics.values()]).all()


def test_reset_chooses_trials_and_noise() -> None:
    env, *_ = compiled(STEERED)
    keys = jax.random.split(jax.random.key(0), 24)
    states = jax.jit(jax.vmap(env.reset))(keys)
    assert set(np.asarray(states.info["trial"]).tolist()) == {0, 1, 2}
    assert len(np.unique(states.data.params.seed, axis=0)) == 24
    again = jax.jit(jax.vmap(env.reset))(keys)
    assert_equal(states, again)
    np.testing.assert_array_equal(env.reset_to(jnp.int32(1)).data.params.seed, trials().seed[1])
    for row in (3, -1):
        with pytest.raises(InputError, match=f"There is no trial {row}; expected 0 to 2"):
            env.reset_to(jnp.int32(row))
    unchecked = inspect.unwrap(environments.Environment.reset_to)  # the annotations of the tests' run refuse it first
    for row in ([0, 1], 0.5, "a", jnp.arange(2)):
        with pytest.raises(InputError, match="expected one whole number"):
            unchecked(env, row)
    for seed in (5, jax.random.split(jax.random.key(5)), np.zeros(2)):
        with pytest.raises(InputError, match="The seed of the noise is no key"):
            unchecked(env, 0, seed)
    typed, raw = (env.reset_to(jnp.int32(1), made(5)) for made in (jax.random.key, jax.random.PRNGKey))
    assert_equal(typed, raw)


def test_words_and_beliefs_are_those_of_the_stream() -> None:
    """The introspector hears every sample of the same episode, which an environment of single periods shows."""
    count, config = 36, EnvConfig()
    seen = run(config, np.zeros((count, 6), np.float32), models=True)
    fine = replace(STEERED, periods=1)
    samples = [state.obs[6:12] for state in run(fine, np.zeros((5 * count, 6), np.float32))[1:]]
    phases = [int(state.info["phase"]) for state in seen]
    introspector = Introspector(model(), rate=None)
    introspector.begin()
    slices = compiled(config, models=True)[0].observation_slices
    for number, state in enumerate(seen[1:], start=1):
        introspector.push(np.stack(samples[5 * (number - 1) : 5 * number]))
        words = np.split(np.asarray(state.obs[slices["words"]]), np.cumsum(np.array(LAYER_SIZES) * 6)[:-1])
        for layer, (row, size) in enumerate(zip(words, LAYER_SIZES, strict=True)):
            codes = row.reshape(6, size) @ np.arange(1, size + 1)
            np.testing.assert_array_equal(codes, introspector.labels[layer, 0])
        wanted = np.concatenate([introspector.latest[head.name].probabilities for head in introspector.heads])
        np.testing.assert_allclose(state.obs[slices["beliefs"]], wanted, atol=2e-4)
        if phases[number] != phases[number - 1]:
            introspector.begin()
    assert introspector.labels[0, 0].any()
    assert len(set(phases)) > 1  # a sub-task began on the way
