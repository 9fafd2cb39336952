"""Kinematics and dynamics of one trial: the recursions over bodies of Featherstone, *Rigid Body Dynamics Algorithms*.

Spatial vectors have their angular half first and are taken about the model's origin, in the world's axes.
"""

from functools import lru_cache
from typing import Any

import warp as wp

from sim_mjx.engines.fused.model import Model, entry, inverse_root, rotation, shapes, value, vector

Vectors = wp.array(dtype=wp.vec3)
Rotations = wp.array(dtype=wp.quat)
Spatial = wp.array(dtype=wp.spatial_vector)
Numbers = wp.array(dtype=float)
Matrix = wp.array2d(dtype=float)


@wp.func
def cross_motion(v: wp.spatial_vector, m: wp.spatial_vector) -> wp.spatial_vector:
    """The rate of a motion that is carried along with velocity ``v``."""
    w = wp.spatial_top(v)
    u = wp.spatial_bottom(v)
    return wp.spatial_vector(
        wp.cross(w, wp.spatial_top(m)), wp.cross(w, wp.spatial_bottom(m)) + wp.cross(u, wp.spatial_top(m))
    )


@wp.func
def cross_force(v: wp.spatial_vector, f: wp.spatial_vector) -> wp.spatial_vector:
    """The rate of a momentum that is carried along with velocity ``v``."""
    w = wp.spatial_top(v)
    u = wp.spatial_bottom(v)
    return wp.spatial_vector(
        wp.cross(w, wp.spatial_top(f)) + wp.cross(u, wp.spatial_bottom(f)), wp.cross(w, wp.spatial_bottom(f))
    )


@wp.func
def momentum(mass: float, first: wp.vec3, second: wp.mat33, v: wp.spatial_vector) -> wp.spatial_vector:
    """Of a body with this mass, mass times place, and inertia about the origin."""
    w = wp.spatial_top(v)
    u = wp.spatial_bottom(v)
    return wp.spatial_vector(second * w + wp.cross(first, u), mass * u + wp.cross(w, first))


@wp.func
def inertia(
    m: Model, trial: int, b: int, pos: wp.vec3, rot: wp.quat
) -> tuple[float, wp.vec3, wp.mat33]:  # fmt: skip
    """Mass, mass times place, and inertia about the origin of a body."""
    k = wp.min(trial, m.body_inertia.shape[2] - 1)
    own = wp.mat33(
        m.body_inertia[b, 0, k], m.body_inertia[b, 3, k], m.body_inertia[b, 4, k],
        m.body_inertia[b, 3, k], m.body_inertia[b, 1, k], m.body_inertia[b, 5, k],
        m.body_inertia[b, 4, k], m.body_inertia[b, 5, k], m.body_inertia[b, 2, k],
    )  # fmt: skip
    turn = wp.quat_to_matrix(rot)
    mass = value(m.body_mass, b, trial)
    centre = pos + turn * vector(m.body_ipos, b, trial)
    shift = wp.dot(centre, centre) * wp.identity(n=3, dtype=float) - wp.outer(centre, centre)
    return mass, mass * centre, turn * own * wp.transpose(turn) + mass * shift


@wp.func
def move(
    m: Model, trial: int, qpos: Numbers, qvel: Numbers, qacc: Numbers, pos: Vectors, rot: Rotations, axes: Spatial,
    mass: Numbers, first: Vectors, second: wp.array(dtype=wp.mat33), v: Spatial, a: Spatial, f: Spatial,
):  # fmt: skip
    """Everything from the base to the hands.

    Places and rotations of all bodies, the motion that a unit of each joint's velocity is, inertias, velocities,
    accelerations, and the force that moves each body so against gravity.
    """
    pos[0] = -m.origin
    rot[0] = wp.quat_identity()
    v[0] = wp.spatial_vector()
    a[0] = wp.spatial_vector(wp.vec3(0.0), -m.gravity)
    f[0] = wp.spatial_vector()
    for b in range(1, m.body_parentid.shape[0]):
        parent = m.body_parentid[b]
        at = pos[parent] + wp.quat_rotate(rot[parent], vector(m.body_pos, b, trial))
        turn = rot[parent] * rotation(m.body_quat, b, trial)
        vel = v[parent]
        acc = a[parent]
        for d in range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b]):
            moved = qpos[d] - value(m.qpos0, d, trial)
            own = vector(m.jnt_axis, d, trial)
            axis = wp.quat_rotate(turn, own)
            motion = wp.spatial_vector(wp.vec3(0.0), axis)
            if m.jnt_slides[d] == 1:
                at = at + axis * moved
            else:
                anchor = at + wp.quat_rotate(turn, vector(m.jnt_pos, d, trial))
                turn = turn * wp.quat_from_axis_angle(own, moved)
                at = anchor - wp.quat_rotate(turn, vector(m.jnt_pos, d, trial))
                motion = wp.spatial_vector(axis, wp.cross(anchor, axis))
            acc = acc + motion * qacc[d] + cross_motion(vel, motion) * qvel[d]
            vel = vel + motion * qvel[d]
            axes[d] = motion
        turn = turn * inverse_root(wp.dot(turn, turn))
        weight, one, two = inertia(m, trial, b, at, turn)
        pos[b] = at
        rot[b] = turn
        v[b] = vel
        a[b] = acc
        mass[b] = weight
        first[b] = one
        second[b] = two
        f[b] = momentum(weight, one, two, acc) + cross_force(vel, momentum(weight, one, two, vel))


@wp.func
def compensate(m: Model, trial: int, mass: Numbers, first: Vectors, f: Spatial):
    """Take away what bodies whose weight is carried need against gravity."""
    for b in range(1, m.body_parentid.shape[0]):
        share = value(m.body_gravcomp, b, trial)
        f[b] = f[b] + share * wp.spatial_vector(wp.cross(first[b], m.gravity), mass[b] * m.gravity)


@wp.func
def sum_up(m: Model, mass: Numbers, first: Vectors, second: wp.array(dtype=wp.mat33), f: Spatial):
    """Add each body's inertia and force to its parent's."""
    for k in range(m.body_parentid.shape[0] - 1):
        b = m.body_parentid.shape[0] - 1 - k
        parent = m.body_parentid[b]
        f[parent] = f[parent] + f[b]
        mass[parent] = mass[parent] + mass[b]
        first[parent] = first[parent] + first[b]
        second[parent] = second[parent] + second[b]


@lru_cache
def joint_space(n: int) -> Any:
    """The inertia of ``n`` joints, and the forces on them."""
    column, square, _ = shapes(n)

    @wp.func
    def inertia_matrix(
        m: Model, trial: int, axes: Spatial, mass: Numbers, first: Vectors, second: wp.array(dtype=wp.mat33)
    ) -> square:  # fmt: skip
        """The lower half of the joints' inertia matrix, from summed inertias."""
        matrix = square()
        for d in range(n):
            b = m.dof_bodyid[d]
            push = momentum(mass[b], first[b], second[b], axes[d])
            moves = m.body_moves[b]
            for other in range(d + 1):
                if (moves >> other) & 1 == 1:
                    matrix[d, other] = wp.dot(axes[other], push)
            matrix[d, d] += value(m.dof_armature, d, trial)
        return matrix

    @wp.func
    def joint_forces(
        m: Model, trial: int, axes: Spatial, f: Spatial, qpos: Numbers, qvel: Numbers, before: Matrix, after: Matrix,
        share: float,
    ) -> tuple[column, column]:  # fmt: skip
        """Forces without constraints, and the derivatives by velocity of those of dampers and actuators.

        Controls are the given share of the way from ``before`` to ``after``.
        """
        force = column()
        slope = column()
        for d in range(n):
            stretched = qpos[d] - value(m.qpos_spring, d, trial)
            slope[d] = -value(m.dof_damping, d, trial)
            force[d] = slope[d] * qvel[d] - value(m.jnt_stiffness, d, trial) * stretched
            force[d] -= wp.dot(axes[d], f[m.dof_bodyid[d]])
            u = m.jnt_actuator[d]
            if u >= 0:
                ctrl = before[trial, u] + share * (after[trial, u] - before[trial, u])
                damped = entry(m.actuator_bias, u, 2, trial)
                pull = value(m.actuator_gain, u, trial) * ctrl + entry(m.actuator_bias, u, 0, trial)
                pull += entry(m.actuator_bias, u, 1, trial) * qpos[d] + damped * qvel[d]
                low = entry(m.actuator_range, u, 0, trial)
                high = entry(m.actuator_range, u, 1, trial)
                if pull > low and pull < high:
                    slope[d] += damped
                force[d] += wp.clamp(pull, low, high)
        return force, slope

    return inertia_matrix, joint_forces
