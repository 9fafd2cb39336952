"""Random models that the fused kernel accepts, and states of them in which spheres touch boxes."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim_mjx.assembly.rollout import ONE_ARM
from sim_mjx.assembly.scene import Scene, compiled


@dataclass(frozen=True)
class Shape:
    """Numbers of bodies that can move or be welded, joints and pairs; the kernel is compiled for each."""

    bodies: int
    joints: int
    pairs: int


def text(values: object) -> str:
    """Numbers as an attribute of MJCF."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, float)))


def turn(rng: np.random.Generator) -> str:
    """A random rotation, or none."""
    return text(rng.normal(size=4)) if rng.random() < 0.7 else "1 0 0 0"


def solver(rng: np.random.Generator) -> str:
    """Random solref and solimp."""
    direct = [-rng.uniform(50, 3000), -rng.uniform(1, 60)]
    spring = [rng.choice([0.001, 0.004, 0.02, 0.1]), rng.choice([0.3, 1.0, 2.0])]
    ref = direct if rng.random() < 0.3 else spring
    width = rng.choice([0.0, 0.0005, 0.001, 0.01])
    low, high = np.sort(rng.uniform(0.3, 0.99, 2)) if rng.random() < 0.7 else np.full(2, rng.uniform(0.5, 0.95))
    return text(ref), text([low, high, width, rng.uniform(0.2, 0.8), rng.choice([1.0, 1.5, 2.0, 3.0])])


def joint(rng: np.random.Generator, number: int) -> str:
    """A random joint."""
    slide = rng.random() < 0.35
    out = f'<joint name="j{number}" type="{"slide" if slide else "hinge"}" axis="{text(rng.normal(size=3))}"'
    out += f' pos="{text(rng.normal(size=3) * 0.05 * (rng.random() < 0.7))}" ref="{text(rng.normal() * 0.3)}"'
    if rng.random() < 0.6:
        out += f' armature="{text(10 ** rng.uniform(-4, -0.5))}"'
    if rng.random() < 0.6:
        out += f' stiffness="{text(10 ** rng.uniform(-1, 2))}" springref="{text(rng.normal() * 0.3)}"'
    if rng.random() < 0.7:
        out += f' damping="{text(10 ** rng.uniform(-2, 1))}"'
    if rng.random() < 0.6:
        ref, imp = solver(rng)
        middle, half = rng.normal() * 0.05, rng.choice([0.001, 0.02, 0.1, 0.3])
        margin = rng.choice([0.0, 0.0, 0.01])
        out += f' limited="true" range="{text([middle - half, middle + half])}" margin="{text(margin)}"'
        out += f' solreflimit="{ref}" solimplimit="{imp}"'
    return out + "/>"


def actuators(rng: np.random.Generator, joints: int) -> str:
    """At most one actuator of a joint, of all affine kinds, in a random order."""
    out = ""
    for number in rng.permutation(joints):
        kind = rng.choice(["none", "motor", "position", "velocity", "general"], p=[0.2, 0.15, 0.35, 0.1, 0.2])
        if kind == "none":
            continue
        out += f'<{kind} joint="j{number}" gear="{text(rng.choice([1.0, -2.0, 0.5, 30.0]))}"'
        if rng.random() < 0.5:
            low, high = np.sort(rng.normal(size=2) * rng.choice([0.3, 30.0]))
            out += f' forcelimited="true" forcerange="{text([min(low, -0.01), max(high, 0.01)])}"'
        if kind == "position":
            out += f' kp="{text(10 ** rng.uniform(0, 3))}" kv="{text(rng.choice([0.0, 1.0, 20.0]))}"'
        if kind == "velocity":
            out += f' kv="{text(10 ** rng.uniform(-1, 1.3))}"'
        if kind == "general":
            bias = text([rng.normal(), -rng.uniform(0, 50), -rng.uniform(0, 5)])
            out += f' gainprm="{text(rng.normal() * 5)}" biasprm="{bias}"'
            out += f' biastype="{rng.choice(["affine", "none"])}"'
        out += "/>"
    return out


def inertial(rng: np.random.Generator, masses: tuple[float, float]) -> str:
    """Mass and inertia about tilted principal axes."""
    mass = 10 ** rng.uniform(*np.log10(masses))
    size = rng.uniform(0.02, 0.15, 3) ** 2
    inertia = mass * (size.sum() - size) / 3
    place = text(rng.normal(size=3) * 0.05)
    return f'<inertial pos="{place}" quat="{turn(rng)}" mass="{text(mass)}" diaginertia="{text(inertia)}"/>'


def xml(rng: np.random.Generator, shape: Shape, masses: tuple[float, float]) -> str:
    """A random tree with its pairs, actuators and sensors, as MJCF."""
    parents = [int(rng.integers(max(0, b - 3), b + 1)) for b in range(shape.bodies)]  # 0 = the world
    if shape.bodies > 1:
        parents[-1] = shape.bodies - 1
    owners = np.sort(rng.integers(0 if rng.random() < 0.3 else 1, shape.bodies, shape.joints))
    owners[-1] = max(owners[-1], shape.bodies - 2)  # that sensors read something that moves
    geoms = dict.fromkeys(range(shape.bodies + 1), "")
    pairs = ""
    for p in range(shape.pairs):
        first, second = rng.choice(shape.bodies + 1, 2, replace=False)
        if rng.random() < 0.6:
            first, second = shape.bodies - int(rng.integers(0, 2)), 0
        radius = rng.choice([0.002, 0.01, 0.03])
        geoms[first] += (
            f'<geom name="s{p}" type="sphere" size="{text(radius)}" pos="{text(rng.normal(size=3) * 0.1)}" mass="0"/>'
        )
        half = rng.uniform(0.005, 0.1, 3)
        geoms[second] += f'<geom name="b{p}" type="box" size="{text(half)}" pos=".1 .2 .3" quat="1 2 3 4" mass="0"/>'
        ref, imp = solver(rng)
        friction = rng.uniform(0.05, 1.2, 2) if rng.random() < 0.5 else np.full(2, rng.uniform(0.05, 1.2))
        margin = rng.choice([0.0, 0.0, 0.002])
        gap = rng.choice([0.0, 0.5]) * margin
        order = [f'geom1="s{p}" geom2="b{p}"', f'geom1="b{p}" geom2="s{p}"'][int(rng.integers(2))]
        pairs += (
            f'<pair {order} condim="3" friction="{text([*friction, 0.005, 0.0001, 0.0001])}" margin="{text(margin)}"'
        )
        pairs += f' gap="{text(gap)}" solref="{ref}" solimp="{imp}"/>'
    where = [shape.bodies, int(rng.integers(1, shape.bodies + 1))]
    sites = dict.fromkeys(range(shape.bodies + 1), "")
    for k, b in enumerate(where):
        sites[b] += f'<site name="w{k}" pos="{text(rng.normal(size=3) * 0.05)}" quat="{turn(rng)}"/>'

    def body(number: int) -> str:
        joints = [joint(rng, int(j)) for j in np.flatnonzero(owners == number - 1)]
        welded = not joints and rng.random() < 0.3
        comp = rng.choice([0.0, 0.0, 1.0, rng.random()])
        place = text(rng.normal(size=3) * 0.15)
        out = f'<body name="l{number}" pos="{place}" quat="{turn(rng)}" gravcomp="{text(comp)}">'
        out += "" if welded else inertial(rng, masses)
        out += "".join(joints) + geoms[number] + sites[number]
        out += "".join(body(child + 1) for child, parent in enumerate(parents) if parent == number)
        return out + "</body>"

    gravity = rng.normal(size=3) * 5 if rng.random() < 0.5 else [0, 0, -9.81]
    step = rng.choice([0.0005, 0.000625, 0.002, 0.005])
    ratio = rng.choice([1.0, 1.0, 3.0, 10.0])
    roots = "".join(body(child + 1) for child, parent in enumerate(parents) if parent == 0)
    sensors = "".join(f'<force name="f{k}" site="w{k}"/><torque site="w{k}"/>' for k in range(2))
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false" balanceinertia="true"/>'
        f'<option integrator="implicitfast" cone="elliptic" iterations="100" ls_iterations="50" tolerance="1e-10"'
        f' gravity="{text(gravity)}" timestep="{text(step)}" impratio="{text(ratio)}"/>'
        f'<default><geom contype="0" conaffinity="0"/></default>'
        f"<worldbody>{geoms[0]}{roots}</worldbody><contact>{pairs}</contact>"
        f"<actuator>{actuators(rng, shape.joints)}</actuator><sensor>{sensors}</sensor></mujoco>"
    )  # fmt: skip


def scene_of(xml: str, joints: int, pairs: int, wrists: int = 2) -> Scene:
    """The scene of a model whose elements have this module's names."""
    spec = mujoco.MjSpec.from_string(xml)
    tabs = [(f"s{p}", f"b{p}") for p in range(pairs)]
    names = [f"j{j}" for j in range(joints)]
    return compiled(spec, ONE_ARM, names, [f"f{k}" for k in range(wrists)], tabs, lambda *_: {}, 1)


def random_scene(
    rng: np.random.Generator, shape: Shape, masses: tuple[float, float] = (0.05, 3.0)
) -> tuple[Scene, NDArray[np.float64]]:
    """A random scene, and positions of its joints in which most spheres touch their boxes."""
    scene = scene_of(xml(rng, shape, masses), shape.joints, shape.pairs)
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + rng.normal(size=model.nq) * 0.1
    mujoco.mj_kinematics(model, data)
    for p in range(model.npair):
        touch(rng, model, data, p)
    return scene, data.qpos.copy()


def touch(rng: np.random.Generator, model: mujoco.MjModel, data: mujoco.MjData, pair: int) -> None:
    """Move a pair's box so that the sphere touches one of its corners, edges or faces, or is inside."""
    ball, box = model.pair_geom1[pair], model.pair_geom2[pair]
    half, radius = model.geom_size[box], model.geom_size[ball, 0]
    sides = rng.choice([-1.0, 1.0], 3)
    free = rng.choice(3, int(rng.integers(0, 3)), replace=False)  # none = a corner, one = an edge, two = a face
    out = sides.copy()
    out[free] = 0.0
    place = half * sides
    place[free] *= rng.uniform(0, 1, len(free))
    out *= rng.uniform(0.2, 1, 3)
    depth = rng.uniform(-0.0005, 0.002) if rng.random() < 0.85 else radius + 0.2 * half.min()
    local = place + out / np.linalg.norm(out) * (radius - depth)
    wide, quat, inverse = np.zeros(3), rng.normal(size=4), np.zeros(4)
    quat /= np.linalg.norm(quat)
    mujoco.mju_rotVecQuat(wide, local, quat)
    body = model.geom_bodyid[box]
    shift = data.geom_xpos[ball] - wide - data.xpos[body]
    mujoco.mju_negQuat(inverse, data.xquat[body])
    mujoco.mju_rotVecQuat(model.geom_pos[box], shift, inverse)
    mujoco.mju_mulQuat(model.geom_quat[box], inverse, quat)
