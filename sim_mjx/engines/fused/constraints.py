"""Contacts of spheres with boxes, and limits of joints, as rows of MuJoCo's constraint problem.

Formulas: MuJoCo's documentation, "Computation", sections "Constraint model" and "Friction cones".
"""

from __future__ import annotations

import warp as wp

from sim_mjx.engines.fused.dynamics import Numbers, Rotations, Spatial, Vectors
from sim_mjx.engines.fused.model import Model, Rows, entry, rotation, value, vector

Jacobians = wp.array3d(dtype=float)  # [contact, direction, joint]: normal and two tangents
Numbered = wp.array(dtype=int)

LEAST = wp.constant(1e-15)  # MuJoCo's mjMINVAL
LEAST_IMPEDANCE = wp.constant(0.0001)
MOST_IMPEDANCE = wp.constant(0.9999)


@wp.func
def impedance(solimp: Rows, item: int, trial: int, depth: float) -> float:
    """MuJoCo's d(r) at a violation r, m or rad."""
    low = wp.clamp(entry(solimp, item, 0, trial), LEAST_IMPEDANCE, MOST_IMPEDANCE)
    high = wp.clamp(entry(solimp, item, 1, trial), LEAST_IMPEDANCE, MOST_IMPEDANCE)
    width = entry(solimp, item, 2, trial)
    middle = wp.clamp(entry(solimp, item, 3, trial), LEAST_IMPEDANCE, MOST_IMPEDANCE)
    power = wp.max(entry(solimp, item, 4, trial), 1.0)
    if low == high or width <= LEAST:
        return 0.5 * (low + high)
    x = wp.abs(depth) / width
    if x >= 1.0:
        return high
    y = x
    if power > 1.0:
        if x <= middle:
            y = wp.pow(x, power) / wp.pow(middle, power - 1.0)
        else:
            y = 1.0 - wp.pow(1.0 - x, power) / wp.pow(1.0 - middle, power - 1.0)
    return low + y * (high - low)


@wp.func
def reference(m: Model, solref: Rows, solimp: Rows, item: int, trial: int) -> wp.vec2:
    """Stiffness and damping of the acceleration that a row asks for."""
    high = wp.clamp(entry(solimp, item, 1, trial), LEAST_IMPEDANCE, MOST_IMPEDANCE)
    first = entry(solref, item, 0, trial)
    second = entry(solref, item, 1, trial)
    if first <= 0.0:
        return wp.vec2(-first / (high * high), -second / high)
    time = wp.max(first, 2.0 * m.timestep)
    root = high * time * second
    return wp.vec2(1.0 / wp.max(root * root, LEAST), 2.0 / (high * time))


@wp.func
def sphere_on_box(centre: wp.vec3, radius: float, half: wp.vec3) -> wp.vec4:
    """Unit vector from the sphere into the box, in the box's axes, and the distance of the surfaces, m."""
    nearest = wp.vec3(
        wp.clamp(centre[0], -half[0], half[0]),
        wp.clamp(centre[1], -half[1], half[1]),
        wp.clamp(centre[2], -half[2], half[2]),
    )
    out = nearest - centre
    away = wp.length(out)
    if away > 0.0:
        return wp.vec4(out[0] / away, out[1] / away, out[2] / away, away - radius)
    depth = half - wp.abs(centre)  # the centre is inside: it leaves through the nearest face
    x = float(0.0)
    y = float(0.0)
    z = float(0.0)
    least = wp.min(depth)
    if depth[0] == least:
        x = -wp.sign(centre[0])
    elif depth[1] == least:
        y = -wp.sign(centre[1])
    else:
        z = -wp.sign(centre[2])
    return wp.vec4(x, y, z, -least - radius)


@wp.func
def tangent(normal: wp.vec3) -> wp.vec3:
    """MuJoCo's first tangent of a contact."""
    side = wp.vec3(0.0, 1.0, 0.0)
    if normal[1] >= 0.5 or normal[1] <= -0.5:
        side = wp.vec3(0.0, 0.0, 1.0)
    return wp.normalize(side - wp.dot(normal, side) * normal)


@wp.func
def find_contacts(
    m: Model,
    trial: int,
    pos: Vectors,
    rot: Rotations,
    axes: Spatial,
    qvel: Numbers,
    pairs: Numbered,
    points: Vectors,
    frames: wp.array(dtype=wp.mat33),
    rows: Jacobians,
    wanted: Vectors,
    weights: Vectors,
    cones: Vectors,
) -> int:
    """Fill in the contacts that there are, and count them.

    ``wanted`` are reference accelerations, ``weights`` inverse regularisers, ``cones`` the regularised and the two
    tangents' coefficients of friction.
    """
    count = int(0)
    for p in range(m.pair_geom.shape[0]):
        ball = m.pair_geom[p, 0]
        box = m.pair_geom[p, 1]
        first = m.geom_bodyid[ball]
        second = m.geom_bodyid[box]
        centre = pos[first] + wp.quat_rotate(rot[first], vector(m.geom_pos, ball, trial))
        at = pos[second] + wp.quat_rotate(rot[second], vector(m.geom_pos, box, trial))
        turn = rot[second] * rotation(m.geom_quat, box, trial)
        radius = entry(m.geom_size, ball, 0, trial)
        half = vector(m.geom_size, box, trial)
        touch = sphere_on_box(wp.quat_rotate_inv(turn, centre - at), radius, half)
        depth = touch[3] - value(m.pair_margin, p, trial)
        if depth < 0.0:
            normal = wp.quat_rotate(turn, wp.vec3(touch[0], touch[1], touch[2]))
            along = tangent(normal)
            frame = wp.matrix_from_rows(normal, along, wp.cross(normal, along))
            pairs[count] = p
            frames[count] = frame
            points[count] = centre + normal * (radius + 0.5 * touch[3])
            for d in range(qvel.shape[0]):
                for direction in range(3):
                    rows[count, direction, d] = 0.0
            add_jacobian(m, first, -1.0, points[count], frame, axes, count, rows)
            add_jacobian(m, second, 1.0, points[count], frame, axes, count, rows)
            weigh(m, trial, p, depth, count, qvel, rows, wanted, weights, cones)
            count += 1
    return count


@wp.func
def add_jacobian(
    m: Model, body: int, sign: float, point: wp.vec3, frame: wp.mat33, axes: Spatial, contact: int, rows: Jacobians
):
    """Add the velocity of a body's point, in the contact's frame, by each joint's velocity."""
    d = m.body_lastdof[body]
    while d >= 0:
        moved = wp.spatial_bottom(axes[d]) + wp.cross(wp.spatial_top(axes[d]), point)
        seen = frame * (sign * moved)
        for direction in range(3):
            rows[contact, direction, d] = rows[contact, direction, d] + seen[direction]
        d = m.dof_parentid[d]


@wp.func
def weigh(
    m: Model,
    trial: int,
    p: int,
    depth: float,
    contact: int,
    qvel: Numbers,
    rows: Jacobians,
    wanted: Vectors,
    weights: Vectors,
    cones: Vectors,
):
    """Reference acceleration, weights and cone of a contact of pair ``p``."""
    speed = wp.vec3(0.0)
    for d in range(qvel.shape[0]):
        speed += wp.vec3(rows[contact, 0, d], rows[contact, 1, d], rows[contact, 2, d]) * qvel[d]
    spring = reference(m, m.pair_solref, m.pair_solimp, p, trial)
    strength = impedance(m.pair_solimp, p, trial, depth)
    wanted[contact] = -spring[1] * speed - wp.vec3(spring[0] * strength * depth, 0.0, 0.0)
    soft = wp.max((1.0 - strength) * value(m.pair_invweight, p, trial) / strength, LEAST)
    one = entry(m.pair_friction, p, 0, trial)
    two = entry(m.pair_friction, p, 1, trial)
    across = soft / m.impratio
    weights[contact] = wp.vec3(1.0 / soft, 1.0 / across, two * two / (across * one * one))
    cones[contact] = wp.vec3(one / wp.sqrt(m.impratio), one, two)


@wp.func
def find_limits(m: Model, trial: int, qpos: Numbers, qvel: Numbers, wanted: wp.array(dtype=wp.vec2), weights: wp.array(dtype=wp.vec2)):
    """Reference accelerations and weights of each joint's lower and upper limit; weight 0 = not reached."""
    for d in range(qpos.shape[0]):
        wanted[d] = wp.vec2(0.0)
        weights[d] = wp.vec2(0.0)
        if m.jnt_limited[d] == 1:
            margin = value(m.jnt_margin, d, trial)
            below = qpos[d] - entry(m.jnt_range, d, 0, trial) - margin
            above = entry(m.jnt_range, d, 1, trial) - qpos[d] - margin
            if below < 0.0 or above < 0.0:
                low = limit(m, trial, d, below, qvel[d])
                high = limit(m, trial, d, above, -qvel[d])
                wanted[d] = wp.vec2(low[0], high[0])
                weights[d] = wp.vec2(low[1], high[1])


@wp.func
def limit(m: Model, trial: int, d: int, depth: float, speed: float) -> wp.vec2:
    """Reference acceleration and weight of one limit."""
    if depth >= 0.0:
        return wp.vec2(0.0)
    spring = reference(m, m.jnt_solref, m.jnt_solimp, d, trial)
    strength = impedance(m.jnt_solimp, d, trial, depth)
    soft = wp.max((1.0 - strength) * value(m.dof_invweight0, d, trial) / strength, LEAST)
    return wp.vec2(-spring[1] * speed - spring[0] * strength * depth, 1.0 / soft)
