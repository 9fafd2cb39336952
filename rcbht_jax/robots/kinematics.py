"""Kinematics of HIRO's arms: pure functions on NumPy or JAX arrays (leading batch axes welcome).

The array's own library computes, in the array's own precision; every function can be jitted and vmapped.
World frame, metres, radians; "wrist" is the frame of the last joint, "TCP" the tool centre point in it.
The inverse is derived at :func:`ik`.
"""

from __future__ import annotations

import math
from typing import Any

from jaxtyping import Float

from rcbht_jax.robots.hiro import ARMS, CHEST_HEIGHT, MIRROR, RIGHT, SHOULDER_ROLL, TCP, Vector, side

Array = Any  # numpy.ndarray or jax.Array
Frame = tuple[Array, Array, Array]  # the x, y and z axes, [..., 3] each, in world coordinates

SEARCH_STEPS = 5  # of the inverse; each about squares its error: 0.3 rad -> rounding, over the task's workspace


def fk(
    q: Float[Array, "*batch 6"], arm: str = "R"
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3 3"], Float[Array, "*batch 3"]]:
    """Forward kinematics.

    Args:
        q: joint angles [..., 6].
        arm: "R" or "L".

    Returns:
        wrist position [..., 3], rotation [..., 3, 3] whose columns are the wrist's axes, TCP position [..., 3].

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    origins, _, frame = _chain(q, arm)
    return origins[-1], _matrix(frame), _along(origins[-1], frame, TCP[arm])


def jacobian(
    q: Float[Array, "*batch 6"], arm: str = "R"
) -> tuple[Float[Array, "*batch 3 6"], Float[Array, "*batch 3 6"]]:
    """Velocity of the wrist point and angular velocity of the hand per joint velocity, in world coordinates.

    Args:
        q: joint angles [..., 6].
        arm: "R" or "L".

    Returns:
        J_v [..., 3, 6] in m/rad and J_w [..., 3, 6].

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    xp = q.__array_namespace__()
    origins, axes, _ = _chain(q, arm)
    linear = [xp.linalg.cross(axis, origins[-1] - origin) for axis, origin in zip(axes, origins, strict=True)]
    return xp.stack(linear, axis=-1), xp.stack(axes, axis=-1)


def rotation_from_rpy(rpy: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Rotation [..., 3, 3] = Rz(yaw) Ry(pitch) Rx(roll) from roll, pitch, yaw [..., 3]."""
    frame = _turned(_world_frame(rpy), 2, rpy[..., 2])
    return _matrix(_turned(_turned(frame, 1, rpy[..., 1]), 0, rpy[..., 0]))


def rpy_from_rotation(rotation: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Roll, pitch, yaw [..., 3] of a rotation [..., 3, 3], pitch within +-90 degrees.

    With the hand straight down (pitch -90 degrees) only yaw + roll is determined.
    """
    xp = rotation.__array_namespace__()
    pitch = xp.arctan2(-rotation[..., 2, 0], xp.hypot(rotation[..., 0, 0], rotation[..., 1, 0]))
    roll = xp.arctan2(rotation[..., 2, 1], rotation[..., 2, 2])
    yaw = xp.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return xp.stack([roll, pitch, yaw], axis=-1)


def tilt(rotation: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch"]:
    """Angle [...] between the hand and the vertical: 0 when the wrist's x axis points up."""
    xp = rotation.__array_namespace__()
    return xp.arctan2(xp.hypot(rotation[..., 0, 0], rotation[..., 1, 0]), rotation[..., 2, 0])


def ik(
    position: Float[Array, "*batch 3"],
    rotation: Float[Array, "*batch 3 3"],
    near: Float[Array, "*batch 6"],
    arm: str = "R",
) -> Float[Array, "*batch 6"]:
    """Inverse kinematics of a TCP pose.

    The last axis misses the crossing point of the two before it by 80 mm, so no closed form exists. But given
    the last angle, the rest is closed: the wrist's crossing point, hence the first three angles, hence the last
    three. The last angle that comes out must be the one put in; a fixed number of Steffensen steps finds it,
    to rounding. The orientation is met exactly in any case.

    Args:
        position: TCP [..., 3].
        rotation: [..., 3, 3].
        near: joint angles [..., 6] of the same arm that choose among the eight solutions (arm forward or
            backward, elbow down or up, wrist flipped or not) and start the search.
        arm: "R" or "L".

    Returns:
        joint angles [..., 6] within +-180 degrees, whatever the joint limits; NaN where the pose is out of
        reach or the search did not converge.

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    xp = position.__array_namespace__()
    if side(arm) < 0:  # solve the mirror image with the right arm
        signs = xp.asarray(MIRROR, dtype=position.dtype)
        flip = xp.asarray((1.0, -1.0, 1.0), dtype=position.dtype)
        position, near = position * _like(flip, position), near * _like(signs, near)
        rotation = rotation * _like(flip[:, None] * flip[None, :], rotation)
    frame = rotation[..., :, 0], rotation[..., :, 1], rotation[..., :, 2]
    wrist = _along(position, frame, _back(TCP["R"]))
    last = near[..., 5]
    for _ in range(SEARCH_STEPS):
        once = _solve(wrist, frame, last, near)[0][..., 5]
        twice = _solve(wrist, frame, once, near)[0][..., 5]
        last = _accelerated(last, once, twice)
    q, reachable = _solve(wrist, frame, last, near)
    solved = max(1e-9, 100.0 * float(xp.finfo(position.dtype).eps))  # rad, on a lever of 80 mm
    converged = reachable & (abs(_wrapped(q[..., 5] - last)) < solved)
    q = xp.where(converged[..., None], q, math.nan)
    return q if side(arm) > 0 else q * _like(signs, q)


def _solve(wrist: Array, frame: Frame, last: Array, near: Array) -> tuple[Array, Array]:
    """Right arm's angles [..., 6] for a wrist pose if its last angle were ``last``; and where reachable [...]."""
    xp = wrist.__array_namespace__()
    before = _turned(frame, 0, -last)
    crossing = _along(wrist, before, _back(RIGHT[5].offset))
    arm, reachable = _solve_arm(crossing, near)
    bent = _turned(_turned(_shoulder_frame(wrist), 2, arm[0]), 1, arm[1] + arm[2])
    # The rest of the rotation is Rz(q3) Ry(q4) Rx(q5).
    x0, x1, x2 = (xp.sum(axis * frame[0], axis=-1) for axis in bent)
    y2, z2 = xp.sum(bent[2] * frame[1], axis=-1), xp.sum(bent[2] * frame[2], axis=-1)
    flipped = _sign(xp.cos(near[..., 4]))
    q3 = xp.arctan2(flipped * x1, flipped * x0)
    q4 = xp.arctan2(-x2, flipped * xp.hypot(x0, x1))
    q5 = xp.arctan2(flipped * y2, flipped * z2)
    return xp.stack([*arm, q3, q4, q5], axis=-1), reachable


def _solve_arm(crossing: Array, near: Array) -> tuple[tuple[Array, Array, Array], Array]:
    """First three angles that bring the wrist's crossing point [..., 3] there; and where they can [...].

    In the plane of upper arm and forearm each is a stick; angles count from z to x, the sense of the y axis.
    """
    xp = crossing.__array_namespace__()
    origin = (RIGHT[0].offset[0], RIGHT[0].offset[1], RIGHT[0].offset[2] + CHEST_HEIGHT)
    away = crossing - _like(xp.asarray(origin, dtype=crossing.dtype), crossing)
    x, y, z = (xp.sum(axis * away, axis=-1) for axis in _shoulder_frame(away))
    upper_x, aside, upper_z = RIGHT[2].offset
    fore_x, fore_z = RIGHT[3].offset[0] + RIGHT[4].offset[0], RIGHT[3].offset[2] + RIGHT[4].offset[2]
    upper, fore = math.hypot(upper_x, upper_z), math.hypot(fore_x, fore_z)
    bend0 = math.atan2(fore_x, fore_z) - math.atan2(upper_x, upper_z)  # between the sticks at q2 = 0

    out2 = x**2 + y**2 - aside**2
    # Where the near arm's crossing point lies: in front of the shoulder axis or behind it.
    near1, near12 = near[..., 1], near[..., 1] + near[..., 2]
    near_upper = upper_x * xp.cos(near1) + upper_z * xp.sin(near1)
    forward = _sign(near_upper + fore_x * xp.cos(near12) + fore_z * xp.sin(near12))
    out = forward * xp.sqrt(xp.maximum(out2, 0.0))
    q0 = xp.arctan2(y, x) - xp.arctan2(xp.full_like(out, aside), out)
    cosine = (out2 + z**2 - upper**2 - fore**2) / (2 * upper * fore)
    bend = _sign(xp.sin(near[..., 2] + bend0)) * xp.arccos(xp.clip(cosine, -1.0, 1.0))
    lead = math.atan2(upper_x, upper_z) + xp.arctan2(fore * xp.sin(bend), upper + fore * xp.cos(bend))
    q1 = xp.arctan2(out, z) - lead
    reachable = (out2 >= 0.0) & (abs(cosine) <= 1.0)
    return (_wrapped(q0), _wrapped(q1), _wrapped(bend - bend0)), reachable


def _accelerated(start: Array, once: Array, twice: Array) -> Array:
    """Aitken's extrapolation of a fixed-point iteration; of angles."""
    xp = start.__array_namespace__()
    first, second = _wrapped(once - start), _wrapped(twice - once)
    bend = second - first
    # near the fixed point both steps are rounding: their difference may be any part of them, or zero
    curved = abs(bend) > abs(first) / 8
    return xp.where(curved, start - first**2 / xp.where(curved, bend, 1.0), twice)


def _chain(q: Array, arm: str) -> tuple[list[Array], list[Array], Frame]:
    """Origins and axes of the joints, [..., 3] each, and the last link's frame."""
    roll = side(arm) * SHOULDER_ROLL
    xp = q.__array_namespace__()
    frame = _world_frame(q)
    position = CHEST_HEIGHT * frame[2]
    origins, axes = [], []
    for joint, link in enumerate(ARMS[arm]):
        position = _along(position, frame, link.offset)
        if joint == 0:
            frame = _turned(frame, 0, xp.full_like(q[..., 0], roll))
        axis = "xyz".index(link.axis)
        frame = _turned(frame, axis, q[..., joint])
        origins.append(position)
        axes.append(frame[axis])
    return origins, axes, frame


def _world_frame(like: Array) -> Frame:
    xp = like.__array_namespace__()
    one, zero = xp.ones_like(like[..., 0]), xp.zeros_like(like[..., 0])
    x, y, z = (xp.stack(axis, axis=-1) for axis in ((one, zero, zero), (zero, one, zero), (zero, zero, one)))
    return x, y, z


def _shoulder_frame(like: Array) -> Frame:
    xp = like.__array_namespace__()
    return _turned(_world_frame(like), 0, xp.full_like(like[..., 0], SHOULDER_ROLL))


def _turned(frame: Frame, axis: int, angle: Array) -> Frame:
    """The frame after turning about one of its own axes by an angle [...]."""
    xp = angle.__array_namespace__()
    cos, sin = xp.cos(angle)[..., None], xp.sin(angle)[..., None]
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out = list(frame)
    out[j], out[k] = cos * frame[j] + sin * frame[k], cos * frame[k] - sin * frame[j]
    return out[0], out[1], out[2]


def _along(position: Array, frame: Frame, offset: Vector) -> Array:
    """The point at ``offset`` in a frame with its origin at ``position`` [..., 3]."""
    for axis, length in zip(frame, offset, strict=True):
        if length:
            position = position + length * axis
    return position


def _back(offset: Vector) -> Vector:
    return -offset[0], -offset[1], -offset[2]


def _matrix(frame: Frame) -> Array:
    return frame[0].__array_namespace__().stack(frame, axis=-1)


def _sign(x: Array) -> Array:
    """+1 or -1, never 0."""
    return x.__array_namespace__().where(x < 0.0, -1.0, 1.0)


def _wrapped(angle: Array) -> Array:
    """The same angle within +-180 degrees."""
    return angle - 2 * math.pi * angle.__array_namespace__().round(angle / (2 * math.pi))


def _like(constant: Array, array: Array) -> Array:
    """A constant with leading axes of length one, as many as it takes to broadcast against ``array``."""
    return constant.reshape((1,) * (array.ndim - constant.ndim) + constant.shape)
