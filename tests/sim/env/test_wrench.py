"""Sign, axes and point of the wrench, as the page of environments states them: against a load on C MuJoCo by hand."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest

from sim_mjx.assembly import sensor
from sim_mjx.engines import native
from sim_mjx.env.physics import sites_of
from sim_mjx.registry import get_scenario

FORCE, MOMENT = np.array([3.0, -2.0, 5.0]), np.array([0.1, 0.2, -0.3])  # N and Nm, world axes


@pytest.mark.parametrize(("name", "gain"), [("peg-in-hole@panda", 1.0), ("B", 1.1337)])
def test_a_load_on_the_part_is_logged_in_world_axes_with_its_own_sign(name: str, gain: float) -> None:
    scenario = get_scenario(name)
    scene = scenario.scene()
    params, _ = scenario.draw(0, 0, scenario.spec(nominal_share=1.0))
    model = native.model_of(scene, params.parts)
    data = mujoco.MjData(model)
    home = np.asarray(scene.program.home(params), np.float64)
    data.qpos[scene.joints] = data.ctrl[:] = home
    mujoco.mj_step(model, data, 400)
    (site,), readings = sites_of(scene), slice(scene.forces[0], scene.forces[0] + 6)
    state = sensor.begin(params.sensor, -data.sensordata[readings])
    body = model.site_bodyid[site]
    data.xfrc_applied[body] = [*FORCE, *MOMENT]  # at the body's centre of mass
    mujoco.mj_step(model, data, 2000)
    rotation = data.site_xmat[site].reshape(3, 3)
    read = jax.jit(sensor.read_exactly)
    for _ in range(400):
        state, logged = read(params.sensor, state, -data.sensordata[readings], rotation)
    point = data.site_xpos[site] + rotation @ params.sensor.reference
    expected = np.concatenate([FORCE, MOMENT + np.cross(data.xipos[body] - point, FORCE)])
    weight = (1 - params.sensor.tared) * 4.1  # N, of which the tare leaves a hundredth
    np.testing.assert_allclose((logged - params.sensor.bias)[:3], gain * expected[:3], atol=2e-3 + 2 * weight)
    np.testing.assert_allclose((logged - params.sensor.bias)[3:], gain * expected[3:], atol=2e-3)
