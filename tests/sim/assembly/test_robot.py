"""HIRO's model: mirrored arms, weight at the wrist sensor, servos that follow."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.robots import hiro, kinematics
from sim_mjx.assembly import robot
from sim_mjx.assembly.controllers import approach
from sim_mjx.presets import preset

TICK = 0.005


def home(session: str = "A") -> np.ndarray:
    return np.asarray(preset(session).task.home, float)


def simulate_approach(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles and sensor readings [ticks, 6] of session A's approach at a physics step (s)."""
    spec = robot.new_robot()
    spec.option.timestep = step
    model = spec.compile()
    data = mujoco.MjData(model)
    command = commanded(np.arange(0, 8, TICK))
    data.qpos[:] = command[0]
    mujoco.mj_forward(model, data)
    angles, readings = [], []
    for row in command:
        angles.append(data.qpos.copy())
        readings.append(data.sensordata.copy())
        data.ctrl[:] = row
        mujoco.mj_step(model, data, nstep=round(TICK / step))
    return np.array(angles), np.array(readings)


def commanded(t: np.ndarray) -> np.ndarray:
    task = preset("A").task
    return approach(home(), task.way_time, task.way_position, task.way_rpy, t)


def test_left_arm_mirrors_the_right_in_mass_and_motion() -> None:
    model = robot.new_robot(("R", "L")).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    q, v, a = rng.uniform(-1, 1, (3, 6))
    for field, value in ((data.qpos, q), (data.qvel, v), (data.qacc, a)):
        field[:6], field[6:] = value, value * hiro.MIRROR
    mujoco.mj_inverse(model, data)
    # Torques of the mirrored motion: Coriolis, inertia and weight all enter.
    np.testing.assert_allclose(data.qfrc_inverse[6:], data.qfrc_inverse[:6] * hiro.MIRROR, atol=1e-10)
    assert np.abs(data.qfrc_inverse[:6]).min() > 1e-4
    ranges = model.jnt_range
    np.testing.assert_allclose(ranges[:6], np.deg2rad([link.limits for link in hiro.RIGHT]))
    np.testing.assert_allclose(ranges[9], np.deg2rad([-105, 165]))


def test_rotor_inertia_seen_through_the_gears() -> None:
    model = robot.new_robot().compile()
    np.testing.assert_allclose(model.dof_armature, [0.112, 0.168, 0.060, 0.0037, 0.015, 0.0076], rtol=0.02)


@pytest.mark.parametrize("arm", ["R", "L"])
def test_sensor_carries_the_tool_and_nothing_else(arm: str) -> None:
    model = robot.new_robot((arm,)).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = home() if arm == "R" else home() * hiro.MIRROR
    data.ctrl[:] = data.qpos
    mujoco.mj_step(model, data, nstep=500)
    turn = data.site(f"{arm}ARM_FT").xmat.reshape(3, 3)
    weight = np.array([0.0, 0.0, robot.TOOL_MASS * 9.81])
    com = np.array(robot.TOOL_COM) * [1, 1 if arm == "R" else -1, 1]
    np.testing.assert_allclose(turn @ data.sensor(f"{arm}ARM_FORCE").data, weight, atol=1e-6)
    np.testing.assert_allclose(turn @ data.sensor(f"{arm}ARM_TORQUE").data, np.cross(turn @ com, weight), atol=1e-6)
    # Under the servos hangs the tool alone: gravity is on, but the arm carries itself.
    linear, angular = kinematics.jacobian(data.qpos.copy(), arm)
    sag = -(linear.T @ weight + angular.T @ np.cross(turn @ com, weight)) / robot.KP
    np.testing.assert_allclose(data.qpos - data.ctrl, sag, atol=1e-8)


@pytest.mark.parametrize("step", [0.001, 0.0025, 0.005])
def test_servos_follow_the_approach(step: float) -> None:
    angles, readings = simulate_approach(step)
    assert np.isfinite(readings).all()
    t = np.arange(0, 8, TICK)
    lags = np.arange(0, 0.012, 0.0005)
    errors = [np.sqrt(((commanded(t - lag) - angles) ** 2).mean()) for lag in lags]
    # Half the control period for the hold and 2.5 ms of the servo, less the integrator's lead at long steps.
    assert 0.0024 < lags[np.argmin(errors)] < 0.0056
    assert min(errors) < 5e-5
    np.testing.assert_allclose(angles[-1], commanded(t)[-1], atol=5e-5)


def test_tool_body_takes_a_part() -> None:
    spec = robot.new_robot()
    spec.body("RARM_TOOL").add_geom(name="tip", size=(0.005, 0, 0), pos=hiro.RIGHT_TCP)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = home()
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.geom("tip").xpos, kinematics.fk(home())[2], atol=1e-12)
    visual = np.arange(model.ngeom) != model.geom("tip").id
    assert not model.geom_contype[visual].any()
    assert not model.geom_conaffinity[visual].any()


def test_bad_robots_are_refused() -> None:
    with pytest.raises(InputError, match='expected "R" or "L"'):
        robot.new_robot(("X",))
