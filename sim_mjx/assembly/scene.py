"""Scenes: the compiled model with the addresses and functions that a rollout needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Int, Int32

from rcbht_jax.types import Array
from sim_mjx.assembly import hooked_parts, parts
from sim_mjx.assembly.parts import Fields
from sim_mjx.assembly.robot import new_robot
from sim_mjx.assembly.rollout import ONE_ARM, Program
from sim_mjx.assembly.task import CONTROL_PERIOD

Ids = Int32[np.ndarray, " tab"]
SUBSTEPS = 2  # physics steps per control period
HOOK_SUBSTEPS = 8  # hooks let go within milliseconds: with 4, half the step moves the fall by 4 N at the median
ITERATIONS, LS_ITERATIONS = 30, 20  # the wrench is only right when the solver has converged; 10 was not enough
IMPRATIO = 1.0  # MuJoCo's own; the presets were fitted with it


@dataclass(frozen=True)
class Scene:
    """One compiled scene and all that an engine needs of it.

    The model holds nominal parts; each trial replaces some of its fields.
    """

    model: mujoco.MjModel
    program: Program
    joints: Int32[np.ndarray, " joint"]  # addresses in qpos
    forces: Int32[np.ndarray, " wrist"]  # of the wrists' forces in sensordata; each is followed by its torque
    tips: Int32[np.ndarray, " tab"]  # geoms; a tab is seated when its tip is past its lip
    lips: Int32[np.ndarray, " tab"]  # geoms: the lips, or marks at the lower ends of their edges
    places: Int32[np.ndarray, " tab"]  # of the tips' places in their lips' frames in sensordata, m
    fields: Callable[[Any], Fields]  # parts of a trial or a batch -> fields of the model
    substeps: int = SUBSTEPS
    seated: Callable[[Array], Array] = parts.past_lips  # tips' places in their lips' frames, m -> which are seated
    past: float = parts.PAST  # m, height of a tip above its lip beneath which it may be seated

    @property
    def hinges(self) -> Int[np.ndarray, " joint"]:
        """The robot's joints in the model."""
        return np.searchsorted(self.model.jnt_qposadr, self.joints)


def one_arm(
    substeps: int = SUBSTEPS,
    iterations: int = ITERATIONS,
    ls_iterations: int = LS_ITERATIONS,
    impratio: float = IMPRATIO,
) -> Scene:
    """Right arm, male part in the hand, female part on its mount.

    Args:
        substeps: physics steps per control period of 5 ms.
        iterations: of the constraint solver. ls_iterations: of its line search.
        impratio: MuJoCo's ratio of frictional to normal impedance; the larger, the slower a resting contact
            creeps under a tangential force.
    """
    spec = new_robot(("R",))
    parts.add_male(spec, "R")
    parts.add_female(spec, "R")
    set_solver(spec, substeps, iterations, ls_iterations, impratio)
    return _compiled(spec, "LIP_", parts.model_fields, substeps)


def hooked(
    substeps: int = HOOK_SUBSTEPS,
    iterations: int = ITERATIONS,
    ls_iterations: int = LS_ITERATIONS,
    impratio: float = IMPRATIO,
) -> Scene:
    """The same with hooks that catch; arguments of :func:`one_arm`."""
    spec = new_robot(("R",))
    hooked_parts.add_male(spec, "R")
    hooked_parts.add_female(spec, "R")
    set_solver(spec, substeps, iterations, ls_iterations, impratio)
    scene = _compiled(spec, "EDGE_", hooked_parts.model_fields, substeps)
    return replace(scene, seated=hooked_parts.caught, past=0.0)


def _compiled(spec: mujoco.MjSpec, lips: str, fields: Callable[..., Fields], substeps: int) -> Scene:
    """The scene of one arm; ``lips`` begins the names of the geoms that mark the lips."""
    model, tips, marks, places = with_tabs(spec, [(f"RTIP_{tab}", f"{lips}{tab}") for tab in parts.TABS])
    joints = np.array([model.joint(f"RARM_JOINT{i}").qposadr[0] for i in range(6)], np.int32)
    forces = np.array([model.sensor("RARM_FORCE").adr[0]], np.int32)
    return Scene(model, ONE_ARM, joints, forces, tips, marks, places, partial(fields, model), substeps)


def with_tabs(spec: mujoco.MjSpec, pairs: Sequence[tuple[str, str]]) -> tuple[mujoco.MjModel, Ids, Ids, Ids]:
    """The compiled model, with sensors of the tips' places.

    Args:
        spec: of the scene.
        pairs: names of the geoms of tip and lip of each tab.

    Returns:
        the model, and as in :class:`Scene` the tips, the lips and the addresses of the tips' places.
    """
    geom = mujoco.mjtObj.mjOBJ_GEOM
    for number, (tip, lip) in enumerate(pairs):
        spec.add_sensor(
            name=f"PLACE_{number}", type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=geom, objname=tip, reftype=geom,
            refname=lip,
        )  # fmt: skip
    model = spec.compile()
    tips, lips = (np.array([model.geom(pair[i]).id for pair in pairs], np.int32) for i in (0, 1))
    places = np.array([model.sensor(f"PLACE_{number}").adr[0] for number in range(len(pairs))], np.int32)
    return model, tips, lips, places


def set_solver(
    spec: mujoco.MjSpec, substeps: int, iterations: int, ls_iterations: int, impratio: float = IMPRATIO
) -> None:
    """Time step and solver of every scene; arguments as of :func:`one_arm`."""
    spec.option.timestep = CONTROL_PERIOD / substeps
    spec.option.iterations, spec.option.ls_iterations = iterations, ls_iterations
    spec.option.impratio = impratio
    # pyramids push a sliding contact apart: the raw wrench chattered by 5 N a step, now by 0.03 N
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
