"""Learning set-points: the search finds what it is told to, resumes, and a policy of nothing changes nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.simulation import learn_setpoints, steered
from sim_mjx import engines
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.registry import get_scenario


def closeness(_engine: str, _trials: object, policies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As if a policy were the better, the nearer it is to a quarter of every range."""
    wanted = steered.LOW + 0.25 * (steered.HIGH - steered.LOW)
    far = np.abs((policies - wanted) / (steered.HIGH - steered.LOW)).mean(1)
    return 1.0 - far[:, None], (far < 0.1)[:, None]


def test_the_search_finds_the_best_policy_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learn_setpoints, "evaluate", closeness)
    monkeypatch.setattr(learn_setpoints, "beside", lambda *_: None)
    search = learn_setpoints.Search("native", 60, 1, 1.0, 0)
    whole = learn_setpoints.learn(search, 12, tmp_path / "whole.json")
    tabs, seated = closeness("", None, np.array([whole["mean"], steered.RECORDED]))
    assert tabs[0, 0] > 0.95 > tabs[1, 0]
    assert seated.ravel().tolist() == [True, False]
    assert whole["generations"][-1]["seated, mean"] > whole["generations"][0]["seated, mean"]
    learn_setpoints.learn(search, 5, tmp_path / "parts.json")
    assert learn_setpoints.learn(search, 12, tmp_path / "parts.json") == whole


def test_test_trials_are_beside_the_part_and_not_those_of_learning() -> None:
    near, far, other = (
        learn_setpoints.beside(seed, range(3), 1.0, offset).task.way_position
        for seed, offset in ((learn_setpoints.TEST, 0.0), (learn_setpoints.TEST, 5e-3), (learn_setpoints.LEARN, 5e-3))
    )
    np.testing.assert_allclose(np.linalg.norm((far - near)[..., :2], axis=-1), 5e-3)
    assert not np.isclose(far, other)[..., :2].any()


def test_the_recorded_policy_changes_nothing_and_a_descent_does() -> None:
    scene = get_scenario(learn_setpoints.PRESET).scene()
    trials = learn_setpoints.beside(0, range(2), 1.5)
    above = trials.task.way_position + np.array([0.0, 0.0, 0.03])  # nothing touches
    trials = replace(trials, task=replace(trials.task, way_time=trials.task.way_time / 8, way_position=above))
    plain = engines.simulate(scene, trials, "native")
    program = replace(scene, program=steered.steered(scene.program))
    down = steered.RECORDED.copy()
    down[list(steered.RANGES).index("descent")] = 8.0
    for policy in (steered.RECORDED, down):
        policies = np.tile(policy, (2, 1))
        params = steered.SteeredParams(steered.with_policies(trials, policies), policies)
        found = engines.simulate(program, params, "native")
        moved = np.abs(found.joints - plain.joints)
        if policy is steered.RECORDED:
            assert moved.max() < 1e-5
        else:
            late = int(trials.task.way_time[:, -1].min() / CONTROL_PERIOD)
            assert moved[:, :late].max() < 1e-5 < 1e-3 < moved[:, -1].max()


def test_actions_are_speeds_within_one() -> None:
    policy = jnp.asarray([0, 0, 0, 0, 4.0, 3.0, 0.5, 5.0, 0.0])
    still = steered.act(policy, jnp.float32(-1.0), jnp.float32(0.0), jnp.bool_(False), jnp.zeros(6))
    assert not still.any()
    down = steered.act(policy, jnp.float32(1.0), jnp.float32(0.0), jnp.bool_(False), jnp.zeros(6))
    speed = down * steered.CONFIG.shift / steered.CONFIG.dt
    np.testing.assert_allclose(speed, [0, 0, -4e-3, 0, 0, 0], atol=1e-9)
    around = [
        np.asarray(steered.act(policy, jnp.float32(1.0), jnp.float32(at), jnp.bool_(True), jnp.zeros(6)))[:2]
        for at in np.arange(0, 5.0, steered.CONFIG.dt)
    ]
    np.testing.assert_allclose(np.sum(around, 0) * steered.CONFIG.shift * 1e3, [-3.0, 0.0], atol=0.05)
    yielding = policy.at[8].set(1.0)
    pushed = steered.act(yielding, jnp.float32(1.0), jnp.float32(9.0), jnp.bool_(True), jnp.ones(6) * 100.0)
    assert abs(np.asarray(pushed)).max() == 1.0
