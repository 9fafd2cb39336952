"""The four recorded ways of doing the assembly, as numbers: sessions A, B, C and the OpenHRP simulation.

Every value is one the authors' controller used or that was identified from its logs (design page "HIRO task",
"Controller / FSM facts"). All fields are arrays, so that a preset is a pytree whose leaves can be randomised.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import numpy as np

from rcbht_jax.errors import InputError

Array = Any
CONTROL_PERIOD = 0.005  # s, the robot's and the sensor's
STATES = ("approach", "rotation", "insertion", "mating")
WRIST, WORLD = 0.0, 1.0
NEVER, ALWAYS = -np.inf, np.inf
NO_STOP = 1e4  # s, longer than any trial


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


def _session_a() -> TaskParams:
    return TaskParams(
        home=np.array([0.12262, -0.13539, -1.89039, 0.2623, 0.72745, 0.0]),
        way_time=np.array([5.0, 7.5]),
        way_position=np.array([[0.310, -0.1696, 0.495], [0.330, -0.1696, 0.484]]),
        way_rpy=np.array([[0.0, -1.2784, 0.0], [0.0, -1.2784, 0.0]]),
        contact_force=np.array(1.0),
        contact_after=np.array(0.0),
        frame=np.array(WRIST),
        force=np.array([[10.0, 0.0, -5.0], [10.0, 0.0, -5.0], [10.0, 0.0, -5.0], [30.0, 0.0, -5.0]]),
        moment=np.array([[0.0, 60.0, 0.0], [0.0, 80.0, 0.0], [0.0, 80.0, 0.0], [0.0, 0.0, 0.0]]),
        force_gain=np.array(5e-5),
        moment_gain=np.array([3.5e-6, 3.5e-6, 3.5e-6, 3.5e-5]),
        leave_after=np.zeros(4),
        leave_wrist=np.array([0.1919, 0.1395, ALWAYS, NEVER]),
        leave_pitch=np.full(4, NEVER),
        leave_moment=np.full(4, NEVER),
        mating_time=np.array(7.0),
        timeout=np.array(40.0),
        stop=np.array(NO_STOP),
        rest=np.array(0.0),
    )


def _session_b() -> TaskParams:
    a = _session_a()
    return replace(
        a,
        way_time=np.array([3.5, 5.5]),
        way_position=np.array([[0.311, -0.1726, 0.495], [0.331, -0.1726, 0.484]]),
        way_rpy=np.array([[0.0, -1.2783, 0.0], [0.0, -1.2783, 0.0]]),
        frame=np.array(WORLD),
        force=np.array([[10.0, 0.0, 10.0]] * 3 + [[2.5, 0.0, 20.0]]),
        moment=np.array([[0.0, 80.0, 0.0]] * 3 + [[0.0, 0.0, 0.0]]),
        leave_wrist=np.array([ALWAYS, NEVER, ALWAYS, NEVER]),  # rotation lasts one control period
        leave_pitch=np.array([NEVER, -1.555, NEVER, NEVER]),
        mating_time=np.array(21.0),
        timeout=np.array(60.0),
    )


def _session_c() -> TaskParams:
    return replace(
        _session_b(),
        home=np.array([0.14927, -0.04706, -2.38255, 0.29617, 0.74984, 0.0736]),
        way_time=np.array([2.51, 4.5]),
        way_position=np.array([[0.315, -0.1716, 0.540], [0.335, -0.1716, 0.529]]),
        way_rpy=np.array([[0.0, -1.3782, 0.0], [0.0, -1.3782, 0.0]]),
        force=np.array([[5.0, 0.0, 10.0]] * 3 + [[2.5, 0.0, 40.0]]),
        mating_time=np.array(2.0),
    )


def _openhrp() -> TaskParams:
    return replace(
        _session_a(),
        home=np.array([0.0490, 0.0219, -2.0109, 0.2623, 0.5298, -0.0115]),
        way_time=np.array([2.51, 4.5]),
        way_position=np.array([[0.326, -0.1726, 0.536], [0.331, -0.1726, 0.531]]),
        way_rpy=np.array([[0.0, -1.3281, 0.0], [0.0, -1.3781, 0.0]]),
        contact_force=np.array(9.0),
        contact_after=np.array(0.8 * 4.5),
        force=np.array([[10.0, 0.0, -4.0], [13.0, 0.6, -3.25], [15.0, 0.0, 0.0], [15.0, 0.0, 0.0]]),
        moment=np.array([[0.0, 60.0, 0.0], [0.0, 75.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        moment_gain=np.array([3.5e-6, 3.5e-6, 3.5e-5, 3.5e-5]),
        leave_after=np.zeros(4),
        leave_wrist=np.array([0.4455, 0.385, 0.387, NEVER]),
        leave_pitch=np.array([NEVER, -1.552, -1.533, NEVER]),
        leave_moment=np.full(4, NEVER),  # the code's My > 0.9 Nm hangs on its rigid contact; recorded marks ignore it
        mating_time=np.array(1.0),
        timeout=np.array(20.0),
    )


PRESETS = {"A": _session_a, "B": _session_b, "C": _session_c, "openhrp": _openhrp}


def preset(name: str) -> TaskParams:
    """The task of one recorded session.

    Args:
        name: one of ``PRESETS``.

    Raises:
        InputError: unknown name.
    """
    if name not in PRESETS:
        raise InputError(f"There is no preset {name!r}; expected one of {', '.join(PRESETS)}.")
    return PRESETS[name]()


def stack(trials: list[TaskParams]) -> TaskParams:
    """One batch ``[trial, ...]`` of single tasks."""
    columns = {field.name: np.stack([getattr(trial, field.name) for trial in trials]) for field in fields(TaskParams)}
    return TaskParams(**columns)
