"""From the hand's twist to joint references, by the damped inverse of the arm's Jacobian."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from rcbht_jax.types import Array
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.controllers.moves import Twist
from sim_mjx.robots.chain import Angles, SerialChain, along, jacobian, times

DAMPING = 0.02  # m and rad: below it a singular direction is given up
POSTURE = 0.5  # 1/s, rate at which redundant joints return home


def resolved_rates(chain: SerialChain, command: Angles, twist: Twist, home: Angles) -> Angles:
    """Joint references one control period later.

    Args:
        chain: of the point that is moved.
        command: joint references, rad.
        twist: of the point, m/s and rad/s, world axes.
        home: rad, towards which a redundant arm moves without moving the point.
    """
    matrix = jacobian(chain, command)
    gram = times(matrix, matrix.T) + DAMPING**2 * jnp.eye(6, dtype=matrix.dtype)
    back = POSTURE * (home - command)
    rates: Float[Array, " joint"] = along(matrix.T, jnp.linalg.solve(gram, twist - along(matrix, back)))
    return command + CONTROL_PERIOD * (rates + back)
