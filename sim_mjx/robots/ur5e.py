"""A 6-joint arm: the Universal Robots UR5e, from its published tables.

Source: Denavit-Hartenberg parameters, masses and centres of mass of the maker's page "DH parameters for calculations
of kinematics and dynamics". Joint limits are those of the data sheet. The inertias are those of solid rods of the
links' mass, length and radius; the rods and the motors' inertia seen from a joint (0.1 kg m^2) are chosen.
"""

from __future__ import annotations

import math

import mujoco

from sim_mjx.robots.robot import Link, Robot, Vector, arm

# a_i in m, d_i in m, alpha_i in quarter turns
DH = (
    (0.0, 0.1625, 1), (-0.425, 0.0, 0), (-0.3922, 0.0, 0), (0.0, 0.1333, 1), (0.0, 0.0997, -1), (0.0, 0.0996, 0),
)  # fmt: skip
MASS = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)  # kg
COM: tuple[Vector, ...] = (  # m
    (0.0, -0.02561, 0.00193), (0.2125, 0.0, 0.11336), (0.15, 0.0, 0.0265), (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634), (0.0, 0.0, -0.001159),
)  # fmt: skip
RODS = (  # m: radius, length and axis of the rod that has a link's inertia
    (0.06, 0.15, 1), (0.054, 0.425, 0), (0.045, 0.392, 0), (0.045, 0.12, 1), (0.045, 0.12, 1), (0.038, 0.04, 2),
)  # fmt: skip
DRAWN: tuple[Vector, ...] = (
    (0.0, -0.1, 0.0), (0.425, 0.0, 0.0), (0.3922, 0.0, 0.0), (0.0, 0.0, -0.1333), (0.0, 0.0, -0.0997),
    (0.0, 0.0, -0.06),
)  # fmt: skip
TURNS = 2 * math.pi  # rad, the joints turn by as much to either side


def build() -> mujoco.MjSpec:
    """Links and joints; the base is turned so that the arm reaches forward with its first joint at zero."""
    links = []
    for (a, d, quarters), mass, com, rod, drawn in zip(DH, MASS, COM, RODS, DRAWN, strict=True):
        half, (sine, cosine) = quarters * math.pi / 4, (quarters, 1 - abs(quarters))
        place, turn = (a, 0.0, d), (math.cos(half), math.sin(half), 0.0, 0.0)
        axis, anchor = (0.0, float(sine), float(cosine)), (-a, -d * sine, -d * cosine)
        inertia = _rod(mass, *rod)
        links.append(Link(place, turn, mass, com, inertia, (-TURNS, TURNS), axis, anchor, to=drawn, radius=rod[0]))
    return arm(links, (0.0, 0.0, 0.0), base_turn=(0.0, 0.0, 0.0, 1.0))


def _rod(mass: float, radius: float, length: float, axis: int) -> tuple[float, float, float, float, float, float]:
    """Inertia of a solid rod about its centre."""
    across = mass * (3 * radius**2 + length**2) / 12
    x, y, z = (mass * radius**2 / 2 if i == axis else across for i in range(3))
    return x, y, z, 0.0, 0.0, 0.0


HOME = (0.0, -1.2, 1.8, -2.17, -math.pi / 2, 0.0)
UR5E = Robot("ur5e", build, "WRIST", HOME, (0.5, 0.1333, 0.1))
