"""The approach: half-cosine interpolation between tool poses, solved for the joint angles.

Pure functions on NumPy or JAX arrays. Source: the state-1 facts of the design's task page, checked against the
recordings. The recorded controller interpolates position and roll, pitch, yaw, each on its own, and then solves
the inverse kinematics; its own solver held the orientation back by up to 4 mrad, which is not imitated.
"""

from __future__ import annotations

import math
from typing import Any

from sim_mjx.assembly import kinematics

Array = Any  # numpy.ndarray or jax.Array


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
