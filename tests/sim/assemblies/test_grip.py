"""A part that sits askew in the hand: it leans about its tip, and nothing but contact shows it."""

from __future__ import annotations

from functools import cache
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

from sim_mjx import engines
from sim_mjx.assemblies import ASSEMBLIES
from sim_mjx.assemblies.program import UPRIGHT
from sim_mjx.engines import native
from sim_mjx.registry import Scenario, get_scenario, pair
from sim_mjx.robots import ROBOTS, Robot

TRIALS, APPROACH = 12, 0.4  # s, within which no part touches another
SETTLED = slice(40, None)  # samples


def sets(scenario: Scenario, kind: str, **values: Any) -> Any:
    """Trials with a fault, or "none"; of each fault there are those of the same indices without it."""
    chosen = {"nominal_share": 1.0} if kind == "none" else {"nominal_share": 0.0, "faults": (kind,)}
    return scenario.draw_batch(7, range(TRIALS), scenario.spec(**chosen, **values))[0]


@cache
def approach(name: str, kind: str) -> np.ndarray:
    """Wrenches ``[trial, time, 6]`` before contact."""
    scenario = get_scenario(name)
    out = engines.simulate(scenario.scene(), sets(scenario, kind, longest=APPROACH))
    assert np.isnan(out.onset[:, 1]).all()
    return out.wrench


def sideways(wrench: np.ndarray) -> np.ndarray:
    """How far the force across the hand moves on the way, N."""
    change = wrench[:, SETTLED, :2].mean(1) - wrench[:, 2:8, :2].mean(1)
    return np.hypot(*change.T)


def largest(wrench: np.ndarray) -> np.ndarray:
    """The largest force, N."""
    return np.linalg.norm(wrench[..., :3], axis=-1).max(1)


@pytest.mark.parametrize("name", ["peg-in-hole@panda", "clip@ur5e"])
def test_before_contact_no_fault_can_be_felt(name: str) -> None:
    scenario = get_scenario(name)
    for kind in (kind for kind in ASSEMBLIES[scenario.assembly].faults if kind != "early-stop"):
        nominal, faulty = approach(name, "none"), approach(name, kind)
        for number in (sideways, largest):
            area = (number(faulty)[:, None] > number(nominal)).mean()  # under the ROC curve
            assert 0.2 < area < 0.8, (kind, number.__name__)
        np.testing.assert_allclose(faulty[..., :3], nominal[..., :3], atol=0.05)  # N, of the same hand
        np.testing.assert_allclose(faulty[..., 3:], nominal[..., 3:], atol=0.005)  # Nm


def test_a_part_leans_in_a_hand_whose_arm_is_compiled_with_fused_bodies() -> None:
    def fused() -> mujoco.MjSpec:
        spec = ROBOTS["panda"].build()
        spec.compiler.fusestatic = True
        return spec

    panda = ROBOTS["panda"]
    scenario = pair(ASSEMBLIES["peg-in-hole"], Robot("fused", fused, panda.wrist, panda.home, panda.place))
    scene, params = scenario.scene(), sets(scenario, "askew")
    quats = scene.fields(params.parts)["body_quat"][:, scene.model.body("MALE").id]
    assert len(np.unique(quats, axis=0)) == TRIALS


def test_a_part_leans_about_its_tip_in_an_upright_hand() -> None:
    scenario = get_scenario("peg-in-hole@panda")
    scene, params = scenario.scene(), sets(scenario, "askew")
    lean = np.linalg.norm(params.parts.grip[:, :2], axis=1)
    assert ((lean >= 0.06) & (lean <= 0.12)).all()
    fields = scene.fields(params.parts)
    for trial in range(TRIALS):
        model = native.model_of(scene, jax.tree.map(lambda leaf, trial=trial: leaf[trial], params.parts))
        np.testing.assert_array_equal(model.body_quat, fields["body_quat"][trial])
        data = mujoco.MjData(model)
        data.qpos[scene.joints] = params.home[trial]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.site("TIP").xmat.reshape(3, 3), UPRIGHT, atol=1e-5)
        np.testing.assert_allclose(data.body("MALE").xpos, data.site("TIP").xpos, atol=1e-9)
        quat, turn = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quat, data.body("MALE").xmat)
        mujoco.mju_quat2Vel(turn, quat, 1.0)
        np.testing.assert_allclose(turn, params.parts.grip[trial], atol=1e-5)
