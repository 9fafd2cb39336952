"""HIRO's arms: the kinematic and inertial table, and its MuJoCo bodies, servos and wrist sensors.

World frame: the robot's base, x forward, y left, z up; the waist is 0.45 m above the floor and the chest does
not turn, so it has no joint. SI units, radians. The left arm is the right one mirrored in the x-z plane.
Names in the model, ``arm`` being "R" or "L": bodies ``RARM_LINK0..5`` and ``RARM_TOOL``, joints
``RARM_JOINT0..5``, actuators ``RARM_SERVO0..5``, sites ``RARM_FT`` and ``RARM_TCP``, sensors ``RARM_FORCE`` and
``RARM_TORQUE``.
Source: the design's verified table (identified from the recordings to 0.001-0.006 mm).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco

from rcbht_jax.errors import InputError

Vector = tuple[float, float, float]
Joints = tuple[float, float, float, float, float, float]

CHEST_HEIGHT = 0.450
SHOULDER_ROLL = math.radians(15.0)
MIRROR: Joints = (-1.0, 1.0, 1.0, -1.0, 1.0, -1.0)  # left arm's angle / right arm's angle in the mirrored pose
UNIT = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Link:
    """One joint and the link that it moves."""

    offset: Vector  # m, joint origin in the parent's frame; of the first joint in the chest's
    axis: str  # "x", "y" or "z" of the link
    limits: tuple[float, float]  # degrees
    mass: float  # kg
    com: Vector  # m, link frame
    inertia: Joints  # kg m2 about the centre of mass: xx yy zz xy xz yz
    armature: float  # kg m2, the rotor seen through the gear: reduction squared times rotor inertia
    shape: Vector  # m, where the visual capsule ends; it starts at the joint
    radius: float  # m, of that capsule


@dataclass(frozen=True)
class Servo:
    """Position servos: torque = kp (command - angle) - kv velocity, joint by joint.

    The defaults give every joint, at the pose of contact, about 500 rad/s and 0.6 of critical damping. A ramp is
    followed 2.5 ms late (kv / kp), a command held for a control period another 2.5 ms late; the rest of the
    recorded 20-25 ms is pure delay of the command and not part of the model. The encoders of session A stay
    within 0.5 mrad of the delayed command under 15 N, so the servos are stiff. The weight of the arm, not of
    the tool, is carried beside the servo (``gravcomp``), as by the integral part of a real one.
    """

    kp: Joints = (95e3, 145e3, 65e3, 7000.0, 11000.0, 2800.0)  # Nm/rad
    kv: Joints = (237.5, 362.5, 162.5, 17.5, 27.5, 7.0)  # Nms/rad


@dataclass(frozen=True)
class Tool:
    """What hangs behind the force sensor; the part to be mated is added to its body.

    Its weight is what session C's untared wrench shows, about 4 N; its centre what the drift of My shows while
    session A's hand turns on its way down.
    """

    mass: float = 0.41  # kg
    com: Vector = (-0.088, 0.0, -0.0225)  # m, wrist frame
    radius: float = 0.02  # m, of the ball that has its inertia


RIGHT = (
    Link(
        offset=(0.0, -0.150, 0.355),
        axis="z",
        limits=(-88.0, 88.0),
        mass=1.32626,
        com=(-0.00226388, 0.00521383, 0.01560807),
        inertia=(0.00207537, 0.00240295, 0.00141912, -0.00011276, 0.00008927, 0.00004570),
        armature=273**2 * 1.5e-6,
        shape=(0.0, -0.03, 0.0),
        radius=0.06,
    ),
    Link(
        offset=(0.0, 0.0, 0.0),
        axis="y",
        limits=(-140.0, 60.0),
        mass=1.14898,
        com=(-0.00005236, -0.05831338, -0.10706059),
        inertia=(0.01541678, 0.01471175, 0.00126575, -0.00000097, 0.00000352, -0.00213705),
        armature=200**2 * 4.2e-6,
        shape=(0.0, -0.075, -0.250),
        radius=0.045,
    ),
    Link(
        offset=(0.0, -0.080, -0.250),
        axis="y",
        limits=(-158.0, 0.0),
        mass=0.57751838,
        com=(-0.00002254, -0.00167107, -0.07151163),
        inertia=(0.00143966, 0.00141763, 0.00019720, 0.0000003, 0.0000012, 0.00007596),
        armature=200**2 * 1.5e-6,
        shape=(0.0, 0.0, -0.120),
        radius=0.04,
    ),
    Link(
        offset=(-0.020, 0.0, 0.0),
        axis="z",
        limits=(-165.0, 105.0),
        mass=0.45741788,
        com=(-0.00001788, 0.00395812, -0.20273050),
        inertia=(0.00069205, 0.00068903, 0.00013509, -0.00000003, 0.00000052, 0.00001915),
        armature=100**2 * 3.74e-7,
        shape=(0.0, 0.0, -0.230),
        radius=0.035,
    ),
    Link(
        offset=(0.0, 0.0, -0.230),
        axis="y",
        limits=(-100.0, 100.0),
        mass=0.41843443,
        com=(0.00243131, -0.00379733, -0.05770359),
        inertia=(0.00052016, 0.00050569, 0.00014004, -0.00000169, 0.0000079, 0.00005377),
        armature=200**2 * 3.74e-7,
        shape=(0.0, 0.0, -0.060),
        radius=0.03,
    ),
    Link(
        offset=(-0.0190, 0.0, -0.0800),
        axis="x",
        limits=(-163.0, 163.0),
        mass=1.05156,
        com=(-0.04847597, 0.0000032, -0.03889875),
        inertia=(0.00194072, 0.00209392, 0.00035788, -0.00000011, -0.00042482, -0.00000012),
        armature=200**2 * 1.89e-7,
        shape=(-0.030, 0.0, -0.010),
        radius=0.025,
    ),
)
RIGHT_TCP: Vector = (-0.0510, 0.0020, -0.0225)  # m, wrist frame


def mirrored(link: Link) -> Link:
    """The same link of the other arm: y turns its sign, and with it turning about x and z."""
    low, high = link.limits
    xx, yy, zz, xy, xz, yz = link.inertia
    return replace(
        link,
        offset=flip(link.offset),
        limits=link.limits if link.axis == "y" else (-high, -low),
        com=flip(link.com),
        inertia=(xx, yy, zz, -xy, xz, -yz),
        shape=flip(link.shape),
    )


def flip(vector: Vector) -> Vector:
    """A point mirrored in the x-z plane."""
    return vector[0], -vector[1], vector[2]


ARMS = {"R": RIGHT, "L": tuple(mirrored(link) for link in RIGHT)}
TCP = {"R": RIGHT_TCP, "L": flip(RIGHT_TCP)}


def side(arm: str) -> float:
    """+1 for the right arm, -1 for the left.

    Raises:
        InputError: ``arm`` is neither "R" nor "L".
    """
    if arm not in ARMS:
        raise InputError(f'Arm is {arm!r}; expected "R" or "L".')
    return 1.0 if arm == "R" else -1.0


def new_robot(arms: Sequence[str] = ("R",), servo: Servo | None = None, tool: Tool | None = None) -> mujoco.MjSpec:
    """A model specification with the robot alone, to which a scene adds its parts.

    Args:
        arms: which arms it has.
        servo: of every arm; None = the stiff default.
        tool: of every arm; None = the default.

    Returns:
        the specification, angles in radians, integrator ``implicitfast``; a part in the hand goes to
        ``spec.body("RARM_TOOL")``, whose frame is the wrist's.

    Raises:
        InputError: an arm is neither "R" nor "L", or is named twice.
    """
    if len(set(arms)) < len(arms):
        raise InputError(f"Arms are {tuple(arms)}; expected each arm once.")
    spec = mujoco.MjSpec()
    spec.modelname = "hiro"
    spec.compiler.degree = False
    # Euler's method needs shorter steps than the servos' damping allows; this one is stable up to 5 ms.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    chest = spec.worldbody.add_body(name="CHEST", pos=(0.0, 0.0, CHEST_HEIGHT))
    _add_visual(chest, (0.0, 0.12, 0.35), (0.0, -0.12, 0.35), 0.06)
    for arm in arms:
        _add_arm(spec, chest, arm, servo or Servo(), tool or Tool())
    return spec


def _add_arm(spec: mujoco.MjSpec, chest: mujoco.MjsBody, arm: str, servo: Servo, tool: Tool) -> mujoco.MjsBody:
    """Add one arm with its servos, tool and wrist sensor; returns the tool's body.

    Raises:
        InputError: ``arm`` is neither "R" nor "L", or the tool has no mass.
    """
    roll = side(arm) * SHOULDER_ROLL / 2
    body = chest
    for i, link in enumerate(ARMS[arm]):
        body = body.add_body(name=f"{arm}ARM_LINK{i}", pos=link.offset, gravcomp=1.0)
        body.mass, body.ipos, body.fullinertia, body.explicitinertial = link.mass, link.com, link.inertia, True
        if i == 0:
            body.quat = (math.cos(roll), math.sin(roll), 0.0, 0.0)
        name = f"{arm}ARM_JOINT{i}"
        limits = tuple(math.radians(angle) for angle in link.limits)
        body.add_joint(name=name, axis=UNIT[link.axis], range=limits, armature=link.armature)
        _add_visual(body, (0.0, 0.0, 0.0), link.shape, link.radius)
        actuator = spec.add_actuator(name=f"{arm}ARM_SERVO{i}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=servo.kp[i], kv=servo.kv[i])
    return _add_tool(spec, body, arm, tool)


def _add_tool(spec: mujoco.MjSpec, wrist: mujoco.MjsBody, arm: str, tool: Tool) -> mujoco.MjsBody:
    """Hang the tool on the last link, with the force and torque sensor between the two.

    The sensor's site has the wrist's frame. MuJoCo reports what the wrist exerts on the tool: hanging at rest,
    the weight upwards. The recordings have the opposite sign.
    """
    if not tool.mass > 0.0:
        raise InputError(f"The tool's mass is {tool.mass} kg; expected more than zero.")
    inertia = 0.4 * tool.mass * tool.radius**2
    body = wrist.add_body(name=f"{arm}ARM_TOOL", mass=tool.mass, explicitinertial=True)
    body.ipos, body.inertia = tool.com if arm == "R" else flip(tool.com), (inertia, inertia, inertia)
    body.add_site(name=f"{arm}ARM_FT")
    body.add_site(name=f"{arm}ARM_TCP", pos=TCP[arm])
    for kind, sensor in (("FORCE", mujoco.mjtSensor.mjSENS_FORCE), ("TORQUE", mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=f"{arm}ARM_{kind}", type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"{arm}ARM_FT")
    return body


def _add_visual(body: mujoco.MjsBody, start: Vector, end: Vector, radius: float) -> None:
    """A capsule that is seen and touches nothing."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=(*start, *end),
        size=(radius, 0.0, 0.0),
        contype=0,
        conaffinity=0,
        group=2,
        rgba=(0.7, 0.7, 0.75, 1.0),
    )
