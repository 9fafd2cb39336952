"""The compiled two-arm scene: male part in the right hand, female part on a springy mount in the left hand."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from sim_mjx.assembly import parts
from sim_mjx.assembly.parts import Fields, PartParams
from sim_mjx.assembly.robot import new_robot
from sim_mjx.assembly.scene import SUBSTEPS, Scene, compiled_arms, set_solver
from sim_mjx.assembly.two_arm_program import TWO_ARM

ARMS = ("R", "L")
# m, right wrist frame: the tips are 87 mm from the wrist and around the tool centre point; the point of the hand
# that stays within 0.6 mm from first touch to mating lies there, and the wrench's lever arm ends there
GRIP = (0.030, 0.0, -0.0225)
# m, left wrist frame: 1 mm out from where the recorded rear tips are when mating begins; the parts' position adds to it
FIRST_TOUCH = np.array([-0.0855, 0.002, -0.0440])
# mount's axes in the left wrist's frame: x forward, y up, z towards the right hand
TURN = np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
UNROLLED, ROLLED = np.zeros((2, 4))  # its quaternion, and that after half a turn about its own z axis
mujoco.mju_mat2Quat(UNROLLED, TURN.ravel())
mujoco.mju_mulQuat(ROLLED, UNROLLED, np.array([0.0, 0.0, 0.0, 1.0]))


def two_arm(substeps: int = SUBSTEPS, **solver: Any) -> Scene:
    """Both arms, male part in the right hand, female part in the left; arguments of ``scene.one_arm``."""
    spec = new_robot(ARMS)
    parts.add_male(spec, "R", GRIP)
    parts.add_female(spec, "R", spec.body("LARM_TOOL"), FIRST_TOUCH, UNROLLED)
    set_solver(spec, substeps, **solver)
    return compiled_arms(spec, TWO_ARM, ARMS, "LIP", model_fields, substeps)


def model_fields(model: mujoco.MjModel, params: PartParams) -> Fields:
    """Fields of the compiled model that hold these parameters; keys are MjModel attribute names.

    Args:
        model: of this scene.
        params: of one trial or a batch; ``position`` and ``roll`` are in the mount's axes, as in the one-arm scene.
    """
    out = parts.model_fields(model, params)
    for name in parts.TABS:
        out["geom_pos"][..., model.geom(f"RFOOT_{name}").id, :] += GRIP
    half = np.asarray(params.roll)[..., None] / 2
    mount = model.body("MOUNT").id
    out["body_pos"][..., mount, :] = FIRST_TOUCH + params.position @ TURN.T
    out["body_quat"][..., mount, :] = np.cos(half) * UNROLLED + np.sin(half) * ROLLED
    return out
