"""Robots for assemblies, by name."""

from __future__ import annotations

from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError

require("mujoco", "sim")

from sim_mjx.robots.hiro import HIRO  # noqa: E402
from sim_mjx.robots.panda import PANDA  # noqa: E402
from sim_mjx.robots.robot import Robot, from_mjcf  # noqa: E402
from sim_mjx.robots.ur5e import UR5E  # noqa: E402

__all__ = ["ROBOTS", "Robot", "from_mjcf", "get_robot"]
ROBOTS = {robot.name: robot for robot in (PANDA, UR5E, HIRO)}


def get_robot(name: str) -> Robot:
    """A robot by name.

    Raises:
        InputError: there is none.
    """
    if name not in ROBOTS:
        raise InputError(f"There is no robot {name!r}; expected one of {', '.join(ROBOTS)}.")
    return ROBOTS[name]
