"""Session B: the recorded successes 22 to 46, a trial per cell of a grid of offsets, set-points in the world frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.task import ALWAYS, NEVER, WORLD
from sim_mjx.presets import session_a
from sim_mjx.presets.camera import on_stand
from sim_mjx.presets.session import GateLimits, SessionPreset, jr3_sensor

TASK = replace(
    session_a.TASK,
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
PARTS = on_stand(
    mount_stiffness=(4139.0, 3184.0, 8139.0),
    mount_damping=(127.2, 39.65, 200.0),
    position=(0.000174, -0.001641, 0.00275),
    roll=0.01435,
)
# The coarse 3 x 3 grid first, so that the first trials stand for all.
COARSE = tuple((dx, dy) for dx in (0, 2, -2) for dy in (0, 2, -2))
FINE = tuple((dx, dy) for dx in (0, 1, 2, -1, -2) for dy in (0, 1, 2, -1, -2) if (dx, dy) not in COARSE)
REFERENCE = (-0.0491, -0.0007, -0.0014)  # m, of the sensor; from the search that fitted the parts

SESSION_B = SessionPreset(
    name="B",
    task=TASK,
    parts=PARTS,
    sensor=jr3_sensor(REFERENCE, (-0.314, -0.411, -0.059, -0.0198, 0.0061, -0.0021)),
    mating_begins=11.74,
    recorded_as="B",
    placements=COARSE + FINE,
    off_seat=frozenset({(0, -2), (1, -2), (2, -2), (-1, -2), (-2, -2), (-1, 2), (-2, 2)}),
    repeats={"shift": (0.0, 0.0), "turn": (0.0, 0.0), "force_bias": (-0.18, 0.18), "moment_bias": (-0.004, 0.004)},
    pose_limits=(0.01, 0.002),
    gate=GateLimits(coverage=0.86, w1_over_sd=0.33, dtw_over_sd=0.29, auc=0.80),
)
