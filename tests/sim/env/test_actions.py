"""What the damping of Cartesian actions costs, as the page of environments states it."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np

from sim_mjx.env.actions import joint_increments
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.physics import sites_of
from sim_mjx.presets import PRESETS
from sim_mjx.registry import get_scenario
from sim_mjx.robots import ROBOTS

PAGE = Path(__file__).parents[3] / "docs/howto/environment.md"


def test_the_hand_moves_as_much_less_as_the_page_says() -> None:
    config, lost, shifted = EnvConfig(action="cartesian", periods=1), [], []
    for name in [*PRESETS, *(f"peg-in-hole@{robot}" for robot in ROBOTS)]:
        scenario = get_scenario(name)
        scene = scenario.scene()
        params, _ = scenario.draw(0, 0, scenario.spec(nominal_share=1.0))
        data = mujoco.MjData(scene.model)
        data.qpos[scene.joints] = np.asarray(scene.program.home(params))
        mujoco.mj_forward(scene.model, data)
        rows = np.zeros((len(scene.forces), 2, 3, scene.model.nv))
        for (moving, turning), site in zip(rows, sites_of(scene), strict=True):
            mujoco.mj_jacSite(scene.model, data, moving, turning, site)
        jacobian = rows.reshape(-1, scene.model.nv)[:, scene.model.jnt_dofadr[scene.hinges]]
        for way in range(len(jacobian)):
            action = jnp.zeros(len(jacobian)).at[way].set(1.0)
            twist = jacobian @ np.asarray(joint_increments(config, action, jnp.asarray(jacobian)))
            hand = twist[way // 6 * 6 :][:3]
            if way % 6 < 3:
                lost.append(1 - hand[way % 6] / config.shift)
            else:
                shifted.append(np.linalg.norm(hand))
    words = " ".join(PAGE.read_text().split())
    assert f"the hand moves {min(lost) * 100:.0f} to {max(lost) * 100:.0f} % less than `shift`" in words
    assert f"moves it by up to {max(shifted) * 1e3:.1f} mm" in words
