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


def one_arm(substeps: int = SUBSTEPS, **solver: Any) -> Scene:
    """Right arm, male part in the hand, female part on its mount.

    Args:
        substeps: physics steps per control period of 5 ms.
        solver: settings of :func:`set_solver`.
    """
    spec = new_robot(("R",))
    parts.add_male(spec, "R")
    parts.add_female(spec, "R")
    set_solver(spec, substeps, **solver)
    return compiled_arms(spec, ONE_ARM, "R", "LIP", parts.model_fields, substeps)


def hooked(substeps: int = HOOK_SUBSTEPS, **solver: Any) -> Scene:
    """The same with hooks that catch; arguments of :func:`one_arm`."""
    spec = new_robot(("R",))
    hooked_parts.add_male(spec, "R")
    hooked_parts.add_female(spec, "R")
    set_solver(spec, substeps, **solver)
    scene = compiled_arms(spec, ONE_ARM, "R", "EDGE", hooked_parts.model_fields, substeps)
    return replace(scene, seated=hooked_parts.caught, past=0.0)


def compiled_arms(
    spec: mujoco.MjSpec, program: Program, arms: Sequence[str], lips: str, fields: Callable[..., Fields], substeps: int
) -> Scene:
    """The scene of HIRO's arms; ``lips`` begins the names of the geoms that mark the lips; see :func:`compiled`."""
    joints, forces = [f"{arm}ARM_JOINT{i}" for arm in arms for i in range(6)], [f"{arm}ARM_FORCE" for arm in arms]
    pairs = [(f"RTIP_{tab}", f"{lips}_{tab}") for tab in parts.TABS]
    return compiled(spec, program, joints, forces, pairs, fields, substeps)


def compiled(
    spec: mujoco.MjSpec,
    program: Program,
    joints: Sequence[str],
    forces: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    fields: Callable[..., Fields],
    substeps: int,
) -> Scene:
    """A scene of elements by their names, with sensors of the tips' places.

    Args:
        spec: of the scene. program: what runs between its physics steps.
        joints: of the robot. forces: force sensors of the wrists.
        pairs: geoms of tip and lip of each tab.
        fields: of the model, by model and parts. substeps: physics steps per control period.
    """
    geom = mujoco.mjtObj.mjOBJ_GEOM
    for number, (tip, lip) in enumerate(pairs):
        spec.add_sensor(
            name=f"PLACE_{number}", type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=geom, objname=tip, reftype=geom,
            refname=lip,
        )  # fmt: skip
    model = spec.compile()
    numbers = (
        [model.joint(name).qposadr[0] for name in joints],
        [model.sensor(name).adr[0] for name in forces],
        *([model.geom(name).id for name in names] for names in zip(*pairs, strict=True)),
        [model.sensor(f"PLACE_{number}").adr[0] for number in range(len(pairs))],
    )
    angles, sensors, tips, lips, places = (np.array(one, np.int32) for one in numbers)
    return Scene(model, program, angles, sensors, tips, lips, places, partial(fields, model), substeps)


def set_solver(
    spec: mujoco.MjSpec,
    substeps: int,
    iterations: int = ITERATIONS,
    ls_iterations: int = LS_ITERATIONS,
    impratio: float = IMPRATIO,
) -> None:
    """Time step and solver of every scene.

    Args:
        spec: of the scene.
        substeps: physics steps per control period of 5 ms.
        iterations: of the constraint solver. ls_iterations: of its line search.
        impratio: MuJoCo's ratio of frictional to normal impedance; the larger, the slower a resting contact
            creeps under a tangential force.
    """
    spec.option.timestep = CONTROL_PERIOD / substeps
    spec.option.iterations, spec.option.ls_iterations = iterations, ls_iterations
    spec.option.impratio = impratio
    # pyramids push a sliding contact apart: the raw wrench chattered by 5 N a step, now by 0.03 N
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
