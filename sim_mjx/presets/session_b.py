"""Session B: the recorded successes 22 to 46, a trial per cell of a grid of offsets, set-points in the world frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.task import ALWAYS, NEVER, WORLD
from sim_mjx.presets import session_a
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
# Fitted to the session's signature, snaps and outcomes over its grid.
PARTS = PartParams(
    tab_stiffness=np.array([10.95e3, 10.95e3, 11.92e3, 11.92e3]),
    tab_damping=np.full(4, 88.95),
    hook_overlap=np.array([0.372e-3, 0.7132e-3, 0.9852e-3, 0.8226e-3]),
    slot_play=np.array(1.485e-3),
    seat_depth=np.array(2.635e-3),
    foot_spread=np.array(11.01e-3),
    foot_offset=np.array([-12.77e-3, -16.0e-3]),
    rear_rise=np.array([1.414e-3, 0.3481e-3]),
    foot_contact=np.array([0.01503, 0.95, 0.96, 0.3e-3]),
    friction=np.array(0.2841),
    mount_stiffness=np.array([8.174e3, 3.71e3, 4.535e3]),
    mount_damping=np.array([138.5, 120.0, 10.7]),
    position=np.array([0.8531e-3, -0.2595e-3, 1.106e-3]),
    roll=np.array(0.02),
)
# The coarse 3 x 3 grid first, so that the first trials represent all.
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
