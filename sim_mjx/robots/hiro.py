"""HIRO's right arm as a robot for any assembly; its dimensions are in ``rcbht_jax.robots.hiro``."""

from __future__ import annotations

import math

import mujoco

from sim_mjx.assembly.robot import new_robot
from sim_mjx.robots.robot import Robot

HALF = math.sqrt(0.5)


def build() -> mujoco.MjSpec:
    """Links and joints; of the recorded wrist x points up the hand and z backwards, of the site z out of it."""
    spec = new_robot(("R",))
    for group in (spec.actuators, spec.sensors):
        for element in list(group):
            spec.delete(element)
    spec.delete(spec.body("RARM_TOOL"))
    spec.body("RARM_LINK5").add_site(name="WRIST", quat=(0.0, HALF, 0.0, -HALF))
    return spec


HOME = (0.12262, -0.13539, -1.89039, 0.2623, 0.72745, 0.0)  # rad, of session A
HIRO = Robot("hiro", build, "WRIST", HOME, (0.31, -0.19, 0.42))
