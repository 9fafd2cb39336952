"""One period of the two-arm trial: both sensors, the right arm's state machine, the left arm's force control.

Pure functions of one trial, batched by the engines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, UInt32

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array
from sim_mjx.assembly import sensor, task
from sim_mjx.assembly.controllers import Joints, Wrench, force_law
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.rollout import LogRow, Program
from sim_mjx.assembly.sensor import LONGEST_DELAY, SensorParams, SensorState
from sim_mjx.assembly.task import TaskParams, TaskState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HoldParams:
    """Force control of the left arm, which keeps its pose until the right hand touches, then yields to the force.

    Set-points are in its wrist frame and count from the free-space offset; one row per phase of the right arm:
    rotation, insertion, pre-mating, mating.
    """

    home: Float[Array, "*batch 6"]  # rad
    force: Float[Array, "*batch 4 3"]  # N, set-point
    moment: Float[Array, "*batch 4 3"]  # Nm, set-point
    force_gain: Float[Array, "*batch"]  # rad/(Nm) per control period; 0 = force control off
    moment_gain: Float[Array, "*batch"]  # rad/(Nm) per control period; 0 = force control off


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TwoArmParams:
    """All parameters of one two-arm trial; leaves of a batch have a leading trial axis."""

    task: TaskParams  # of the right arm
    hold: HoldParams  # of the left arm
    sensor: SensorParams  # of the right wrist
    left_sensor: SensorParams
    offset: Float[Array, "*batch 12"]  # N and Nm, what right and left wrist log in free space
    chatter: Float[Array, "*batch"]  # sd of the force between the parts from tick to tick, as a share of itself
    parts: PartParams
    command_delay: Int[Array, "*batch"]  # control periods between reference and servo, both arms
    seed: UInt32[Array, "*batch 2"]  # key of the sensors' noise


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TwoArmLoop:
    """State of the controller between control periods; ``delay`` is ``LONGEST_DELAY``."""

    task: TaskState
    sensor: SensorState
    left_sensor: SensorState
    rest: Float[Array, "*batch 12"]  # first readings
    commands: Float[Array, "*batch delay 12"]  # rad, joint references right and left, newest first


def begin(params: TwoArmParams, raw: Float[Array, " 12"]) -> TwoArmLoop:
    """Loop state before the first period; ``raw`` are the first readings, right and left wrist frame."""
    commands = jnp.broadcast_to(_home(params), (LONGEST_DELAY, 12))
    right, left = sensor.begin(params.sensor, raw[:6]), sensor.begin(params.left_sensor, raw[6:])
    return TwoArmLoop(task.start(params.task), right, left, raw, commands)


def control(
    params: TwoArmParams, loop: TwoArmLoop, joints: Float[Array, " 12"], raw: Float[Array, " 12"]
) -> tuple[TwoArmLoop, Float[Array, "2 12"], LogRow]:
    """One control period; see :func:`sim_mjx.assembly.rollout.control`. Wrenches are logged in the wrists' frames."""
    noise = jax.random.normal(jax.random.fold_in(params.seed, loop.task.tick), (13,), raw.dtype)
    identity = jnp.eye(3, dtype=raw.dtype)
    # the recorded rigid contact chatters, on both wrists at once; ours is elastic and does not
    rough = loop.rest + (raw - loop.rest) * (1.0 + params.chatter * noise[12])
    right_raw = _with_offset(params.sensor, rough[:6], params.offset[:6])
    left_raw = _with_offset(params.left_sensor, rough[6:], params.offset[6:])
    read, right = sensor.read(params.sensor, loop.sensor, right_raw, noise[:6], identity)
    left_read, left = sensor.read(params.left_sensor, loop.left_sensor, left_raw, noise[6:12], identity)
    state = task.advance(params.task, loop.task, joints[:6], _in_world(right, joints[:6], "R"))
    # recorded: once mating begins the right arm keeps still
    state = replace(state, command=jnp.where(state.phase == task.MATING, loop.task.command, state.command))
    before = loop.commands[0, 6:]
    held = hold(params.hold, before, joints[6:], left - params.offset[6:], state.phase)
    held = jnp.where(task.keeps_still(params.task, loop.task, state.phase), before, held)
    commands = jnp.concatenate([jnp.concatenate([state.command, held])[None], loop.commands[:-1]])
    between = jnp.stack([commands[params.command_delay + 1], commands[params.command_delay]])
    log = LogRow(jnp.concatenate([right, left]), joints, loop.task.phase)
    return TwoArmLoop(state, read, left_read, loop.rest, commands), between, log


def hold(params: HoldParams, command: Joints, joints: Joints, wrench: Wrench, phase: Int[Array, ""]) -> Joints:
    """One period of the left arm's force control.

    Args:
        params: of the left arm.
        command: its joint references, rad.
        joints: measured, rad.
        wrench: measured and filtered, N and Nm, left wrist frame, without the free-space offset.
        phase: of the right arm.

    Returns:
        the new references: unchanged before the right hand has touched and after the end.
    """
    _, rotation, _ = kinematics.fk(joints, "L")
    row = jnp.clip(phase - task.ROTATION, 0, 3)
    pressed = force_law(
        command,
        _in_world(wrench, joints, "L"),
        rotation @ params.force[row],
        rotation @ params.moment[row],
        params.force_gain,
        params.moment_gain,
        "L",
    )
    return jnp.where((phase >= task.ROTATION) & (phase < task.ENDED), pressed, command)


def _with_offset(params: SensorParams, raw: Array, offset: Array) -> Array:
    """Readings [6] with the free-space offset; the tare took place without it."""
    about_wrist = offset[3:] + jnp.cross(params.reference, offset[:3])
    return raw + jnp.concatenate([offset[:3], about_wrist])


def _in_world(wrench: Array, joints: Array, arm: str) -> Array:
    """A wrench [6] of the wrist frame in world axes."""
    _, rotation, _ = kinematics.fk(joints, arm)
    return jnp.concatenate([rotation @ wrench[:3], rotation @ wrench[3:]])


def _home(params: TwoArmParams) -> Array:
    xp = params.task.home.__array_namespace__()
    return xp.concat([params.task.home, params.hold.home], axis=-1)


TWO_ARM = Program(begin, control, _home, lambda params: params.task.timeout)
