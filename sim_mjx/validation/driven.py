"""The part pressed along a given path of the hand: the wrench is then a function of the parts alone.

A controller reacts to the measured force, so that a slightly softer part changes the whole trial. Here the joint
angles are given, for example as the encoders of a recorded trial had them: an arm a thousand times heavier and stiffer
than the real one follows them whatever it presses against. Every engine can run this ``Program``.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array
from sim_mjx.assembly import sensor
from sim_mjx.assembly.controllers import Joints, Wrench
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.rollout import LogRow, Program
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.sensor import SensorParams, SensorState
from sim_mjx.assembly.task import CONTROL_PERIOD, starts

HEAVIER = 1e3  # factor on the arm's own inertia and the servos' stiffness
DRIVEN, ENDED = 0, 1  # phases


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DrivenParams:
    """One trial; leaves of a batch have a leading trial axis. All trials of a batch have paths of one shape."""

    parts: PartParams
    sensor: SensorParams  # without its noise and quantisation
    path: Float[Array, "*batch time 6"]  # rad, joint angles
    periods: Int[Array, "*batch"]  # of the path that are simulated


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DrivenState:
    """State between control periods."""

    tick: Int[Array, "*batch"]
    sensor: SensorState


def begin(params: DrivenParams, raw: Wrench) -> DrivenState:
    """State before the first period."""
    return DrivenState(jnp.int32(0), sensor.begin(params.sensor, raw))


def control(
    params: DrivenParams, loop: DrivenState, joints: Joints, raw: Wrench
) -> tuple[DrivenState, Float[Array, "2 6"], LogRow]:
    """One control period; see :func:`sim_mjx.assembly.rollout.control`."""
    _, rotation, _ = kinematics.fk(joints)
    read, wrench = sensor.read_exactly(params.sensor, loop.sensor, raw, rotation)
    rows = jnp.minimum(loop.tick + jnp.arange(2, dtype=jnp.int32), params.periods - 1)
    phase = jnp.where(loop.tick < params.periods, DRIVEN, ENDED).astype(jnp.int32)
    return DrivenState(loop.tick + 1, read), params.path[rows], LogRow(wrench, joints, phase)


PROGRAM = Program(
    begin, control, lambda params: params.path[..., 0, :], lambda params: params.periods * CONTROL_PERIOD, ENDED, starts
)


def driven(scene: Scene, heavier: float = HEAVIER) -> Scene:
    """A scene of one arm whose hand follows its path whatever it meets.

    Args:
        scene: of one arm.
        heavier: factor on the arm's own inertia, stiffness and damping, so that it follows its servos as before.

    >>> from sim_mjx.assembly.scene import hooked
    >>> plain = hooked(4)
    >>> servo = int(np.flatnonzero(np.isin(plain.model.actuator_trnid[:, 0], plain.hinges))[0])
    >>> float((driven(plain).model.actuator_gainprm[servo, 0] / plain.model.actuator_gainprm[servo, 0]).round())
    1000.0
    """
    model, data = copy.copy(scene.model), mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(scene.model, data, mass)
    dofs = model.jnt_dofadr[scene.hinges]
    model.dof_armature[dofs] += (heavier - 1) * np.diag(mass)[dofs]
    servos = np.flatnonzero(np.isin(model.actuator_trnid[:, 0], scene.hinges))
    model.actuator_gainprm[servos] *= heavier
    model.actuator_biasprm[servos] *= heavier
    return replace(scene, model=model, program=PROGRAM)


def quicker_path(
    joints: Float[np.ndarray, "time 6"], begin: float, seconds: float, times: float
) -> Float64[np.ndarray, "period 6"]:
    """A segment of a path, resampled to be followed faster.

    Args:
        joints: rad, at control periods. begin: s, of the segment. seconds: its length, s.
        times: factor on the speed.

    >>> turning = np.linspace(0, 1, 101)[:, None] * np.ones(6)  # 0.5 s at control periods of 5 ms
    >>> quicker_path(turning, 0.1, 0.045, 2.0)[:, 0].round(2).tolist()
    [0.2, 0.22, 0.24, 0.26, 0.28]
    >>> [len(quicker_path(turning, begin, 0.05, 1.0)) for begin in (0.0, 0.1, 0.3)]
    [10, 10, 10]
    """
    periods = math.ceil(round(seconds / (CONTROL_PERIOD * times), 6))  # not one more where the quotient is rounded
    when = begin + np.arange(periods) * (CONTROL_PERIOD * times)
    time = np.arange(len(joints)) * CONTROL_PERIOD
    return np.stack([np.interp(when, time, column) for column in joints.T.astype(np.float64)], axis=1)
