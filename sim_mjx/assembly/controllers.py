"""The recorded force and moment law: joint references moved by the error of the wrench, every control period.

Pure functions of one trial's arrays; batches by ``jax.vmap``. Source: design page "HIRO task", controller facts,
point 2 (reproduces the logged references with R^2 >= 0.998).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from sim_mjx.assembly import kinematics

Array = Any


def force_law(
    command: Array,
    wrench: Array,
    force_goal: Array,
    moment_goal: Array,
    force_gain: Array,
    moment_gain: Array,
    arm: str = "R",
) -> Array:
    """One period of the law: q[0:3] += Jv^T kf (F - F*), q[3:6] += Jw^T km (M - M*).

    The paper's null-space projection does nothing: the two updates act on different joints.

    Args:
        command: joint references [6], rad.
        wrench: measured [6], N and Nm, world frame, positive when the part pushes the hand up.
        force_goal: [3] N, world frame. moment_goal: [3] Nm, world frame.
        force_gain: rad/(Nm). moment_gain: rad/(Nm).
        arm: "R" or "L".

    Returns:
        the new joint references [6].
    """
    velocity, angular = kinematics.jacobian(command, arm)
    shoulder = force_gain * (velocity[:, :3].T @ (wrench[:3] - force_goal))
    wrist = moment_gain * (angular[:, 3:].T @ (wrench[3:] - moment_goal))
    return command + jnp.concatenate([shoulder, wrist])


def goals_in_world(goal: Array, rotation: Array, in_world: Array) -> Array:
    """A set-point [3] in world coordinates; it is given in the wrist's unless ``in_world``."""
    return jnp.where(in_world, goal, rotation @ goal)
