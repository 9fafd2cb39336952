"""The authors' one-arm simulation in OpenHRP: the same arm, rigid contact, an ideal sensor.

``openhrp`` is the preset of the results that name OpenHRP. ``rigid-openhrp`` has what that one lacks: contacts nearly
as hard as OpenHRP's, its sensor's reading without a load, and what its solver adds to the wrench of a contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.task import NEVER
from sim_mjx.presets import session_a
from sim_mjx.presets.session import GateLimits, SessionPreset, openhrp_sensor

TASK = replace(
    session_a.TASK,
    home=np.array([0.0490, 0.0219, -2.0109, 0.2623, 0.5298, -0.0115]),
    way_time=np.array([2.51, 4.5]),
    way_position=np.array([[0.326, -0.1726, 0.536], [0.331, -0.1726, 0.531]]),
    way_rpy=np.array([[0.0, -1.3281, 0.0], [0.0, -1.3781, 0.0]]),
    contact_force=np.array(9.0),
    contact_after=np.array(0.8 * 4.5),
    force=np.array([[10.0, 0.0, -4.0], [13.0, 0.6, -3.25], [15.0, 0.0, 0.0], [15.0, 0.0, 0.0]]),
    moment=np.array([[0.0, 60.0, 0.0], [0.0, 75.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    moment_gain=np.array([3.5e-6, 3.5e-6, 3.5e-5, 3.5e-5]),
    leave_wrist=np.array([0.4455, 0.385, 0.387, NEVER]),
    # the program also asks for My > 0.9 Nm, which needs rigid contact; recorded marks ignore it
    leave_pitch=np.array([NEVER, -1.552, -1.533, NEVER]),
    mating_time=np.array(1.0),
    timeout=np.array(20.0),
)
# Stiff parts with hardly a hook, as in the authors' rigid simulation.
PARTS = PartParams(
    tab_stiffness=np.full(4, 10.1e3),
    tab_damping=np.full(4, 80.0),
    hook_overlap=np.full(4, 0.3e-3),
    slot_play=np.array(1.9e-3),
    seat_depth=np.array(2.626e-3),
    foot_spread=np.array(2e-3),
    foot_offset=np.zeros(2),
    rear_rise=np.zeros(2),
    foot_contact=np.array([0.005, 0.95, 0.99, 0.0005]),
    friction=np.array(0.216),
    mount_stiffness=np.array([4e3, 7.75e3, 8.38e3]),
    mount_damping=np.array([120.0, 120.0, 98.5]),
    position=np.array([0.004, 0.0, 0.0492]),
    roll=np.array(0.0079),
)

OPENHRP = SessionPreset(
    name="openhrp",
    task=TASK,
    parts=PARTS,
    # M = r x F during session A's early rotation (R^2 of My 0.998), r from the kinematic pivot
    sensor=openhrp_sensor((-0.0484, -0.0003, -0.001)),
    mating_begins=9.34,
    real=False,
    recorded_as="SIM1",
    pose_limits=(0.01, 0.002),
    gate=GateLimits(coverage=0.70, w1_over_sd=0.60, dtw_over_sd=0.35, auc=0.90),
)

# Its simulated body has the last joint elsewhere than its controller (by 29.6 and 12 mm): moments refer to that place.
REFERENCE = (-0.078, -0.0003, -0.013)
# Of the recorded wrenches in the wrist's frame, before the filter: what they have beyond the weight of our tool in free
# space, the same in all trials to 0.01 N, and, from half a second after the first touch, a Cholesky factor of the
# covariance: median deviations of trials and states, mean correlations.
OFFSET = np.array([2.7559, -0.0188, -1.6418, 0.0043, -0.1388, -0.0037])
JITTER = np.array([
    [6.356, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.118, 4.009, 0.0, 0.0, 0.0, 0.0],
    [-2.225, 5.024, 9.793, 0.0, 0.0, 0.0],
    [0.021, -0.063, 0.019, 0.19, 0.0, 0.0],
    [1.129, -0.217, -0.301, -0.009, 0.628, 0.0],
    [-0.022, 0.385, -0.013, 0.137, -0.018, 0.14],
])  # fmt: skip
RIGID = replace(
    OPENHRP,
    name="rigid-openhrp",
    sensor=replace(openhrp_sensor(REFERENCE), offset=OFFSET, jitter=JITTER),
    # from "rcbht fidelity fit --session rigid-openhrp --outcomes", see docs/measurements/simulated_sessions.md
    parts=PartParams(
        tab_stiffness=np.full(4, 2464.0),
        tab_damping=np.full(4, 80.0),
        hook_overlap=np.array([0.5533e-3, 0.5533e-3, 0.3231e-3, 0.3231e-3]),
        slot_play=np.array(2.203e-3),
        seat_depth=np.array(3.985e-3),
        foot_spread=np.array(3.32e-3),
        foot_offset=np.array([-7.332e-3, -4.72e-3]),
        rear_rise=np.array([0.4687e-3, -2.474e-3]),
        foot_contact=np.array([0.0186, 0.95, 0.99, 0.0005]),
        friction=np.array(0.5806),
        mount_stiffness=np.array([4.615e3, 56.5e3, 14.71e3]),
        mount_damping=np.array([209.2, 29.2, 280.5]),
        position=np.array([0.01241, -4.841e-3, 0.049196]),
        roll=np.array(0.02541),
    ),
)
