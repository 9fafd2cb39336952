"""Scenes: the compiled model with what a rollout must know about it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim_mjx import parts
from sim_mjx.hiro import new_robot
from sim_mjx.presets import CONTROL_PERIOD

SUBSTEPS = 2  # physics steps per control period
ITERATIONS, LS_ITERATIONS = 30, 20  # the wrench is only right when the solver has converged; 10 was not enough


@dataclass(frozen=True)
class Scene:
    """One compiled scene; the model holds nominal parts, trials replace some of its fields."""

    model: mujoco.MjModel
    arm: str
    joints: NDArray[np.int32]  # [6] addresses in qpos
    tabs: NDArray[np.int32]  # [4] addresses in qpos
    force: int  # address of the wrist force in sensordata; the torque follows
    substeps: int = SUBSTEPS


def one_arm(substeps: int = SUBSTEPS, iterations: int = ITERATIONS, ls_iterations: int = LS_ITERATIONS) -> Scene:
    """Right arm, male part in the hand, female part on its mount.

    Args:
        substeps: physics steps per control period of 5 ms.
        iterations: of the constraint solver. ls_iterations: of its line search.
    """
    spec = new_robot(("R",))
    parts.add_male(spec, "R")
    parts.add_female(spec, "R")
    spec.option.timestep = CONTROL_PERIOD / substeps
    spec.option.iterations, spec.option.ls_iterations = iterations, ls_iterations
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model = spec.compile()
    for name, value in parts.model_fields(model, parts.nominal()).items():
        getattr(model, name)[:] = value
    joints = np.array([model.joint(f"RARM_JOINT{i}").qposadr[0] for i in range(6)], np.int32)
    tabs = np.array([model.joint(f"RTAB_{name}").qposadr[0] for name in parts.TABS], np.int32)
    return Scene(model, "R", joints, tabs, int(model.sensor("RARM_FORCE").adr[0]), substeps)
