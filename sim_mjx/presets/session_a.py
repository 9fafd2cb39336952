"""Session A: the recorded successes 1 to 21, one nominal pose, set-points in the wrist's frame."""

from __future__ import annotations

import numpy as np

from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.task import ALWAYS, NEVER, NO_STOP, WRIST, TaskParams
from sim_mjx.presets.session import GateLimits, Range, SessionPreset, jr3_sensor

TASK = TaskParams(
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
    leave_wrist=np.array([0.1919, 0.1395, ALWAYS, NEVER]),
    leave_pitch=np.full(4, NEVER),
    mating_time=np.array(7.0),
    timeout=np.array(40.0),
    stop=np.array(NO_STOP),
    rest=np.array(0.0),
)
# Fitted to the session's signature, ring and onsets: soft feet, a mount of 6.7 N/mm.
PARTS = PartParams(
    tab_stiffness=np.array([8.61e3, 8.61e3, 4.0e3, 4.0e3]),
    tab_damping=np.full(4, 150.0),
    hook_overlap=np.array([0.506e-3, 0.358e-3, 0.671e-3, 0.246e-3]),
    slot_play=np.array(1.131e-3),
    seat_depth=np.array(2.736e-3),
    foot_spread=np.array(0.5e-3),
    foot_offset=np.array([-4.083e-3, 0.233e-3]),
    rear_rise=np.array([-0.5e-3, -1.207e-3]),
    foot_contact=np.array([0.01884, 0.696, 0.96, 2.2e-3]),
    friction=np.array(0.05),
    mount_stiffness=np.array([6.4e3, 10.08e3, 6.713e3]),
    mount_damping=np.array([10.0, 120.0, 52.1]),
    position=np.array([-1.95e-3, 1.937e-3, 1.1e-3]),
    roll=np.array(0.01017),
)
EQUAL = ("stiffness", "overlap", "friction", "mount", "gain", "goal", "speed", "tare")
# Only noise, a small drift of the bias and 0.04 mm (sd) of placement differ from trial to trial.
REPEATS: dict[str, Range] = dict.fromkeys(EQUAL, (1.0, 1.0)) | {
    "shift": (-7e-5, 7e-5), "turn": (-3e-4, 3e-4), "force_bias": (-0.06, 0.06), "moment_bias": (-0.003, 0.003),
}  # fmt: skip

SESSION_A = SessionPreset(
    name="A",
    task=TASK,
    parts=PARTS,
    sensor=jr3_sensor((-0.0463, 0.0014, -0.0019), (-0.023, -0.003, -0.023, -0.0006, 0.0008, -0.0001)),
    mating_begins=16.32,
    recorded_as="A",
    pose_lag=0,  # its angles are the encoders' readings, not commands
    repeats=REPEATS,
    pose_limits=(0.3, 0.1),
    gate=GateLimits(coverage=0.75, w1_over_sd=0.30, dtw_over_sd=0.20, auc=0.85),
)
