"""One control period of every trial in one kernel, a thread for each trial."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

from sim_mjx.engines.fused import constraints, dynamics
from sim_mjx.engines.fused.model import Model, Rows, Values, rotation, shapes, vector
from sim_mjx.engines.fused.prepare import MOST_JOINTS
from sim_mjx.engines.fused.solver import newton

ITERATIONS = 20  # of the solver at most
TOLERANCE = 1e-7  # N m/s^2, square of what is missing from a joint's force, over its inertia, where the solver ends


@dataclass(frozen=True)
class Sizes:
    """Of a scene."""

    bodies: int
    joints: int
    pairs: int
    substeps: int


@wp.func
def wrenches(
    m: Model, trial: int, pos: dynamics.Vectors, rot: dynamics.Rotations, f: dynamics.Spatial, count: int,
    pairs: constraints.Numbered, points: dynamics.Vectors, normals: dynamics.Vectors, push: dynamics.Vectors,
    sensor: wp.array(dtype=int), out: wp.array2d(dtype=float),
):  # fmt: skip
    """Force and torque that each sensor's body gets from its parent, about the site, in its axes."""
    for c in range(count):
        pushed = wp.transpose(constraints.frame_of(normals[c])) * push[c]
        wrench = wp.spatial_vector(wp.cross(points[c], pushed), pushed)
        first = m.geom_bodyid[m.pair_geom[pairs[c], 0]]
        second = m.geom_bodyid[m.pair_geom[pairs[c], 1]]
        f[first] = f[first] + wrench
        f[second] = f[second] - wrench
    for k in range(m.body_parentid.shape[0] - 1):
        b = m.body_parentid.shape[0] - 1 - k
        f[m.body_parentid[b]] = f[m.body_parentid[b]] + f[b]
    for s in range(m.site_body.shape[0]):
        b = m.site_body[s]
        at = pos[b] + wp.quat_rotate(rot[b], vector(m.site_pos, s, trial))
        turn = rot[b] * rotation(m.site_quat, s, trial)
        force = wp.spatial_bottom(f[b])
        torque = wp.quat_rotate_inv(turn, wp.spatial_top(f[b]) - wp.cross(at, force))
        force = wp.quat_rotate_inv(turn, force)
        for i in range(3):
            out[trial, sensor[s] + i] = force[i]
            out[trial, sensor[s] + 3 + i] = torque[i]


@wp.func
def tip_places(m: Model, trial: int, pos: dynamics.Vectors, rot: dynamics.Rotations, out: wp.array3d(dtype=float)):
    """Each tip's place in the frame of its lip, m."""
    for t in range(m.tip_geom.shape[0]):
        tip = m.tip_geom[t, 0]
        lip = m.tip_geom[t, 1]
        first = m.geom_bodyid[tip]
        second = m.geom_bodyid[lip]
        there = pos[first] + wp.quat_rotate(rot[first], vector(m.geom_pos, tip, trial))
        there = there - pos[second] - wp.quat_rotate(rot[second], vector(m.geom_pos, lip, trial))
        place = wp.quat_rotate_inv(rot[second] * rotation(m.geom_quat, lip, trial), there)
        for i in range(3):
            out[trial, t, i] = place[i]


@lru_cache
def period(size: Sizes) -> Any:
    """The kernel of scenes of one size."""
    inertia_matrix, joint_forces = dynamics.joint_space(size.joints)
    make_rows = constraints.contact_rows(size.joints)
    (solve, implicit) = newton(size.joints)
    column, _, wide = shapes(size.joints)
    bodies = size.bodies
    joints = size.joints
    pairs = max(size.pairs, 1)
    substeps = size.substeps
    iterations = ITERATIONS
    tolerance = TOLERANCE

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False, module_options={"max_unroll": MOST_JOINTS})
    def run(
        numbers: wp.array(dtype=float),  # gravity, origin, time step, ratio of impedances
        body_parentid: wp.array(dtype=int), body_jntadr: wp.array(dtype=int), body_jntnum: wp.array(dtype=int),
        body_moves: wp.array(dtype=int), body_pos: Rows, body_quat: Rows, body_ipos: Rows, body_mass: Values,
        body_inertia: Rows, body_gravcomp: Values,
        jnt_slides: wp.array(dtype=int), jnt_limited: wp.array(dtype=int), dof_bodyid: wp.array(dtype=int),
        qpos0: Values, qpos_spring: Values, jnt_pos: Rows, jnt_axis: Rows, jnt_range: Rows, jnt_margin: Values,
        jnt_solref: Rows, jnt_solimp: Rows, jnt_stiffness: Values, dof_damping: Values, dof_armature: Values,
        dof_invweight0: Values,
        geom_bodyid: wp.array(dtype=int), geom_pos: Rows, geom_quat: Rows, geom_size: Rows,
        pair_geom: wp.array2d(dtype=int), pair_friction: Rows, pair_solref: Rows, pair_solimp: Rows,
        pair_margin: Values, pair_invweight: Values,
        jnt_actuator: wp.array(dtype=int), actuator_gain: Values, actuator_bias: Rows, actuator_range: Rows,
        site_body: wp.array(dtype=int), site_sensor: wp.array(dtype=int), site_pos: Rows, site_quat: Rows,
        tip_geom: wp.array2d(dtype=int),
        still: wp.array(dtype=int), before: wp.array2d(dtype=float), after: wp.array2d(dtype=float),
        old_qpos: wp.array2d(dtype=float), old_qvel: wp.array2d(dtype=float), old_qacc: wp.array2d(dtype=float),
        old_sensordata: wp.array2d(dtype=float),
        new_qpos: wp.array2d(dtype=float), new_qvel: wp.array2d(dtype=float), new_qacc: wp.array2d(dtype=float),
        new_sensordata: wp.array2d(dtype=float), places: wp.array3d(dtype=float),
    ):  # fmt: skip
        trial = wp.tid()
        m = Model()
        m.gravity = wp.vec3(numbers[0], numbers[1], numbers[2])
        m.origin = wp.vec3(numbers[3], numbers[4], numbers[5])
        m.timestep = numbers[6]
        m.impratio = numbers[7]
        m.body_parentid = body_parentid
        m.body_jntadr = body_jntadr
        m.body_jntnum = body_jntnum
        m.body_moves = body_moves
        m.body_pos = body_pos
        m.body_quat = body_quat
        m.body_ipos = body_ipos
        m.body_mass = body_mass
        m.body_inertia = body_inertia
        m.body_gravcomp = body_gravcomp
        m.jnt_slides = jnt_slides
        m.jnt_limited = jnt_limited
        m.dof_bodyid = dof_bodyid
        m.qpos0 = qpos0
        m.qpos_spring = qpos_spring
        m.jnt_pos = jnt_pos
        m.jnt_axis = jnt_axis
        m.jnt_range = jnt_range
        m.jnt_margin = jnt_margin
        m.jnt_solref = jnt_solref
        m.jnt_solimp = jnt_solimp
        m.jnt_stiffness = jnt_stiffness
        m.dof_damping = dof_damping
        m.dof_armature = dof_armature
        m.dof_invweight0 = dof_invweight0
        m.geom_bodyid = geom_bodyid
        m.geom_pos = geom_pos
        m.geom_quat = geom_quat
        m.geom_size = geom_size
        m.pair_geom = pair_geom
        m.pair_friction = pair_friction
        m.pair_solref = pair_solref
        m.pair_solimp = pair_solimp
        m.pair_margin = pair_margin
        m.pair_invweight = pair_invweight
        m.jnt_actuator = jnt_actuator
        m.actuator_gain = actuator_gain
        m.actuator_bias = actuator_bias
        m.actuator_range = actuator_range
        m.site_body = site_body
        m.site_pos = site_pos
        m.site_quat = site_quat
        m.tip_geom = tip_geom

        pos = wp.zeros(shape=(bodies,), dtype=wp.vec3)
        rot = wp.zeros(shape=(bodies,), dtype=wp.quat)
        mass = wp.zeros(shape=(bodies,), dtype=float)
        first = wp.zeros(shape=(bodies,), dtype=wp.vec3)
        second = wp.zeros(shape=(bodies,), dtype=wp.mat33)
        v = wp.zeros(shape=(bodies,), dtype=wp.spatial_vector)
        a = wp.zeros(shape=(bodies,), dtype=wp.spatial_vector)
        f = wp.zeros(shape=(bodies,), dtype=wp.spatial_vector)
        axes = wp.zeros(shape=(joints,), dtype=wp.spatial_vector)
        qpos = wp.zeros(shape=(joints,), dtype=float)
        qvel = wp.zeros(shape=(joints,), dtype=float)
        qacc = wp.zeros(shape=(joints,), dtype=float)
        none = wp.zeros(shape=(joints,), dtype=float)
        touching = wp.zeros(shape=(pairs,), dtype=int)
        points = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        normals = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        depths = wp.zeros(shape=(pairs,), dtype=float)
        rows = wp.zeros(shape=(pairs,), dtype=wide)
        wanted = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        weights = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        cones = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        push = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        missing = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        moved = wp.zeros(shape=(pairs,), dtype=wp.vec3)
        limits = wp.zeros(shape=(joints,), dtype=wp.vec2)
        limit_weights = wp.zeros(shape=(joints,), dtype=wp.vec2)

        for d in range(qpos.shape[0]):
            qpos[d] = old_qpos[trial, d]
            qvel[d] = old_qvel[trial, d]
            qacc[d] = old_qacc[trial, d]
        for i in range(old_sensordata.shape[1]):
            new_sensordata[trial, i] = old_sensordata[trial, i]
        for step in range(substeps):
            dynamics.move(m, trial, qpos, qvel, none, pos, rot, axes, mass, first, second, v, a, f)
            if step == 0:
                tip_places(m, trial, pos, rot, places)
            if still[trial] == 1:
                break
            dynamics.compensate(m, trial, mass, first, f)
            dynamics.sum_up(m, mass, first, second, f)
            matrix = inertia_matrix(m, trial, axes, mass, first, second)
            share = float(step + 1) / float(substeps)
            smooth, slope = joint_forces(m, trial, axes, f, qpos, qvel, before, after, share)
            count = constraints.find_contacts(m, trial, pos, rot, touching, points, normals, depths)
            make_rows(m, trial, axes, qvel, count, touching, points, normals, depths, rows, wanted, weights, cones)
            constraints.find_limits(m, trial, qpos, qvel, limits, limit_weights)
            guess = column()
            for d in range(joints):
                guess[d] = qacc[d]
            acc, total = solve(
                matrix, smooth, guess, count, rows, wanted, weights, cones, limits, limit_weights, iterations,
                tolerance, push, missing, moved,
            )  # fmt: skip
            for d in range(joints):
                qacc[d] = acc[d]
            if step == substeps - 1:
                dynamics.move(m, trial, qpos, qvel, qacc, pos, rot, axes, mass, first, second, v, a, f)
                wrenches(m, trial, pos, rot, f, count, touching, points, normals, push, site_sensor, new_sensordata)
            advanced = implicit(matrix, slope, m.timestep, total)
            for d in range(joints):
                qvel[d] += m.timestep * advanced[d]
                qpos[d] += m.timestep * qvel[d]
        for d in range(qpos.shape[0]):
            new_qpos[trial, d] = qpos[d]
            new_qvel[trial, d] = qvel[d]
            new_qacc[trial, d] = qacc[d]

    return run
