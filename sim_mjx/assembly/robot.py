"""HIRO's arms as MuJoCo bodies, servos and wrist sensors; its dimensions are in ``rcbht_jax.robots.hiro``.

Names in the model, ``arm`` being "R" or "L": bodies ``RARM_LINK0..5`` and ``RARM_TOOL``, joints
``RARM_JOINT0..5``, actuators ``RARM_SERVO0..5``, sites ``RARM_FT`` and ``RARM_TCP``, sensors ``RARM_FORCE`` and
``RARM_TORQUE``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco

from rcbht_jax.robots.hiro import ARMS, CHEST_HEIGHT, SHOULDER_ROLL, TCP, Joints, Vector, flip, side

UNIT = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


# Position servos: torque = KP (command - angle) - KV velocity, joint by joint. They give every joint, at the pose of
# contact, about 500 rad/s and 0.6 of critical damping. A ramp is followed 2.5 ms late (KV / KP), a command held for a
# control period another 2.5 ms late; the rest of the recorded 20-25 ms is pure delay of the command and not part of the
# model. The encoders of session A stay within 0.5 mrad of the delayed command under 15 N, so the servos are stiff. The
# weight of the arm, not of the tool, is compensated besides (``gravcomp``), as by the integral part of a real one.
KP: Joints = (95e3, 145e3, 65e3, 7000.0, 11000.0, 2800.0)  # Nm/rad
KV: Joints = (237.5, 362.5, 162.5, 17.5, 27.5, 7.0)  # Nms/rad
# What hangs behind the force sensor, besides the part. Its weight is what session C's untared wrench shows, about 4 N;
# its centre what the drift of My shows while session A's hand turns on its way down.
TOOL_MASS, TOOL_RADIUS = 0.41, 0.02  # kg; m, of the ball that has its inertia
TOOL_COM: Vector = (-0.088, 0.0, -0.0225)  # m, wrist frame


def new_robot(arms: Sequence[str] = ("R",)) -> mujoco.MjSpec:
    """A model specification with the robot alone, to which a scene adds its parts.

    Args:
        arms: which arms it has.

    Returns:
        the specification, angles in radians, integrator ``implicitfast``; a part in the hand goes to
        ``spec.body("RARM_TOOL")``, whose frame is the wrist's.

    Raises:
        InputError: an arm is neither "R" nor "L".
    """
    spec = mujoco.MjSpec()
    spec.modelname = "hiro"
    spec.compiler.degree = False
    # Euler's method needs shorter steps than the servos' damping allows; this one is stable up to 5 ms.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    chest = spec.worldbody.add_body(name="CHEST", pos=(0.0, 0.0, CHEST_HEIGHT))
    add_visual(chest, (0.0, 0.12, 0.35), (0.0, -0.12, 0.35), 0.06)
    for arm in arms:
        _add_arm(spec, chest, arm)
    return spec


def _add_arm(spec: mujoco.MjSpec, chest: mujoco.MjsBody, arm: str) -> None:
    """Add one arm with its servos, tool and wrist sensor."""
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
        add_visual(body, (0.0, 0.0, 0.0), link.shape, link.radius)
        actuator = spec.add_actuator(name=f"{arm}ARM_SERVO{i}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=KP[i], kv=KV[i])
    _add_tool(spec, body, arm)


def _add_tool(spec: mujoco.MjSpec, wrist: mujoco.MjsBody, arm: str) -> None:
    """Hang the tool on the last link, with the force and torque sensor, in the wrist's frame, between the two."""
    inertia = 0.4 * TOOL_MASS * TOOL_RADIUS**2
    body = wrist.add_body(name=f"{arm}ARM_TOOL", mass=TOOL_MASS, explicitinertial=True)
    body.ipos, body.inertia = TOOL_COM if arm == "R" else flip(TOOL_COM), (inertia, inertia, inertia)
    body.add_site(name=f"{arm}ARM_FT")
    body.add_site(name=f"{arm}ARM_TCP", pos=TCP[arm])
    # MuJoCo reports what the wrist exerts on the tool, at rest the weight upwards; recordings have the opposite sign
    for kind, sensor in (("FORCE", mujoco.mjtSensor.mjSENS_FORCE), ("TORQUE", mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=f"{arm}ARM_{kind}", type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"{arm}ARM_FT")


def add_visual(body: mujoco.MjsBody, start: Vector, end: Vector, radius: float) -> None:
    """Add a capsule that is drawn and touches nothing, m."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(*start, *end), size=(radius, 0.0, 0.0), contype=0, conaffinity=0,
        group=2, rgba=(0.7, 0.7, 0.75, 1.0),
    )  # fmt: skip
