"""The state machine of the assembly: approach, rotation, insertion, (pre-)mating, end.

``advance`` is one control period of one trial: measured joints and wrench in, joint references out. Pure, no
loop; batches by ``jax.vmap``. Identified from the recorded joint references and state marks.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float64, Int

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array
from sim_mjx.assembly.controllers import Joints, Wrench, approach, force_law, goals_in_world

CONTROL_PERIOD = 0.005  # s, the robot's and the sensor's
STATES = ("approach", "rotation", "insertion", "mating")
WRIST, WORLD = 0.0, 1.0  # frames of set-points
NEVER, ALWAYS = -np.inf, np.inf  # thresholds that never or always end a phase
NO_STOP = 1e4  # s, longer than any trial
APPROACH, ROTATION, INSERTION, PRE_MATING, MATING, ENDED = range(6)  # phases


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TaskParams:
    """What the controller does, from the home pose to the end of mating.

    Set-points and gains have one row per force-controlled phase: rotation, insertion, pre-mating, mating. The
    recorded state marks name approach, rotation, insertion, mating; pre-mating counts as insertion.
    """

    home: Float[Array, "*batch 6"]  # rad, joint angles at time zero
    way_time: Float[Array, "*batch 2"]  # s, when the two waypoints are reached
    way_position: Float[Array, "*batch 2 3"]  # m, TCP
    way_rpy: Float[Array, "*batch 2 3"]  # rad
    contact_force: Float[Array, "*batch"]  # N, wrist-frame Fx that ends the approach
    contact_after: Float[Array, "*batch"]  # s, not before
    frame: Float[Array, "*batch"]  # 0 = set-points in the wrist frame, 1 = in the world frame
    force: Float[Array, "*batch 4 3"]  # N, set-point F*
    moment: Float[Array, "*batch 4 3"]  # Nm, set-point M*
    force_gain: Float[Array, "*batch"]  # rad/(Nm) per control period
    moment_gain: Float[Array, "*batch 4"]  # rad/(Nm) per control period
    leave_wrist: Float[Array, "*batch 4"]  # rad, leave a phase when joint 4 (wrist pitch) is below ...
    leave_pitch: Float[Array, "*batch 4"]  # rad, ... or the hand's pitch is below
    mating_time: Float[Array, "*batch"]  # s, recorded after mating begins
    timeout: Float[Array, "*batch"]  # s, after which an unfinished trial ends
    stop: Float[Array, "*batch"]  # s, from then on the robot keeps still in any phase, and its logger goes on
    rest: Float[Array, "*batch"]  # s, recorded after mating, the robot keeping still


def horizontal(offset: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 3"]:
    """An offset in the plane, m, as one in space.

    >>> horizontal(np.array([1e-3, -2e-3])).tolist()
    [0.001, -0.002, 0.0]
    """
    return np.concatenate([offset, np.zeros((*offset.shape[:-1], 1))], axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TaskState:
    """State of one trial."""

    tick: Int[Array, "*batch"]  # control periods since the start
    phase: Int[Array, "*batch"]  # APPROACH ... ENDED
    entered: Int[Array, "*batch 6"]  # tick at which each phase began, -1 = not yet
    command: Float[Array, "*batch 6"]  # rad, joint references


def start(params: TaskParams) -> TaskState:
    """State at time zero."""
    entered = jnp.array([0, -1, -1, -1, -1, -1], jnp.int32)
    return TaskState(jnp.int32(0), jnp.int32(APPROACH), entered, params.home)


def advance(params: TaskParams, state: TaskState, joints: Joints, wrench: Wrench) -> TaskState:
    """One control period.

    Args:
        params: one trial's task.
        state: before the period.
        joints: measured angles, rad.
        wrench: measured and filtered, N and Nm, world frame.

    Returns:
        the state after it; ``command`` holds the new joint references. A stopped, resting or ended robot keeps still.
    """
    _, rotation, _ = kinematics.fk(joints)
    phase = jnp.where(_leaves(params, state, joints, rotation, wrench), state.phase + 1, state.phase)
    # pre-mating exists in the OpenHRP task only: elsewhere it would last no time
    phase = jnp.where((phase == PRE_MATING) & (params.leave_wrist[2] == jnp.inf), jnp.int32(MATING), phase)
    phase = jnp.where(state.tick >= periods(params.stop), state.phase, phase)
    phase = jnp.where(state.tick >= periods(params.timeout), jnp.int32(ENDED), phase)
    begun = (jnp.arange(6) == phase) & (state.entered < 0)
    entered = jnp.where(begun, state.tick, state.entered)
    still = keeps_still(params, state, phase)
    command = jnp.where(still, state.command, _command(params, state, phase, wrench, rotation))
    return TaskState(state.tick + 1, phase, entered, command)


def keeps_still(params: TaskParams, state: TaskState, phase: Array) -> Array:
    """Whether the robot is stopped, rests after mating, or has ended.

    Args:
        params, state: as of :func:`advance`. phase: after the period.
    """
    resting = (state.phase == MATING) & (state.tick - state.entered[MATING] >= periods(params.mating_time))
    return (state.tick >= periods(params.stop)) | resting | (phase == ENDED)


def periods(seconds: Array) -> Array:
    """Whole control periods: times are compared as integers, because floats of them differ in the last digit."""
    return jnp.round(seconds / CONTROL_PERIOD).astype(jnp.int32)


def _leaves(params: TaskParams, state: TaskState, joints: Array, rotation: Array, wrench: Array) -> Array:
    """Whether the current phase ends with this measurement."""
    pushed = (rotation.T @ wrench[:3])[0] > params.contact_force
    contact = pushed & (state.tick > periods(params.contact_after))
    row = jnp.clip(state.phase - ROTATION, 0, 3)
    since = state.tick - state.entered[state.phase]
    pitch = jnp.arcsin(jnp.clip(-rotation[2, 0], -1.0, 1.0))
    reached = (joints[4] < params.leave_wrist[row]) | (pitch < params.leave_pitch[row])
    over = since >= periods(params.mating_time) + periods(params.rest)
    by_phase = jnp.where(state.phase == MATING, over, reached)
    return jnp.where(state.phase == APPROACH, contact, by_phase & (state.phase < ENDED))


def _command(params: TaskParams, state: TaskState, phase: Array, wrench: Array, rotation: Array) -> Array:
    soon = (state.tick + 1).astype(wrench.dtype) * CONTROL_PERIOD
    planned = approach(params.home, params.way_time, params.way_position, params.way_rpy, soon)
    row = jnp.clip(phase - ROTATION, 0, 3)
    in_world = params.frame == WORLD
    pressed = force_law(
        state.command,
        wrench,
        goals_in_world(params.force[row], rotation, in_world),
        goals_in_world(params.moment[row], rotation, in_world),
        params.force_gain,
        params.moment_gain[row],
    )
    return jnp.where(phase == APPROACH, planned, pressed)


def onsets(entered: Int[np.ndarray, "*batch phase"]) -> Float64[np.ndarray, "*batch 4"]:
    """Start of approach, rotation, insertion and mating in seconds, of which pre-mating is a part of insertion.

    Args:
        entered: as of :func:`starts`.
    """
    return starts(entered[..., [APPROACH, ROTATION, INSERTION, MATING]])


def starts(entered: Int[np.ndarray, "*batch phase"]) -> Float64[np.ndarray, "*batch phase"]:
    """Starts of phases in seconds; NaN for a phase never reached.

    Args:
        entered: control periods at which the phases began, on the host, -1 = never.
    """
    return np.where(entered >= 0, entered * CONTROL_PERIOD, np.nan)
