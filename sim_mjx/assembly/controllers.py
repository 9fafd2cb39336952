"""The recorded force and moment law: joint references moved by the error of the wrench, every control period.

Pure functions of one trial's arrays; batches by ``jax.vmap``. The law reproduces the logged references with
R^2 >= 0.998.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp

from rcbht_jax.robots import kinematics

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


def half_cosine(times: Array, poses: Array, t: Array) -> Array:
    """Interpolation that starts and stops at every waypoint: s = (1 - cos(pi tau)) / 2 of each segment.

    Args:
        times: of the waypoints [k], s, increasing.
        poses: [k, d], any coordinates.
        t: time [...], s.

    Returns:
        [..., d]; the first pose before the first waypoint, the last one after the last.
    """
    xp = poses.__array_namespace__()
    lead = (None,) * t.ndim
    tau = (t[..., None] - times[:-1][lead]) / (times[1:] - times[:-1])[lead]
    share = 0.5 - 0.5 * xp.cos(math.pi * xp.clip(tau, 0.0, 1.0))
    steps = (poses[1:] - poses[:-1])[lead]
    return poses[0][lead] + xp.sum(share[..., None] * steps, axis=-2)


def approach(home: Array, way_time: Array, way_position: Array, way_rpy: Array, t: Array, arm: str = "R") -> Array:
    """Joint angles along the approach, which leaves home at time zero.

    Args:
        home: joint angles [6] at the start, rad; they also choose among the inverse's solutions.
        way_time: when each waypoint is reached [k], s, increasing and positive.
        way_position: of the TCP [k, 3], m.
        way_rpy: [k, 3] roll, pitch, yaw, rad.
        t: time [...], s.
        arm: "R" or "L".

    Returns:
        joint angles [..., 6]; NaN where the interpolated pose is out of reach.

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    xp = home.__array_namespace__()
    _, rotation, position = kinematics.fk(home, arm)
    start = xp.concat([position, kinematics.rpy_from_rotation(rotation)])
    poses = xp.concat([start[None], xp.concat([way_position, way_rpy], axis=-1)])
    pose = half_cosine(xp.concat([xp.zeros_like(way_time[:1]), way_time]), poses, t)
    near = xp.broadcast_to(home, pose.shape)
    return kinematics.ik(pose[..., :3], kinematics.rotation_from_rpy(pose[..., 3:]), near, arm)
