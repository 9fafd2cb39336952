"""Robots for assemblies, by name."""

from __future__ import annotations

from rcbht_jax._util.optional import require

require("mujoco", "sim")

from sim_mjx.robots.hiro import HIRO  # noqa: E402
from sim_mjx.robots.panda import PANDA  # noqa: E402
from sim_mjx.robots.robot import Robot, from_mjcf  # noqa: E402
from sim_mjx.robots.ur5e import UR5E  # noqa: E402

__all__ = ["ROBOTS", "Robot", "from_mjcf"]
ROBOTS = {robot.name: robot for robot in (PANDA, UR5E, HIRO)}
