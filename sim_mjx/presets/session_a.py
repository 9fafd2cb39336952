"""Session A: the recorded successes 1 to 21, one nominal pose, set-points in the wrist's frame."""

from __future__ import annotations

import numpy as np

from sim_mjx.assembly.task import ALWAYS, NEVER, NO_STOP, WRIST, TaskParams
from sim_mjx.presets.camera import on_stand
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
    leave_after=np.zeros(4),
    leave_wrist=np.array([0.1919, 0.1395, ALWAYS, NEVER]),
    leave_pitch=np.full(4, NEVER),
    leave_moment=np.full(4, NEVER),
    mating_time=np.array(7.0),
    timeout=np.array(40.0),
    stop=np.array(NO_STOP),
    rest=np.array(0.0),
)
PARTS = on_stand(
    mount_stiffness=(3914.0, 5718.0, 6481.0),
    mount_damping=(19.31, 200.2, 55.8),
    position=(-0.001123, 0.002345, 0.00137),
    roll=0.01158,
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
