"""A robot as data: any serial arm of hinges with a site at its wrist, from a table or from an MJCF file.

What an assembly needs besides links and joints is added here, the same for every arm: position servos, a body for
the part in the hand, and the wrist's force and torque sensor.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float64

from rcbht_jax.errors import InputError
from sim_mjx.assembly.robot import add_visual
from sim_mjx.own_code import finite, own_code

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
SERVO_SPEED, SERVO_DAMPING = 300.0, 0.8  # rad/s and share of critical damping of every joint at home
HAND, FORCE, TORQUE = "HAND", "HAND_FORCE", "HAND_TORQUE"  # body that carries the part; sensors
SIZES = (  # of a whole model, in MjSpec
    "memory", "njmax", "nconmax", "nstack", "nuserdata", "nkey", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site",
    "nuser_cam", "nuser_tendon", "nuser_actuator", "nuser_sensor",
)  # fmt: skip
ARM = "arm/"  # begins the names of what comes from a file
TOOL_RADIUS = 0.03  # m, of the ball that has the tool's inertia


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm that can carry out assemblies.

    Raises:
        InputError: the name is no word; home, place or tool_mass are no finite numbers, or not as many as they must
            be; or the mass is negative.

    Example:
        >>> from sim_mjx.robots import ROBOTS
        >>> len(ROBOTS["panda"].joints), len(ROBOTS["ur5e"].joints)
        (7, 6)
    """

    name: str
    build: Callable[[], mujoco.MjSpec]  # links and joints alone; angles in radians
    wrist: str  # site, whose z axis points out of the hand; parts are put together with its x axis along the world's
    home: tuple[float, ...]  # rad, a pose with the hand about above ``place`` and pointing down
    place: Vector  # m, world, where parts are put together
    tool_mass: float = 0.4  # kg, of what hangs behind the wrist's sensor

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise InputError(f"{self.name!r} names a robot; expected a word.")
        for name, shape, expected in (
            ("home", (-1,), "finite numbers, one for each joint"),
            ("place", (3,), "three finite numbers"),
            ("tool_mass", (), "a finite number"),
        ):
            if not finite(values := getattr(self, name), *shape):
                raise InputError(f"{name} of the robot {self.name} is {values}; expected {expected}.")
        if self.tool_mass < 0:
            raise InputError(f"tool_mass of the robot {self.name} is {self.tool_mass} kg; expected zero or more.")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the hinges that move the wrist, from the base on."""
        return _joints(self)


def from_mjcf(
    path: str | Path, *, site: str, home: Sequence[float], place: Vector, name: str = "", tool_mass: float = 0.4
) -> Robot:
    """A robot from an MJCF file; its actuators, limits of their forces, sensors, contacts and options are not used.

    Args:
        path: the file.
        site: name of the site at the wrist; its z axis points out of the hand, and its x axis along the world's when
            parts are put together.
        home: joint angles from the base on, rad, with the hand about above ``place`` and pointing down.
        place: where parts are put together, m, in world axes.
        name: default the file's.
        tool_mass: mass carried by the wrist's sensor, kg.

    Raises:
        InputError: the file cannot be read as MJCF, has no such site or no joints that move it, or has a
            ``settotalmass``; or a number is impossible.
    """
    source = Path(path)
    if not source.is_file():
        raise InputError(f"There is no file {source}.")

    def build() -> mujoco.MjSpec:
        try:
            own = mujoco.MjSpec.from_file(str(source))
        except ValueError as error:
            raise InputError(f"{source} cannot be read as MJCF: {' '.join(str(error).split())}.") from error
        if own.site(site) is None:
            raise InputError(f"{source} has no site {site!r}, which must mark the wrist's frame.")
        if own.compiler.settotalmass > 0:  # which MuJoCo ignores in what is attached
            raise InputError(f"{source} sets the arm's mass by settotalmass; give its bodies their masses.")
        # on a new model the file's defaults, options, names and unit of angles are the arm's alone
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        for setting in ("option", "visual", "stat", *SIZES):  # else each would be reported as a conflict
            setattr(own, setting, getattr(spec, setting))
        spec.attach(own, prefix=ARM, frame=spec.worldbody.add_frame())
        return spec

    angles: Any = tuple(home) if finite(home, -1) else home  # which the robot refuses
    robot = Robot(name or source.stem, build, f"{ARM}{site}", angles, place, tool_mass)
    _joints(robot)  # which reads the file
    return robot


def _built(robot: Robot) -> mujoco.MjSpec:
    with own_code(what := f"build of the robot {robot.name}"):
        spec = robot.build()
    if not isinstance(spec, mujoco.MjSpec):
        raise InputError(f"{what} gives a {type(spec).__name__}; expected a mujoco.MjSpec.")
    spec = spec.copy()  # the user's may be the same object at every call
    for group in (spec.actuators, spec.sensors, spec.keys, spec.pairs, spec.excludes):
        for element in list(group):  # before any is compiled: a muscle may fail to
            spec.delete(element)
    return spec


@cache
def _joints(robot: Robot) -> tuple[str, ...]:
    spec = _built(robot)
    site = spec.site(robot.wrist)
    if site is None:
        raise InputError(f"The robot {robot.name} has no site {robot.wrist!r}, which must mark the wrist's frame.")
    names: list[str] = []
    body = site.parent
    while body is not None and body.name != "world":
        for joint in body.joints:
            if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
                named = repr(joint.name) if joint.name else f"without a name of the body {body.name!r}"
                raise InputError(f"The joint {named} is no hinge; an arm has hinges only.")
        names = [joint.name for joint in body.joints] + names
        body = body.parent
    if not all(names):
        raise InputError(f"A joint of the robot {robot.name} has no name; name those that move the wrist.")
    if not names:
        raise InputError(f"No joint of the robot {robot.name} moves its site {robot.wrist!r}.")
    if len(names) != len(robot.home):
        raise InputError(f"home has {len(robot.home)} angles; expected one per joint of the arm, {len(names)}.")
    return tuple(names)


def equipped(robot: Robot) -> mujoco.MjSpec:
    """The robot with servos, a body ``HAND`` at its wrist, and a force and torque sensor between the two.

    The hand's frame is the wrist's. The weight of the arm, and springs and dry friction in its joints and in tendons
    across them, are compensated in addition to the servos, as by the integral part of a real controller; the weight of
    the hand and its load is not. The arm has no contacts except the pairs that an assembly adds.

    Raises:
        InputError: the robot has no such site, or a joint that moves it is not a hinge.
    """
    spec = _built(robot)
    # Euler's method needs shorter steps than the servos' damping allows
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    for joint in map(spec.joint, robot.joints):
        joint.stiffness[:] = joint.springdamper[:] = joint.frictionloss = 0.0
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # of motors that are not used
    inertias, across = _at_home(robot)
    for tendon in itertools.compress(spec.tendons, across):
        tendon.stiffness[:] = tendon.frictionloss = 0.0
    # torque = kp (command - angle) - kv velocity, as fast as each joint's own inertia allows
    for name, inertia in zip(robot.joints, inertias, strict=True):
        servo = spec.add_actuator(name=f"{name}_SERVO", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=inertia * SERVO_SPEED**2, kv=2 * SERVO_DAMPING * inertia * SERVO_SPEED)
    _add_hand(spec, robot)
    return spec


def _at_home(robot: Robot) -> tuple[Float64[np.ndarray, " joint"], Bool[np.ndarray, " tendon"]]:
    """Each joint's inertia, kg m^2, with the tool on the wrist and other joints held; which tendons the joints pull."""
    spec = _built(robot)
    _add_hand(spec, robot)
    model = spec.compile()
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[[model.joint(name).qposadr[0] for name in robot.joints]] = robot.home
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    rows, pulls = [model.joint(name).dofadr[0] for name in robot.joints], np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(pulls, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
    return full[rows, rows], np.any(np.abs(pulls[:, rows]) > 1e-9, axis=1)


@cache
def _wrist(robot: Robot) -> tuple[Vector, Quaternion]:
    """The wrist's frame in its body's, as compiled: an element holds neither Euler angles nor a frame around it."""
    site = _built(robot).compile().site(robot.wrist)
    return tuple(site.pos), tuple(site.quat)


def _add_hand(spec: mujoco.MjSpec, robot: Robot) -> None:
    place, turn = _wrist(robot)
    inertia = 0.4 * robot.tool_mass * TOOL_RADIUS**2
    # of the model's own defaults, not of the class that an arm gives its links
    hand = spec.site(robot.wrist).parent.add_body(spec.default, name=HAND, pos=place, quat=turn)
    hand.mass, hand.inertia, hand.explicitinertial = robot.tool_mass, (inertia, inertia, inertia), True
    hand.ipos = (0.0, 0.0, 0.03)
    hand.add_site(name=HAND)
    for name, sensor in ((FORCE, mujoco.mjtSensor.mjSENS_FORCE), (TORQUE, mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=name, type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=HAND)


@dataclass(frozen=True)
class Link:
    """A row of a robot's table: the frame of a hinge's link in that of the one before, and its inertia."""

    place: Vector  # m
    turn: Quaternion
    mass: float  # kg
    com: Vector  # m
    inertia: tuple[float, float, float, float, float, float]  # kg m^2 about the centre: xx yy zz xy xz yz
    limits: tuple[float, float]  # rad
    axis: Vector = (0.0, 0.0, 1.0)
    anchor: Vector = (0.0, 0.0, 0.0)  # m, a point of the axis
    armature: float = 0.1  # kg m^2, of motor and gear seen from the joint
    to: Vector = (0.0, 0.0, 0.0)  # m, end of the capsule that is drawn, from this frame's origin
    radius: float = 0.05  # m, of the capsule


def arm(
    links: Sequence[Link],
    flange: Vector,
    flange_turn: Quaternion = (1.0, 0.0, 0.0, 0.0),
    base_turn: Quaternion = (1.0, 0.0, 0.0, 0.0),
) -> mujoco.MjSpec:
    """A model of an arm from its table: joints ``JOINT1`` ..., and the site ``WRIST`` on the last link.

    Args:
        links: from the base on.
        flange: m, the wrist in the last link's frame. flange_turn: quaternion.
        base_turn: quaternion of the base in the world.
    """  # fmt: skip
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    body = spec.worldbody.add_body(name="BASE", quat=base_turn)
    for number, link in enumerate(links, 1):
        body = body.add_body(name=f"LINK{number}", pos=link.place, quat=link.turn)
        body.mass, body.ipos, body.fullinertia, body.explicitinertial = link.mass, link.com, link.inertia, True
        body.add_joint(
            name=f"JOINT{number}", axis=link.axis, pos=link.anchor, range=link.limits, armature=link.armature
        )
        if any(link.to):
            add_visual(body, (0.0, 0.0, 0.0), link.to, link.radius)
    body.add_site(name="WRIST", pos=flange, quat=flange_turn)
    return spec
