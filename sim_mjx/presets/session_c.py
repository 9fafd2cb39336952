"""Session C: the recorded failures; session B's task from another home pose, with the stand higher up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_mjx.presets import session_b
from sim_mjx.presets.session import GateLimits, SessionPreset, jr3_sensor

TASK = replace(
    session_b.TASK,
    home=np.array([0.14927, -0.04706, -2.38255, 0.29617, 0.74984, 0.0736]),
    way_time=np.array([2.51, 4.5]),
    way_position=np.array([[0.315, -0.1716, 0.540], [0.335, -0.1716, 0.529]]),
    way_rpy=np.array([[0.0, -1.3782, 0.0], [0.0, -1.3782, 0.0]]),
    force=np.array([[5.0, 0.0, 10.0]] * 3 + [[2.5, 0.0, 40.0]]),
    mating_time=np.array(2.0),
)

SESSION_C = SessionPreset(
    name="C",
    task=TASK,
    # where the parts stood: from the height of first touch and its onset
    parts=replace(session_b.PARTS, position=session_b.PARTS.position + np.array([0.001, 0.0, 0.0486])),
    sensor=jr3_sensor(session_b.REFERENCE, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    mating_begins=7.98,
    recorded_as="C",
    last_joint_offset=0.531117,  # 30.43 degrees, at which the tool was mounted
    pose_limits=(0.01, 0.002),
    gate=GateLimits(coverage=0.65, w1_over_sd=0.40, dtw_over_sd=0.28, auc=0.90),
)
