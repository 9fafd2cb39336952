"""The approach: half-cosine interpolation between tool poses, and the recorded sessions' waypoints.

Pure functions on NumPy or JAX arrays. Source: the state-1 facts of the design's task page (verified on the
recordings). The recorded controller interpolates position and roll, pitch, yaw, each on its own, and then
solves the inverse kinematics.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from sim_mjx import kinematics
from sim_mjx.hiro import HOME

Array = Any  # numpy.ndarray or jax.Array

# Per session, after the start at home: time (s), x y z (m), roll pitch yaw (rad) of the right arm's TCP.
RECORDED: dict[str, tuple[tuple[float, float, float, float, float, float, float], ...]] = {
    "A": ((5.00, 0.310, -0.1696, 0.495, 0.0, -1.2784, 0.0), (7.50, 0.330, -0.1696, 0.484, 0.0, -1.2784, 0.0)),
    "B": ((3.50, 0.311, -0.1726, 0.495, 0.0, -1.2783, 0.0), (5.50, 0.331, -0.1726, 0.484, 0.0, -1.2783, 0.0)),
    "C": ((2.51, 0.315, -0.1716, 0.540, 0.0, -1.3782, 0.0), (4.50, 0.335, -0.1716, 0.529, 0.0, -1.3782, 0.0)),
    "OpenHRP": ((2.51, 0.326, -0.1726, 0.536, 0.0, -1.3281, 0.0), (4.50, 0.331, -0.1726, 0.531, 0.0, -1.3781, 0.0)),
}


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
    tau = (t[..., None] - times[:-1][(None,) * t.ndim]) / (times[1:] - times[:-1])[(None,) * t.ndim]
    share = 0.5 - 0.5 * xp.cos(math.pi * xp.clip(tau, 0.0, 1.0))
    first = poses[0][(None,) * t.ndim]
    return first + xp.sum(share[..., None] * (poses[1:] - poses[:-1])[(None,) * t.ndim], axis=-2)


def approach_joints(times: Array, poses: Array, t: Array, near: Array, arm: str = "R") -> Array:
    """Joint angles [..., 6] along an approach through TCP waypoints.

    Args:
        times: [k], s, increasing.
        poses: [k, 6] x y z (m) roll pitch yaw (rad) of the TCP.
        t: time [...], s.
        near: joint angles [6] of the solution to take, those at home for instance.
        arm: "R" or "L".

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    pose = half_cosine(times, poses, t)
    rotation = kinematics.rotation_from_rpy(pose[..., 3:])
    return kinematics.ik(pose[..., :3], rotation, near[(None,) * t.ndim], arm)


def recorded_approach(session: str, dx: float = 0.0, dy: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Waypoints of a recorded session of the right arm, its home pose first.

    Args:
        session: "A", "B", "C" or "OpenHRP".
        dx: offset of all waypoints but home, m; session B's grid has -2 to 2 mm.
        dy: likewise.

    Returns:
        times [k] in s and poses [k, 6], x y z (m) roll pitch yaw (rad) of the TCP.

    Raises:
        InputError: the session has no recorded waypoints.
    """
    if session not in RECORDED:
        raise InputError(f"Session is {session!r}; expected one of {', '.join(RECORDED)}.")
    table = np.array(RECORDED[session])
    poses = table[:, 1:] + np.array([dx, dy, 0.0, 0.0, 0.0, 0.0])
    _, rotation, position = kinematics.fk(np.array(HOME[session]))
    home = np.concatenate([position, kinematics.rpy_from_rotation(rotation)])
    return np.concatenate([[0.0], table[:, 0]]), np.concatenate([home[None], poses])
