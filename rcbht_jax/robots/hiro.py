"""HIRO's arms: kinematic and inertial table, identified from the recordings to 0.001-0.006 mm.

World frame: the robot's base, x forward, y left, z up; the waist is 0.45 m above the floor and the chest does
not turn, so it has no joint. SI units, radians unless a field states degrees. The left arm is the right one mirrored
in the x-z plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rcbht_jax.errors import InputError

Vector = tuple[float, float, float]
Joints = tuple[float, float, float, float, float, float]

CHEST_HEIGHT = 0.450
SHOULDER_ROLL = math.radians(15.0)
MIRROR: Joints = (-1.0, 1.0, 1.0, -1.0, 1.0, -1.0)  # left arm's angle / right arm's angle in the mirrored pose


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
