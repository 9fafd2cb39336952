"""The recorded two-arm task as numbers, and the parts that go with it.

Waypoints are half-cosine fits to the recorded approach (0.02 mm rms after the first waypoint). Set-points and gains
come from the recorded joint increments, solved for the force and moment that the law must have seen: they follow
the logged wrench with slope 0.98 to 1.00 in the wrist's frame, and what remains is the set-point, equal in all 15
trials to 0.02 N and 0.01 Nm. Thresholds are the joint angles at which the recorded set-points change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from sim_mjx.assembly.sensor import SensorParams
from sim_mjx.assembly.task import NEVER
from sim_mjx.assembly.two_arm_program import HoldParams
from sim_mjx.presets import openhrp, session_a
from sim_mjx.presets.session import SessionPreset, openhrp_sensor

# share of the right arm's gains: the holding hand then stays within 1 mm of its place; with all of them, within 3 mm
HOLD_SHARE = 0.2
QUARTER = np.pi / 2
YAW = -1.17846  # rad, 22.5 degrees before the hand is straight
SIDEWAYS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # the part's y is the world's z, and the hand leans about it

# Of the right arm, with session A's law; in mating it keeps still, so that the last row has no effect.
TASK = replace(
    session_a.TASK,
    home=np.array([0.197087, 0.0622684, -1.66923, -1.29718, -0.180523, -0.0861625]),
    way_time=np.array([2.0, 5.0]),
    way_position=np.array([[0.33739, -0.04619, 0.55226], [0.34093, -0.02315, 0.55226]]),
    way_rpy=np.array([[QUARTER, 0.0, YAW], [QUARTER, 0.0, YAW]]),
    contact_force=np.array(0.55),  # recorded 2.4-2.9 N at the first moment at which it may count, 0.4 before
    contact_after=np.array(4.0),
    force=np.array([[6.5, -7.18, -13.85], [6.5, -7.0, -13.85], [11.5, -5.9, -12.1], [11.5, -5.9, -12.1]]),
    moment=np.array([[0.0, 60.0, 0.0], [0.0, 75.0, 0.0], [0.0, 80.0, 0.0], [0.0, 80.0, 0.0]]),
    moment_gain=np.full(4, 3.5e-6),
    leave_wrist=np.array([-0.03327, -0.1672, -0.23213, NEVER]),
    mating_time=np.array(0.57),
    timeout=np.array(20.0),
)
# As in the one-arm simulation but for what a black-box search on both arms' recorded signatures found.
PARTS = replace(
    openhrp.PARTS,
    tab_stiffness=np.array([2330.0, 2330.0, 3030.0, 3030.0]),
    hook_overlap=np.array([0.296e-3, 0.296e-3, 0.364e-3, 0.364e-3]),
    slot_play=np.array(1.706e-3),
    seat_depth=np.array(7.515e-3),
    foot_spread=np.array(11.3e-3),
    rear_rise=np.array([2.84e-3, 1.2e-3]),
    friction=np.array(0.263),
    mount_stiffness=np.array([873.0, 2300.0, 802.0]),  # the grip of the left hand, softer than a stand
    position=np.array([-0.1e-3, 0.0, 1.77e-3]),
    roll=np.array(0.0102),
)
# Of the left arm: along and about the hand's own axes what the recorded left wrist felt on average; nothing across.
HOLD = HoldParams(
    home=np.array([-0.23289, 0.0790619, -1.68294, 1.29484, -0.21605, 0.0938121]),
    force=np.array([[0.27, 0.0, 0.0], [0.99, 0.0, 0.0], [4.94, 0.0, 0.0], [1.35, 0.0, 0.0]]),
    moment=np.array([[0.0, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.65, 0.0], [0.0, 0.16, 0.0]]),
    force_gain=np.array(5e-5 * HOLD_SHARE),
    moment_gain=np.array(3.5e-6 * HOLD_SHARE),
)


@dataclass(frozen=True, kw_only=True)
class TwoArmPreset(SessionPreset):
    """What the left arm adds; task, parts and sensor are the right arm's."""

    hold: HoldParams
    left_sensor: SensorParams
    offset: Float64[np.ndarray, " 12"]  # N and Nm, what right and left wrist read in free space
    chatter: float  # standard deviation of the contact force from tick to tick, as a share of itself


TWO = TwoArmPreset(
    name="two",
    task=TASK,
    parts=PARTS,
    sensor=openhrp_sensor((-0.030, 0.0, -0.0177), tared=1.0),  # reference from the search that fitted the parts
    left_sensor=openhrp_sensor((-0.109, 0.0, -0.0748), tared=1.0),
    mating_begins=15.67,
    real=False,
    across=SIDEWAYS,
    turns=SIDEWAYS,
    hold=HOLD,
    # mean of the recorded approaches after the first waypoint; the recordings rise to it as fast as the filter
    offset=np.array([0.364, -0.438, -0.524, 0.0290, -0.0253, 0.0107, 0.103, 0.613, -0.698, -0.0171, -0.0247, -0.0173]),
    chatter=1.1,  # recorded wrenches taken back through the filter: sd / mean of Fx within 0.2 s, 1.0-1.5 under load
)
# The left arm keeps still, as in the recordings.
TWO_FIXED = replace(TWO, name="two-fixed", hold=replace(HOLD, force_gain=np.array(0.0), moment_gain=np.array(0.0)))
