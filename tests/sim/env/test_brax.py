"""Brax's wrappers and learner around an environment; skipped where Brax is not installed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sim_mjx.env import Environment
from sim_mjx.env.config import EnvConfig
from tests.support.fake_physics import environment, trials

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # Brax imports packages that are no longer maintained
    pytest.importorskip("brax", reason="Brax is not installed, and no extra needs it")
    from brax.envs.wrappers import training
    from brax.training.agents.ppo import train as ppo

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of functions that Brax calls

CONFIG = EnvConfig(action="joint", controller="none", observe=("joints", "wrench"), angle=0.02, hold=0.1)
ACTIONS = np.float32([[1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0, 0]])


@pytest.fixture(autouse=True)
def usual_promotion() -> Iterator[None]:
    """Brax's code promotes ranks and types."""
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        yield


@pytest.fixture(scope="module")
def scene() -> Environment:
    return environment(CONFIG, trials(longest=0.5))


def test_wrapped_episodes_end_and_begin_again_in_a_scan(scene: Environment) -> None:
    wrapped = training.wrap(scene, episode_length=30)
    first = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 2))

    def step(state: object, _: None) -> tuple[object, object]:
        state = wrapped.step(state, ACTIONS)
        return state, state

    _, seen = jax.jit(lambda state: jax.lax.scan(step, state, length=45))(first)
    done = np.asarray(seen.done) > 0.5
    assert done[:, 0].sum() >= 3
    assert np.flatnonzero(done[:, 1]).tolist() == [19, 39]  # 0.5 s
    np.testing.assert_array_equal(seen.info["time_out"], done * [0, 1])
    assert not seen.info["truncation"].any()  # the wrapper's own, after 30 steps
    np.testing.assert_array_equal(seen.obs[19, 1], first.obs[1])


def test_ppo_trains_on_an_environment(scene: Environment, monkeypatch: pytest.MonkeyPatch) -> None:
    if not hasattr(jax, "device_put_replicated"):  # Brax 0.14.2 calls it, JAX 0.10 no longer has it

        def replicated(tree: object, devices: list[object]) -> object:
            return jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)

        monkeypatch.setattr(jax, "device_put_replicated", replicated, raising=False)
    policy, params, metrics = ppo.train(
        scene, num_timesteps=64, num_envs=4, episode_length=15, unroll_length=4, batch_size=4, num_minibatches=1,
        num_updates_per_batch=1, normalize_observations=True, bootstrap_on_timeout=True, run_evals=False,
    )  # fmt: skip
    assert np.isfinite(metrics["training/total_loss"])
    action, _ = policy(params, deterministic=True)(scene.reset(jax.random.PRNGKey(0)).obs, jax.random.PRNGKey(1))
    assert action.shape == (scene.action_size,)
