"""The recorded force and moment law: joint references moved by the error of the wrench, every control period.

Pure functions of one trial's arrays; batches by ``jax.vmap``. The law reproduces the logged references with
R^2 >= 0.998.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Bool, Float

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array

Joints = Float[Array, " 6"]  # rad
Wrench = Float[Array, " 6"]  # N and Nm
Vector = Float[Array, " 3"]
Rotation = Float[Array, "3 3"]  # columns are the wrist's axes in the world
Gain = Float[Array, ""] | float
Times = Float[Array, " way"]
Places = Float[Array, "way 3"]


def force_law(
    command: Joints,
    wrench: Wrench,
    force_goal: Vector,
    moment_goal: Vector,
    force_gain: Gain,
    moment_gain: Gain,
    arm: str = "R",
) -> Joints:
    """One period of the law: q[0:3] += Jv^T kf (F - F*), q[3:6] += Jw^T km (M - M*).

    The paper's null-space projection does nothing: the two updates act on different joints.

    Args:
        command: joint references, rad.
        wrench: measured, N and Nm, world frame, positive when the part pushes the hand up.
        force_goal: N, world frame. moment_goal: Nm, world frame.
        force_gain: rad/(Nm). moment_gain: rad/(Nm).
        arm: "R" or "L".

    Returns:
        the new joint references.
    """
    velocity, angular = kinematics.jacobian(command, arm)
    shoulder = force_gain * (velocity[:, :3].T @ (wrench[:3] - force_goal))
    wrist = moment_gain * (angular[:, 3:].T @ (wrench[3:] - moment_goal))
    return command + jnp.concatenate([shoulder, wrist])


def goals_in_world(goal: Vector, rotation: Rotation, in_world: Bool[Array, ""]) -> Vector:
    """A set-point in world coordinates; it is given in the wrist's unless ``in_world``."""
    return jnp.where(in_world, goal, rotation @ goal)


def half_cosine(
    times: Times, poses: Float[Array, "way coordinate"], t: Float[Array, "*batch"]
) -> Float[Array, "*batch coordinate"]:
    """Interpolation that starts and stops at every waypoint: s = (1 - cos(pi tau)) / 2 of each segment.

    Args:
        times: of the waypoints, s, increasing.
        poses: any coordinates.
        t: time, s.

    Returns:
        the first pose before the first waypoint, the last one after the last.
    """
    xp = poses.__array_namespace__()
    lead = (None,) * t.ndim
    tau = (t[..., None] - times[:-1][lead]) / (times[1:] - times[:-1])[lead]
    share = 0.5 - 0.5 * xp.cos(math.pi * xp.clip(tau, 0.0, 1.0))
    steps = (poses[1:] - poses[:-1])[lead]
    return poses[0][lead] + xp.sum(share[..., None] * steps, axis=-2)


def approach(
    home: Joints, way_time: Times, way_position: Places, way_rpy: Places, t: Float[Array, "*batch"]
) -> Float[Array, "*batch 6"]:
    """Joint angles of the right arm along the approach, which leaves home at time zero.

    Args:
        home: joint angles at the start, rad; they also choose among the inverse's solutions.
        way_time: when each waypoint is reached, s, increasing and positive.
        way_position: of the TCP, m.
        way_rpy: roll, pitch, yaw, rad.
        t: time, s.

    Returns:
        joint angles; NaN where the interpolated pose is out of reach.
    """
    xp = home.__array_namespace__()
    _, rotation, position = kinematics.fk(home)
    start = xp.concat([position, kinematics.rpy_from_rotation(rotation)])
    poses = xp.concat([start[None], xp.concat([way_position, way_rpy], axis=-1)])
    pose = half_cosine(xp.concat([xp.zeros_like(way_time[:1]), way_time]), poses, t)
    near = xp.broadcast_to(home, pose.shape)
    return kinematics.ik(pose[..., :3], kinematics.rotation_from_rpy(pose[..., 3:]), near)
