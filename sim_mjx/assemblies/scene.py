"""The scene of an assembly on an arm: male part in the hand, female part on a compliant mount."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64

from rcbht_jax.errors import InputError
from sim_mjx.assemblies.assembly import Assembly, Parts
from sim_mjx.assemblies.fields import FieldWriter
from sim_mjx.assemblies.program import UPRIGHT, Controller
from sim_mjx.assembly.parts import MOUNT, MOUNT_MASS, Fields, add_mount, placed
from sim_mjx.assembly.scene import Scene, compiled, set_solver
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.own_code import own_code
from sim_mjx.robots.chain import serial_chain
from sim_mjx.robots.robot import FORCE, HAND, Robot, equipped

MALE, TIP = "MALE", "TIP"  # body of the male part, site at its tip
MOUNT_DAMPING = 0.7  # share of critical damping
SEARCH_STEPS, STEP, CLOSE = 500, 0.2, 1e-6  # of the search for home; most rad per step; m and rad
HOLD, HELD = 80, 1e-3  # control periods in which the tip must stay at home; m


def scene(assembly: Assembly, robot: Robot, substeps: int = 0, **solver: Any) -> Scene:
    """The scene of an assembly on an arm.

    Args:
        assembly: the parts and their controller. robot: the arm.
        substeps: physics steps per control period of 5 ms; 0 = the assembly's own.
        solver: settings of ``sim_mjx.assembly.scene.set_solver``.

    Raises:
        InputError: MuJoCo cannot make a model of robot and parts, or a mark is missing.
    """
    steps = substeps or assembly.substeps
    spec, _ = _compiled(assembly, robot)
    set_solver(spec, steps, **solver)
    for name in (name for pair in assembly.marks for name in pair):
        if spec.geom(name) is None:
            raise InputError(f"The assembly has no geom {name!r}, which its marks name.")
    program, fields = controller(assembly, robot).program(), partial(_fields, assembly, np.asarray(robot.place))
    with _compiling(assembly, robot):
        made = compiled(spec, program, robot.joints, (FORCE,), assembly.marks, fields, steps)
    # MuJoCo would skip place and turn of a geom compiled in its body's frame, which a trial may change
    made.model.geom_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return replace(made, seated=assembly.seated, past=0.0)


def _compiled(assembly: Assembly, robot: Robot) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The scene's elements, and the model that they make."""
    with _compiling(assembly, robot):
        spec = _elements(assembly, robot)
        model = spec.compile()
    if model.nu != len(robot.joints):
        own = [actuator.name for actuator in spec.actuators][len(robot.joints) :]
        raise InputError(f"{assembly.name} adds the actuator {own[0]!r}, which nothing commands; use springs instead.")
    return spec, model


@contextmanager
def _compiling(assembly: Assembly, robot: Robot) -> Iterator[None]:
    try:
        yield
    except InputError:
        raise
    except (ValueError, AttributeError, TypeError, KeyError) as error:  # of MuJoCo, or of the functions that call it
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise InputError(f"MuJoCo cannot compile {assembly.name} on {robot.name}: {reason.rstrip('.')}.") from error
    except Exception:
        with own_code(f"male or female of {assembly.name}"):
            raise


def _elements(assembly: Assembly, robot: Robot) -> mujoco.MjSpec:
    spec = equipped(robot)
    spec.compiler.fusestatic = False  # a trial turns the male part in the hand, which is then a body of its own
    hand = spec.body(HAND)
    hand.add_site(name=TIP, pos=(0.0, 0.0, assembly.reach))
    # the hand points down, the parts' z axis up
    assembly.male(spec, hand.add_body(name=MALE, pos=(0.0, 0.0, assembly.reach), quat=(0.0, 1.0, 0.0, 0.0)))
    assembly.female(spec, add_mount(spec.worldbody, robot.place))
    return spec


def _fields(assembly: Assembly, place: Float64[np.ndarray, " 3"], model: mujoco.MjModel, parts: Parts) -> Fields:
    mount = parts.mount
    writer = FieldWriter(model, np.shape(mount.turn))
    half = np.asarray(mount.turn) / 2
    writer.body(MOUNT, place + mount.position, placed(np.cos(half), 0.0, 0.0, np.sin(half)))
    grip = np.asarray(parts.grip)
    writer.body(MALE, np.broadcast_to(writer.nominal("body_pos", "body", MALE), grip.shape), _held(grip))
    for axis, name in enumerate("XYZ"):
        stiffness = np.asarray(mount.stiffness)[..., axis]
        writer.spring(f"{MOUNT}_{name}", stiffness, 2 * MOUNT_DAMPING * np.sqrt(stiffness * MOUNT_MASS))
    writer.friction(mount.friction)
    with own_code(f"write of {assembly.name}"):
        assembly.write(writer, parts.own)
    if endless := [name for name, values in writer.fields.items() if not np.isfinite(values).all()]:
        raise InputError(f"write of {assembly.name} gives a {endless[0]} that is not finite; expected finite numbers.")
    return writer.fields


def _held(turn: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """Quaternion of the male part in the hand, which is upright: half a turn about x, after the part's own turn."""
    angle = np.linalg.norm(turn, axis=-1)
    w, (x, y, z) = np.cos(angle / 2), np.moveaxis(turn * np.sinc(angle / (2 * np.pi))[..., None] / 2, -1, 0)
    return np.stack([-x, w, -z, y], -1)


@cache
def controller(assembly: Assembly, robot: Robot) -> Controller:
    """The controller, the same object for every scene, so that engines compile it once."""
    chain = serial_chain(_compiled(assembly, robot)[1], TIP)
    return Controller(assembly, chain, np.asarray(robot.place, np.float32))


@cache
def home(assembly: Assembly, robot: Robot) -> tuple[float, ...]:
    """Joint angles at time zero, rad: the tip upright above the mouth, by a search from the robot's home.

    Raises:
        InputError: the arm does not get there within its limits, or does not stay there.
    """
    _, model = _compiled(assembly, robot)
    data, site = mujoco.MjData(model), model.site(TIP).id
    rows = [model.joint(name).qposadr[0] for name in robot.joints]
    dofs = [model.joint(name).dofadr[0] for name in robot.joints]
    goal = np.asarray(robot.place) + np.array([0.0, 0.0, assembly.start])
    data.qpos[rows] = robot.home
    linear, angular, turn, quat = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.zeros(3), np.zeros(4)
    for _ in range(SEARCH_STEPS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, linear, angular, site)
        mujoco.mju_mat2Quat(quat, (UPRIGHT.astype(float) @ data.site_xmat[site].reshape(3, 3).T).ravel())
        mujoco.mju_quat2Vel(turn, quat, 1.0)
        left = np.concatenate([goal - data.site_xpos[site], turn])
        if np.abs(left).max() < CLOSE:
            break
        matrix = np.concatenate([linear, angular])[:, dofs]
        step = matrix.T @ np.linalg.solve(matrix @ matrix.T + 1e-4 * np.eye(6), left)
        data.qpos[rows] += step * (STEP / max(np.abs(step).max(), STEP))
    away, turned = np.linalg.norm(left[:3]), np.linalg.norm(left[3:])
    angles = tuple(float(angle) for angle in data.qpos[rows])
    where = f"it stays {away * 1e3:.3g} mm and {turned:.3g} rad away" if np.abs(left).max() >= CLOSE else ""
    if where := where or _beyond_limits(model, robot, angles):
        raise InputError(
            f"The robot {robot.name} does not reach the start of {assembly.name}, {assembly.start * 1e3:g} mm above "
            f"{robot.place}, with the wrist's z axis down and its x axis along the world's: {where}; choose another "
            "home, place or site."
        )
    model.opt.gravity[:], data.ctrl[:] = 0.0, angles  # the load of the hand bends any servo
    model.opt.timestep = CONTROL_PERIOD / assembly.substeps  # at longer ones stiff springs may be unstable
    mujoco.mj_step(model, data, HOLD * assembly.substeps)
    mujoco.mj_kinematics(model, data)
    if not (pulled := np.linalg.norm(data.site_xpos[site] - goal)) < HELD:
        raise InputError(
            f"The robot {robot.name} does not stay at the start of {assembly.name}: the model moves the wrist by "
            f"{pulled * 1e3:.3g} mm, as constraints on its joints, limits of tendons or springs of the parts do."
        )
    return angles


def _beyond_limits(model: mujoco.MjModel, robot: Robot, angles: tuple[float, ...]) -> str:
    for name, angle in zip(robot.joints, angles, strict=True):
        low, high = model.joint(name).range
        if model.joint(name).limited and not low <= angle <= high:
            return f"{name} would be at {angle:.3g} rad, beyond its limits of {low:.3g} to {high:.3g}"
    return ""
