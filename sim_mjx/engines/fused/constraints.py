"""Contacts of spheres with boxes, and limits of joints, as rows of MuJoCo's constraint problem.

Formulas: MuJoCo's documentation, "Computation", sections "Constraint model" and "Friction cones".
"""

from functools import lru_cache
from typing import Any

import warp as wp

from sim_mjx.engines.fused.dynamics import Numbers, Rotations, Spatial, Vectors
from sim_mjx.engines.fused.model import (
    Model,
    Rows,
    entry,
    inverse_root,
    reciprocal,
    rotation,
    shapes,
    value,
    vector,
)

Pairs = wp.array(dtype=wp.vec2)
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
    x = wp.abs(depth) * reciprocal(width)
    if x >= 1.0:
        return high
    y = x
    if power == 2.0:  # the default, without two calls of a power function
        y = x * x * reciprocal(middle)
        if x > middle:
            y = 1.0 - (1.0 - x) * (1.0 - x) * reciprocal(1.0 - middle)
    elif power > 1.0:
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
        return wp.vec2(-first * reciprocal(high * high), -second * reciprocal(high))
    time = wp.max(first, 2.0 * m.timestep)
    root = high * time * second
    return wp.vec2(reciprocal(wp.max(root * root, LEAST)), 2.0 * reciprocal(high * time))


@wp.func
def sphere_on_box(centre: wp.vec3, radius: float, half: wp.vec3) -> wp.vec4:
    """Unit vector from the sphere into the box, in the box's axes, and the distance of the surfaces, m."""
    nearest = wp.vec3(
        wp.clamp(centre[0], -half[0], half[0]),
        wp.clamp(centre[1], -half[1], half[1]),
        wp.clamp(centre[2], -half[2], half[2]),
    )
    out = nearest - centre
    square = wp.dot(out, out)
    if square > 0.0:
        scale = inverse_root(square)
        return wp.vec4(scale * out[0], scale * out[1], scale * out[2], scale * square - radius)
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
def frame_of(normal: wp.vec3) -> wp.mat33:
    """Rows: a contact's normal, and MuJoCo's two tangents."""
    side = wp.vec3(0.0, 1.0, 0.0)
    if normal[1] >= 0.5 or normal[1] <= -0.5:
        side = wp.vec3(0.0, 0.0, 1.0)
    along = side - wp.dot(normal, side) * normal
    along = along * inverse_root(wp.dot(along, along))
    return wp.matrix_from_rows(normal, along, wp.cross(normal, along))


@wp.func
def limit(m: Model, trial: int, d: int, depth: float, speed: float) -> wp.vec2:
    """Reference acceleration and weight of one limit of a joint."""
    if depth >= 0.0:
        return wp.vec2(0.0)
    spring = reference(m, m.jnt_solref, m.jnt_solimp, d, trial)
    strength = impedance(m.jnt_solimp, d, trial, depth)
    soft = wp.max((1.0 - strength) * value(m.dof_invweight0, d, trial) * reciprocal(strength), LEAST)
    return wp.vec2(-spring[1] * speed - spring[0] * strength * depth, reciprocal(soft))


@wp.func
def find_limits(m: Model, trial: int, qpos: Numbers, qvel: Numbers, wanted: Pairs, weights: Pairs):
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
def find_contacts(
    m: Model, trial: int, pos: Vectors, rot: Rotations, pairs: Numbered, points: Vectors, normals: Vectors,
    depths: wp.array(dtype=float),
) -> int:  # fmt: skip
    """Fill in the contacts that there are, and count them: their pairs, places, normals and depths, negative."""
    count = int(0)
    last_ball = int(-1)
    last_body = int(-1)
    centre = wp.vec3(0.0)
    seen = wp.vec3(0.0)
    for p in range(m.pair_geom.shape[0]):
        ball = m.pair_geom[p, 0]
        box = m.pair_geom[p, 1]
        first = m.geom_bodyid[ball]
        second = m.geom_bodyid[box]
        if ball != last_ball or second != last_body:
            centre = pos[first] + wp.quat_rotate(rot[first], vector(m.geom_pos, ball, trial))
            seen = wp.quat_rotate_inv(rot[second], centre - pos[second])
            last_ball = ball
            last_body = second
        turn = rotation(m.geom_quat, box, trial)
        local = wp.quat_rotate_inv(turn, seen - vector(m.geom_pos, box, trial))
        radius = entry(m.geom_size, ball, 0, trial)
        half = vector(m.geom_size, box, trial)
        margin = value(m.pair_margin, p, trial)
        apart = m.body_moves[first] == m.body_moves[second]  # both fixed, or to each other: no joint feels a contact
        if (
            not apart and wp.max(wp.abs(local) - half) < radius + margin
        ):  # else they are apart along one of the box's axes
            touch = sphere_on_box(local, radius, half)
            depth = touch[3] - margin
            if depth < 0.0:
                normal = wp.quat_rotate(rot[second], wp.quat_rotate(turn, wp.vec3(touch[0], touch[1], touch[2])))
                pairs[count] = p
                points[count] = centre + normal * (radius + 0.5 * touch[3])
                normals[count] = normal
                depths[count] = depth
                count += 1
    return count


@lru_cache
def contact_rows(n: int) -> Any:
    """What makes the rows of contacts in a model with ``n`` joints."""
    _, _, wide = shapes(n)

    @wp.func
    def jacobian(m: Model, first: int, second: int, point: wp.vec3, frame: wp.mat33, axes: Spatial) -> wide:
        """By each joint's velocity, that of the second body relative to the first at a point, in a contact's frame."""
        out = wide()
        for d in range(n):
            sign = ((m.body_moves[second] >> d) & 1) - ((m.body_moves[first] >> d) & 1)
            if sign != 0:
                moved = wp.spatial_bottom(axes[d]) + wp.cross(wp.spatial_top(axes[d]), point)
                seen = frame * (float(sign) * moved)
                out[0, d] = seen[0]
                out[1, d] = seen[1]
                out[2, d] = seen[2]
        return out

    @wp.func
    def make_rows(
        m: Model, trial: int, axes: Spatial, qvel: Numbers, count: int, pairs: Numbered, points: Vectors,
        normals: Vectors, depths: Numbers, rows: wp.array(dtype=wide), wanted: Vectors, weights: Vectors,
        cones: Vectors,
    ):  # fmt: skip
        """Fill in the rows of contacts.

        ``rows`` are Jacobians along normal and tangents, ``wanted`` reference accelerations, ``weights`` inverse
        regularisers, ``cones`` the regularised and the two tangents' coefficients of friction.
        """
        for c in range(count):
            p = pairs[c]
            depth = depths[c]
            first = m.geom_bodyid[m.pair_geom[p, 0]]
            second = m.geom_bodyid[m.pair_geom[p, 1]]
            own = jacobian(m, first, second, points[c], frame_of(normals[c]), axes)
            rows[c] = own
            speed = wp.vec3(0.0)
            for d in range(n):
                speed += wp.vec3(own[0, d], own[1, d], own[2, d]) * qvel[d]
            spring = reference(m, m.pair_solref, m.pair_solimp, p, trial)
            strength = impedance(m.pair_solimp, p, trial, depth)
            soft = wp.max((1.0 - strength) * value(m.pair_invweight, p, trial) * reciprocal(strength), LEAST)
            one = entry(m.pair_friction, p, 0, trial)
            two = entry(m.pair_friction, p, 1, trial)
            hard = reciprocal(soft)
            ratio = two * reciprocal(one)
            wanted[c] = -spring[1] * speed - wp.vec3(spring[0] * strength * depth, 0.0, 0.0)
            weights[c] = hard * wp.vec3(1.0, m.impratio, m.impratio * ratio * ratio)
            cones[c] = wp.vec3(one * inverse_root(m.impratio), one, two)

    return make_rows
