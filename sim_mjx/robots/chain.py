"""Kinematics of any serial chain of hinges, taken from a compiled model: pure functions of joint angles.

A chain is a pytree of constants; :func:`pose` and :func:`jacobian` run under ``jax.jit`` and ``jax.vmap``.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Float64

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

Vector = Float[Array, " 3"]
Rotation = Float[Array, "3 3"]
Angles = Float[Array, " joint"]  # rad


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SerialChain:
    """Hinges between the world and a wrist; each turns about an axis that is fixed in its own frame.

    ``turn[i]`` and ``shift[i]`` lead from the frame of hinge i - 1, turned by its angle, to that of hinge i, whose
    origin lies on its axis; the last pair leads from the last hinge to the wrist.
    """

    turn: Float[Array, "joint1 3 3"]  # joint1 = joint + 1
    shift: Float[Array, "joint1 3"]  # m
    axis: Float[Array, "joint 3"]
    zero: Float[Array, " joint"]  # rad, angle at which a hinge is not turned


def serial_chain(model: mujoco.MjModel, site: str) -> SerialChain:
    """The hinges that move a site, from the world outwards.

    Args:
        model: compiled.
        site: name of the wrist's site; its frame is the wrist's.

    Raises:
        InputError: there is no such site, or a joint that moves it is no hinge.
    """
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
    if number < 0:
        raise InputError(f"The model has no site {site!r}, which must mark the wrist's frame.")
    turn, shift = _matrix(model.site_quat[number]), model.site_pos[number].copy()
    hinges: list[tuple[Array, ...]] = []  # from the wrist inwards
    body = model.site_bodyid[number]
    while body:
        first = model.body_jntadr[body]
        for joint in range(first + model.body_jntnum[body] - 1, first - 1, -1):
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise InputError(f"The joint {model.joint(joint).name!r} is no hinge; an arm has hinges only.")
            anchor = model.jnt_pos[joint]
            hinges.append((turn, shift - anchor, model.jnt_axis[joint], model.qpos0[model.jnt_qposadr[joint]]))
            turn, shift = np.eye(3), anchor.copy()
        here = _matrix(model.body_quat[body])
        turn, shift = here @ turn, here @ shift + model.body_pos[body]
        body = model.body_parentid[body]
    if not hinges:
        raise InputError(f"No joint moves the site {site!r}.")
    turns, shifts, axes, zeros = zip(*reversed(hinges), strict=True)
    return SerialChain(*(np.array(one, np.float32) for one in ([turn, *turns], [shift, *shifts], axes, zeros)))


def _matrix(quat: Float64[np.ndarray, " 4"]) -> Float64[np.ndarray, "3 3"]:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def pose(chain: SerialChain, angles: Angles) -> tuple[Vector, Rotation]:
    """Place of the wrist, m, and its rotation, whose columns are the wrist's axes in the world."""
    return _frames(chain, angles)[:2]


def jacobian(chain: SerialChain, angles: Angles) -> Float[Array, "6 joint"]:
    """Velocity of the wrist, m/s, above its angular velocity, rad/s, per rad/s of each joint; world axes."""
    place, _, origins, axes = _frames(chain, angles)
    return jnp.concatenate([jnp.cross(axes, place[None, :] - origins).T, axes.T])


def _frames(chain: SerialChain, angles: Angles) -> tuple[Vector, Rotation, Array, Array]:
    """Wrist's place and rotation, and origin and axis ``[joint, 3]`` of every hinge, in the world."""
    rotation, place = chain.turn[0], chain.shift[0]
    origins, axes = [], []
    for i in range(len(chain.axis)):  # joints of an arm, unrolled
        origins.append(place)
        axes.append(along(rotation, chain.axis[i]))
        rotation = times(rotation, about(chain.axis[i], angles[i] - chain.zero[i]))
        place = place + along(rotation, chain.shift[i + 1])
        rotation = times(rotation, chain.turn[i + 1])
    return place, rotation, jnp.stack(origins), jnp.stack(axes)


def about(axis: Vector, angle: Float[Array, ""]) -> Rotation:
    """Rotation by an angle, rad, about a unit axis."""
    unit = jnp.eye(3, dtype=axis.dtype)
    cross = jnp.cross(jnp.broadcast_to(axis, (3, 3)), unit).T  # columns axis x e_i: the matrix of "axis x"
    return unit + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * (axis[:, None] * axis[None, :] - unit)


def rotation_vector(rotation: Rotation) -> Vector:
    """Axis times angle, rad, of a rotation by less than half a turn."""
    r = rotation
    twice = jnp.stack([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine, cosine = jnp.sqrt((twice**2).sum() + 1e-20) / 2, (jnp.trace(r) - 1) / 2
    return twice / (2 * sine) * jnp.arctan2(sine, cosine)


# sums of products, not matrix products: those are rounded to fewer digits on some accelerators
def along(matrix: Float[Array, "rows columns"], vector: Float[Array, " columns"]) -> Float[Array, " rows"]:
    """A matrix times a vector."""
    return (matrix * vector[None, :]).sum(-1)


def times(first: Float[Array, "rows inner"], second: Float[Array, "inner columns"]) -> Float[Array, "rows columns"]:
    """The product of two matrices."""
    return (first[:, :, None] * second[None]).sum(1)
