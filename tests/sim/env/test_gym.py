"""The adaptors to Gymnasium: its own checker, and episodes that follow one another."""

from __future__ import annotations

import inspect
from typing import Any

import jax
import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed; install the extra gym")

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics

from rcbht_jax.errors import InputError
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.gym import SingleEnv, VectorEnv, _key
from tests.support.fake_physics import environment, trials

CONFIG = EnvConfig(action="joint", controller="none", angle=0.02, hold=0.1)
SEATING = np.float32([1, 1, 1, 1, 0, 0])


@pytest.fixture(scope="module")
def many() -> VectorEnv:
    return VectorEnv(environment(CONFIG, trials(longest=0.5)), 3)


@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes.*")  # there are none
def test_gymnasiums_checker_has_no_complaint() -> None:
    check_env(SingleEnv(environment(CONFIG)))


def test_spaces_are_those_of_what_comes_out(many: VectorEnv) -> None:
    obs, info = many.reset(seed=3)
    assert obs in many.observation_space
    assert many.single_action_space.shape == (6,)
    obs, reward, terminated, truncated, info = many.step(many.action_space.sample())
    assert obs in many.observation_space
    assert reward.shape == terminated.shape == truncated.shape == info["time"].shape == (3,)
    assert terminated.dtype == truncated.dtype == np.bool_
    assert many.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP


def test_an_episode_follows_the_one_that_has_ended(many: VectorEnv) -> None:
    many.reset(seed=3)
    actions = np.stack([SEATING, np.zeros(6, np.float32), np.zeros(6, np.float32)])
    terminated, truncated, times, rewards = [], [], [], []
    for _ in range(22):
        _, reward, end, cut, info = many.step(actions)
        for kept, value in zip((terminated, truncated, times, rewards), (end, cut, info["time"], reward), strict=True):
            kept.append(value)
    first = int(np.argmax(np.array(terminated)[:, 0]))
    assert 0 < first < 19
    assert not np.array(terminated)[:, 1:].any()
    assert np.flatnonzero(np.array(truncated)[:, 1]).tolist() == [19]  # 0.5 s
    assert not np.array(truncated)[:20, 0].any()
    clock = np.array(times)
    assert clock[first + 1, 0] == 0.0  # the step after the end only begins the next episode
    assert clock[first + 2, 0] == pytest.approx(0.025)
    assert clock[20:22, 1].tolist() == [0.0, pytest.approx(0.025)]
    assert np.array(rewards)[first, 0] >= 1.0
    assert np.array(rewards)[first + 1, 0] == 0.0


ONE_SEATS = np.stack([SEATING, np.zeros(6, np.float32), np.zeros(6, np.float32)])


def until_the_end(env: Any, seed: int = 3) -> tuple[int, Any]:
    """Steps until the first environment has ended, and what the last one returned."""
    env.reset(seed=seed)
    for count in range(1, 20):
        out = env.step(ONE_SEATS)
        if out[2][0]:
            return count, out
    raise AssertionError("no end")


def test_an_episode_follows_within_the_last_step_of_the_one_before(many: VectorEnv) -> None:
    same = VectorEnv(many.env, 3, autoreset_mode="SameStep")
    assert same.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert many.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    (length, (obs, reward, terminated, _, infos)), (wanted, last) = until_the_end(same), until_the_end(many)
    assert length == wanted
    np.testing.assert_array_equal(terminated, [True, False, False])
    np.testing.assert_array_equal(reward, last[1])
    np.testing.assert_array_equal(infos["_final_obs"], terminated)
    np.testing.assert_array_equal(infos["final_obs"][0], last[0][0])
    assert infos["final_obs"][1] is None
    assert infos["final_info"]["time"][0] == last[4]["time"][0] > 0.0
    np.testing.assert_array_equal(infos["time"], last[4]["time"] * [0, 1, 1])
    np.testing.assert_array_equal(obs[1:], last[0][1:])
    assert obs[0] in same.single_observation_space
    _, _, terminated, _, infos = same.step(ONE_SEATS)
    assert "final_obs" not in infos
    assert infos["time"][0] == pytest.approx(0.025)
    assert not terminated.any()


def test_without_automatic_resets_a_mask_says_where_episodes_begin(many: VectorEnv) -> None:
    env = VectorEnv(many.env, 3, autoreset_mode=AutoresetMode.DISABLED)
    _, (obs, _, ended, _, infos) = until_the_end(env)
    with pytest.raises(InputError, match=r"The episodes of the environments \[0\] have ended"):
        env.step(ONE_SEATS)
    options = {"reset_mask": ended}
    begun, after = env.reset(options=options)
    assert list(options) == ["reset_mask"]  # wrappers read it afterwards
    np.testing.assert_array_equal(begun[1:], obs[1:])
    np.testing.assert_array_equal(after["time"], infos["time"] * [0, 1, 1])
    _, _, ended, _, infos = env.step(ONE_SEATS)
    assert not ended.any()
    np.testing.assert_allclose(infos["time"], after["time"] + 0.025, rtol=1e-6)


def test_what_is_closed_neither_steps_nor_begins(many: VectorEnv) -> None:
    env = VectorEnv(many.env, 3)
    env.reset()
    env.close()
    env.close()
    for refused in (lambda: env.step(ONE_SEATS), env.reset):
        with pytest.raises(InputError, match="The environments are closed; make new ones"):
            refused()


@pytest.mark.parametrize("mask", [[True, False], [1, 0, 0], [False] * 3, np.array([[True, True, True]]), "all"])
def test_a_mask_that_is_none_is_refused(many: VectorEnv, mask: Any) -> None:
    many.reset(seed=0)
    with pytest.raises(InputError, match=r"reset_mask is .*; expected bool \[3\], true once or more"):
        many.reset(options={"reset_mask": mask})


def test_a_mask_of_some_needs_episodes_that_go_on(many: VectorEnv) -> None:
    with pytest.raises(InputError, match="call reset first"):
        VectorEnv(many.env, 3).reset(options={"reset_mask": np.array([True, False, True])})
    many.reset(options={"reset_mask": np.ones(3, bool)})


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_gymnasiums_wrapper_counts_whole_episodes(many: VectorEnv, mode: AutoresetMode) -> None:
    env = RecordEpisodeStatistics(VectorEnv(many.env, 3, autoreset_mode=mode))
    env.reset(seed=3)
    lengths, returns = [], []
    for _ in range(19):
        _, _, ended, truncated, infos = env.step(ONE_SEATS)
        if (over := ended | truncated).any():
            lengths.append(int(infos["episode"]["l"][0]))
            returns.append(float(infos["episode"]["r"][0]))
            if mode is AutoresetMode.DISABLED:
                env.reset(options={"reset_mask": over})
    assert len(set(lengths)) == 1
    assert returns == [2.0] * len(lengths)
    assert len(lengths) >= 2


def test_gymnasium_makes_them_by_name(many: VectorEnv) -> None:
    name = "snap-on-springs-v0"
    gymnasium.register(
        name, lambda: SingleEnv(many.env), vector_entry_point=lambda num_envs: VectorEnv(many.env, num_envs)
    )
    try:
        alone, together = gymnasium.make(name), NormalizeObservation(gymnasium.make_vec(name, num_envs=3))
        assert alone.reset(seed=1)[0] in alone.observation_space
        assert together.reset(seed=1)[0] in together.observation_space
        assert together.step(ONE_SEATS)[0] in together.observation_space
        alone.close()
        together.close()
    finally:
        gymnasium.registry.pop(name)


def test_seeds_repeat_and_episodes_differ(many: VectorEnv) -> None:
    first, _ = many.reset(seed=5)
    trial = many.reset()[1]["trial"]
    again, _ = many.reset(seed=5)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(many.reset()[1]["trial"], trial)
    assert len({tuple(many.reset(seed=seed)[1]["trial"].tolist()) for seed in range(8)}) > 1


def test_seeds_of_a_list_are_those_of_single_environments(many: VectorEnv) -> None:
    def episodes(seed: Any, count: int = 4) -> np.ndarray:
        """Row of the trial and its noise, of the present and later episodes."""
        many.reset(seed=seed)
        rows = []
        for _ in range(count):
            rows.append(np.array(many._state.data.params.seed))
            many.reset()
        return np.stack(rows)

    first, other = episodes([4, 5, 6]), episodes([4, 9, 6])
    np.testing.assert_array_equal(first[:, [0, 2]], other[:, [0, 2]])
    assert (first[:, 1] != other[:, 1]).any(axis=-1).all()
    np.testing.assert_array_equal(episodes(np.array([6, 4, 4]))[:, 1:], first[:, [0, 0]])
    many.reset(seed=[4, 5, 6])
    many.reset(seed=[9, None, 9])
    np.testing.assert_array_equal(many._state.data.params.seed[1], first[1, 1])
    with pytest.raises(InputError, match="There are 2 seeds for 3 environments"):
        many.reset(seed=[1, 2])
    with pytest.raises(InputError, match="seed is -1"):
        VectorEnv(many.env, 3, seed=[1, 2, -1])


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_episode_depends_on_its_seed_and_number_alone(many: VectorEnv, mode: AutoresetMode) -> None:
    env = VectorEnv(many.env, 3, autoreset_mode=mode)

    def present() -> np.ndarray:
        return np.array(env._state.data.params.seed)

    env.reset(seed=[4, 5, 6])
    env.reset()
    second = present()
    env.reset()
    third = present()
    env.reset(seed=[4, 5, 6])
    first, last = present(), np.array([True, False, False])
    for _ in range(19):  # the first one begins again and again, the others go on
        ended = np.logical_or(*env.step(ONE_SEATS)[2:4])
        if mode is AutoresetMode.DISABLED and ended.any():
            env.reset(options={"reset_mask": ended})
    np.testing.assert_array_equal(present()[1:], first[1:])
    assert not (present()[0] == first[0]).all()
    env.reset(options={"reset_mask": ~last})
    np.testing.assert_array_equal(present()[1:], second[1:])
    env.reset(seed=7, options={"reset_mask": last})
    np.testing.assert_array_equal(present()[1:], second[1:])
    env.reset()
    np.testing.assert_array_equal(present()[1:], third[1:])
    env.reset(seed=[4, 5, 6])
    for _ in range(22 if mode is not AutoresetMode.DISABLED else 0):
        env.step(np.zeros((3, 6), np.float32))  # all end by time
    if mode is not AutoresetMode.DISABLED:
        np.testing.assert_array_equal(present(), second)


def test_a_seed_may_have_any_number_of_bits(many: VectorEnv) -> None:
    def drawn(seed: int) -> list[int]:
        return jax.random.key_data(_key(seed)).tolist()

    seeds = [5, 2**32 + 5, 2**63 + 5, 2**64 + 5, 2**65 + 5, (5 << 64) + 5, np.random.SeedSequence(1).entropy << 96]
    assert len({tuple(drawn(seed)) for seed in seeds}) == len(seeds)
    for seed in (0, 5, 2**32 - 1):  # as before
        assert drawn(seed) == jax.random.key_data(jax.random.key(seed)).tolist()
    many.reset(seed=2**127)
    SingleEnv(many.env, seed=2**64).reset()
    with pytest.raises(InputError, match="seed is -1; expected a whole number, zero or more"):
        SingleEnv(many.env, seed=-1)


def test_misuse_is_refused(many: VectorEnv) -> None:
    with pytest.raises(InputError, match="call reset first"):
        SingleEnv(many.env).step(SEATING)
    many.reset(seed=0)
    with pytest.raises(InputError, match=r"shape \(6,\); expected \(3, 6\)"):
        many.step(SEATING)
    with pytest.raises(InputError, match="An action is NaN"):
        many.step(np.full((3, 6), np.nan))
    for actions in ([["left"] * 6] * 3, [[1.0], [1.0, 2.0]]):
        with pytest.raises(InputError, match=r"The actions are no array of numbers; expected float32 \[3, 6\]"):
            many.step(actions)
    many.step(np.full((3, 6), np.inf))  # as 1, the largest
    with pytest.raises(InputError, match="num_envs is 0"):
        VectorEnv(many.env, 0)
    with pytest.raises(InputError, match="autoreset_mode is 'never'; expected one of 'NextStep', 'SameStep'"):
        VectorEnv(many.env, 3, autoreset_mode="never")
    for adaptor in (SingleEnv(many.env), many):
        with pytest.raises(InputError, match="seed is -1; expected a whole number, zero or more"):
            adaptor.reset(seed=-1)
    for adaptor in (SingleEnv(many.env), many):
        with pytest.raises(InputError, match="draw no pictures"):
            adaptor.render()
        unchecked = inspect.unwrap(type(adaptor).__init__)  # the annotations of the tests' run refuse it first
        with pytest.raises(InputError, match=r"The environment is 'clip'; expected what sim_mjx\.env\.load returns"):
            unchecked(adaptor, "clip", 2)
