"""The state machine of the assembly: approach, rotation, insertion, (pre-)mating, end.

``advance`` is one control period of one trial: measured joints and wrench in, joint references out. Pure, no
loop; batches by ``jax.vmap``. Identified from the recorded joint references and state marks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.robots import kinematics
from sim_mjx.assembly.controllers import approach, force_law, goals_in_world

Array = Any
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

    home: Array  # [6] rad, joint angles at time zero
    way_time: Array  # [2] s, when the two waypoints are reached
    way_position: Array  # [2, 3] m, TCP
    way_rpy: Array  # [2, 3] rad
    contact_force: Array  # N, wrist-frame Fx that ends the approach
    contact_after: Array  # s, not before
    frame: Array  # 0 = set-points in the wrist frame, 1 = in the world frame
    force: Array  # [4, 3] N, set-point F*
    moment: Array  # [4, 3] Nm, set-point M*
    force_gain: Array  # rad/(Nm) per control period
    moment_gain: Array  # [4] rad/(Nm) per control period
    leave_after: Array  # [4] s, shortest stay in a phase
    leave_wrist: Array  # [4] rad, leave when joint 4 (wrist pitch) is below ...
    leave_pitch: Array  # [4] rad, ... or the hand's pitch is below
    leave_moment: Array  # [4] Nm, and the measured My is above
    mating_time: Array  # s, recorded after mating begins
    timeout: Array  # s, the trial ends unfinished
    stop: Array  # s, from then on the robot keeps still in whatever phase it is, and its logger goes on
    rest: Array  # s, recorded after mating, the robot keeping still


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TaskState:
    """State of one trial."""

    tick: Array  # int32, control periods since the start
    phase: Array  # int32, APPROACH ... ENDED
    entered: Array  # int32 [6], tick at which each phase began, -1 = not yet
    command: Array  # [6] rad, joint references


def start(params: TaskParams) -> TaskState:
    """State at time zero."""
    entered = jnp.array([0, -1, -1, -1, -1, -1], jnp.int32)
    return TaskState(jnp.int32(0), jnp.int32(APPROACH), entered, params.home)


def advance(params: TaskParams, state: TaskState, joints: Array, wrench: Array) -> TaskState:
    """One control period.

    Args:
        params: one trial's task.
        state: before the period.
        joints: measured angles [6], rad.
        wrench: measured and filtered [6], N and Nm, world frame.

    Returns:
        the state after it; ``command`` holds the new joint references. A stopped, resting or ended robot keeps still.
    """
    _, rotation, _ = kinematics.fk(joints)
    phase = jnp.where(_leaves(params, state, joints, rotation, wrench), state.phase + 1, state.phase)
    # pre-mating exists in the OpenHRP task only: elsewhere it would last no time
    phase = jnp.where((phase == PRE_MATING) & (params.leave_wrist[2] == jnp.inf), jnp.int32(MATING), phase)
    stopped = state.tick >= _periods(params.stop)
    phase = jnp.where(stopped, state.phase, phase)
    phase = jnp.where(state.tick >= _periods(params.timeout), jnp.int32(ENDED), phase)
    begun = (jnp.arange(6) == phase) & (state.entered < 0)
    entered = jnp.where(begun, state.tick, state.entered)
    resting = (state.phase == MATING) & (state.tick - state.entered[MATING] >= _periods(params.mating_time))
    still = stopped | resting | (phase == ENDED)
    command = jnp.where(still, state.command, _command(params, state, phase, wrench, rotation))
    return TaskState(state.tick + 1, phase, entered, command)


def _periods(seconds: Array) -> Array:
    """Whole control periods: times are compared as integers, because floats of them differ in the last digit."""
    return jnp.round(seconds / CONTROL_PERIOD).astype(jnp.int32)


def _leaves(params: TaskParams, state: TaskState, joints: Array, rotation: Array, wrench: Array) -> Array:
    """Whether the current phase ends with this measurement."""
    pushed = (rotation.T @ wrench[:3])[0] > params.contact_force
    contact = pushed & (state.tick > _periods(params.contact_after))
    row = jnp.clip(state.phase - ROTATION, 0, 3)
    since = state.tick - state.entered[state.phase]
    pitch = jnp.arcsin(jnp.clip(-rotation[2, 0], -1.0, 1.0))
    reached = (joints[4] < params.leave_wrist[row]) | (pitch < params.leave_pitch[row])
    reached = reached & (wrench[4] > params.leave_moment[row]) & (since >= _periods(params.leave_after[row]))
    over = since >= _periods(params.mating_time) + _periods(params.rest)
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


def onsets(entered: NDArray[np.integer]) -> NDArray[np.float64]:
    """Start of approach, rotation, insertion and mating [..., 4] in seconds; NaN for a state never reached.

    Args:
        entered: int [..., 6] of the final state, on the host; pre-mating counts as insertion.
    """
    marks = entered[..., [APPROACH, ROTATION, INSERTION, MATING]].astype(np.float64)
    return np.where(marks >= 0, marks * CONTROL_PERIOD, np.nan)
