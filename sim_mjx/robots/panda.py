"""A 7-joint arm: the Franka Emika Panda, from its published tables.

Sources: Denavit-Hartenberg parameters (Craig's convention) and joint limits of the maker's documentation (Franka
Control Interface, "Robot and interface specifications"); masses, centres and inertias identified by Gaz, Cognetti,
Oliva, Robuffo Giordano and De Luca, "Dynamic identification of the Franka Emika Panda robot with retrieval of feasible
parameters using penalty-based optimization", IEEE RA-L 4(4), 2019. The capsules that are drawn and the
motors' inertia seen from a joint (0.1 kg m^2) are chosen.
"""

from __future__ import annotations

import math

import mujoco

from sim_mjx.robots.robot import Link, Robot, Vector, arm

# a_{i-1} in m, d_i in m, alpha_{i-1} in quarter turns
DH = (
    (0.0, 0.333, 0), (0.0, 0.0, -1), (0.0, 0.316, 1), (0.0825, 0.0, 1), (-0.0825, 0.384, -1), (0.0, 0.0, 1),
    (0.088, 0.0, 1),
)  # fmt: skip
LIMITS = (
    (-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698), (-2.8973, 2.8973), (-0.0175, 3.7525),
    (-2.8973, 2.8973),
)  # fmt: skip
MASS = (4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522)  # kg
COM: tuple[Vector, ...] = (  # m
    (3.875e-3, 2.081e-3, -0.04762), (-3.141e-3, -0.02872, 3.495e-3), (0.027518, 0.039252, -0.066502),
    (-0.05317, 0.104419, 0.027454), (-0.011953, 0.041065, -0.038437), (0.060149, -0.014117, -0.010517),
    (0.010517, -4.252e-3, 0.061597),
)  # fmt: skip
INERTIA = (  # kg m^2: xx yy zz xy xz yz
    (0.70337, 0.70661, 0.009117, -1.39e-4, 6.772e-3, 0.019169),
    (7.962e-3, 0.02811, 0.025995, -3.925e-3, 0.010254, 7.04e-4),
    (0.037242, 0.036155, 0.01083, -4.761e-3, -0.011396, -0.012805),
    (0.025853, 0.019552, 0.028323, 7.796e-3, -1.332e-3, 8.641e-3),
    (0.035549, 0.029474, 8.627e-3, -2.117e-3, -4.037e-3, 2.29e-4),
    (1.964e-3, 4.354e-3, 5.433e-3, 1.09e-4, -1.158e-3, 3.41e-4),
    (0.012516, 0.010027, 4.815e-3, -4.28e-4, -1.196e-3, -7.41e-4),
)
DRAWN: tuple[Vector, ...] = (  # m, from each frame's origin
    (0.0, 0.0, -0.25), (0.0, -0.18, 0.0), (0.0, 0.0, -0.12), (-0.0825, 0.1, 0.0), (0.0, 0.0, -0.26), (0.088, 0.0, 0.0),
    (0.0, 0.0, 0.09),
)  # fmt: skip
FLANGE = 0.107  # m, along the last axis
EIGHTH = math.pi / 8  # half of the 45 degrees by which the maker's hand is turned on the flange


def build() -> mujoco.MjSpec:
    """Links and joints."""
    links = []
    for (a, d, quarters), limits, mass, com, inertia, drawn in zip(DH, LIMITS, MASS, COM, INERTIA, DRAWN, strict=True):
        half = quarters * math.pi / 4
        place, turn = (a, -quarters * d, d if quarters == 0 else 0.0), (math.cos(half), math.sin(half), 0.0, 0.0)
        links.append(Link(place, turn, mass, com, inertia, limits, to=drawn))
    return arm(links, (0.0, 0.0, FLANGE), (math.cos(EIGHTH), 0.0, 0.0, -math.sin(EIGHTH)))


PANDA = Robot("panda", build, "WRIST", (0.0, -0.2, 0.0, -2.4, 0.0, 2.2, math.pi / 4), (0.5, 0.0, 0.1))
