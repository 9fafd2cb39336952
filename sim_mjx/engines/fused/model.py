"""What the kernel needs of a scene: the structure of its model, and numbers that trials may share or each have."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import warp as wp

Values = wp.array2d(dtype=float)  # [item, trial], or [item, 1] where all trials share them
Rows = wp.array3d(dtype=float)  # [item, component, trial], likewise


@lru_cache
def shapes(joints: int) -> tuple[Any, Any, Any]:
    """Types of a vector over the joints, a square matrix, and a matrix of three rows."""
    return (wp.types.vector(joints, float), wp.types.matrix((joints, joints), float),
            wp.types.matrix((3, joints), float))  # fmt: skip


@wp.struct
class Model:
    """The fields of ``MjModel`` with these names, except where a comment says otherwise.

    Quaternions have their real part last, as in Warp. Each joint has one degree of freedom, so that joints, positions
    and velocities have the same numbers.
    """

    gravity: wp.vec3
    origin: wp.vec3  # m, near the contacts: places are measured from it, which single precision resolves best near zero
    timestep: float
    impratio: float

    body_parentid: wp.array(dtype=int)
    body_jntadr: wp.array(dtype=int)
    body_jntnum: wp.array(dtype=int)
    body_moves: wp.array(dtype=int)  # bit d is set if joint d moves the body
    body_pos: Rows
    body_quat: Rows
    body_ipos: Rows
    body_mass: Values
    body_inertia: Rows  # about the centre of mass, in the body's axes: xx, yy, zz, xy, xz, yz
    body_gravcomp: Values

    jnt_slides: wp.array(dtype=int)  # 1 = a slide, 0 = a hinge
    jnt_limited: wp.array(dtype=int)
    dof_bodyid: wp.array(dtype=int)
    qpos0: Values
    qpos_spring: Values
    jnt_pos: Rows
    jnt_axis: Rows
    jnt_range: Rows
    jnt_margin: Values
    jnt_solref: Rows
    jnt_solimp: Rows
    jnt_stiffness: Values
    dof_damping: Values
    dof_armature: Values
    dof_invweight0: Values

    geom_bodyid: wp.array(dtype=int)
    geom_pos: Rows
    geom_quat: Rows
    geom_size: Rows

    pair_geom: wp.array2d(dtype=int)  # [pair, 2]: sphere, box
    pair_friction: Rows  # along the two tangents
    pair_solref: Rows
    pair_solimp: Rows
    pair_margin: Values
    pair_invweight: Values  # of the two bodies, translational, summed

    jnt_actuator: wp.array(dtype=int)  # of each joint, -1 = none
    actuator_gain: Values  # force per control, times the gear
    actuator_bias: Rows  # force of a joint: constant, per position, per velocity
    actuator_range: Rows  # of the joint's force

    site_body: wp.array(dtype=int)  # of the force sensors
    site_pos: Rows
    site_quat: Rows

    tip_geom: wp.array2d(dtype=int)  # [tab, 2]: tip, lip


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __fdividef(1.0f, x);
#else
    return 1.0f / x;
#endif
""")
def reciprocal(x: float) -> float:
    """1 / x, to two units in the last place: an exact division calls a subroutine, for which registers are saved."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return rsqrtf(x);
#else
    return 1.0f / ::sqrtf(x);
#endif
""")
def inverse_root(x: float) -> float:
    """1 / sqrt(x), likewise."""
    ...


@wp.func
def value(of: Values, item: int, trial: int) -> float:
    """A number of a trial."""
    return of[item, wp.min(trial, of.shape[1] - 1)]


@wp.func
def entry(of: Rows, item: int, component: int, trial: int) -> float:
    """One component of a trial's vector."""
    return of[item, component, wp.min(trial, of.shape[2] - 1)]


@wp.func
def vector(of: Rows, item: int, trial: int) -> wp.vec3:
    """The first three components of a trial's vector."""
    k = wp.min(trial, of.shape[2] - 1)
    return wp.vec3(of[item, 0, k], of[item, 1, k], of[item, 2, k])


@wp.func
def rotation(of: Rows, item: int, trial: int) -> wp.quat:
    """A trial's quaternion."""
    k = wp.min(trial, of.shape[2] - 1)
    return wp.quat(of[item, 0, k], of[item, 1, k], of[item, 2, k], of[item, 3, k])
