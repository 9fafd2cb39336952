"""Motions of the hand: to a place, against a force, along a spiral, about a tilt."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Float

from rcbht_jax.types import Array
from sim_mjx.assembly.task import CONTROL_PERIOD

Scalar = Float[Array, ""] | float
Vector = Float[Array, " 3"]
Twist = Float[Array, " 6"]
NEARING = 8.0  # 1/s, rate at which a motion ends: the distance left falls to a third in an eighth of a second


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sense:
    """What the controller knows in one control period of one trial.

    Places are those of the tip of the part in the hand, from where the controller believes the middle of the other
    part's mouth to be; turns are rotation vectors from the hand's upright pose. World axes, z up.
    """

    time: Float[Array, ""]  # s since the phase began
    place: Vector  # m, measured
    turn: Vector  # rad, measured
    wanted_place: Vector  # m, of the joint references
    wanted_turn: Vector  # rad, of the joint references
    entered: Vector  # m, measured as the phase began
    force: Vector  # N, of the parts on the hand
    moment: Vector  # Nm, about the tip


def go_to(sense: Sense, place: Vector, speed: Scalar, turn: Vector | None = None) -> Twist:
    """Move straight to a place, m, at a speed, m/s, slowing down at its end, and to a turn, rad, default upright."""
    left = place - sense.wanted_place
    distance = jnp.sqrt((left**2).sum() + 1e-12)
    return jnp.concatenate([left * jnp.minimum(NEARING, speed / distance), keep_turn(sense, turn)[3:]])


def keep_turn(sense: Sense, turn: Vector | None = None) -> Twist:
    """Rotate back to a turn, rad, default upright."""
    left = -sense.wanted_turn if turn is None else turn - sense.wanted_turn
    return jnp.concatenate([jnp.zeros_like(left), NEARING * left])


def admittance(sense: Sense, force: Vector, gain: Scalar, moment_gain: Scalar = 0.0) -> Twist:
    """Move the hand so that the force on it approaches a set-point.

    Args:
        sense: of this period.
        force: N, wanted on the hand; pressing downwards is felt as a positive z.
        gain: m/s per N.
        moment_gain: rad/s per Nm about the tip, whose set-point is zero; 0 = the hand does not turn.
    """
    return jnp.concatenate([gain * (sense.force - force), moment_gain * sense.moment])


def spiral(sense: Sense, pitch: Scalar, speed: Scalar) -> Twist:
    """Move sideways along a spiral of Archimedes from where the phase began.

    Args:
        sense: of this period.
        pitch: m between two turns.
        speed: m/s along the path.
    """

    def at(seconds: Scalar) -> Vector:
        angle = jnp.sqrt(4 * math.pi * speed * seconds / pitch)
        radius = pitch * angle / (2 * math.pi)
        return jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), jnp.zeros_like(radius)])

    velocity = (at(sense.time + CONTROL_PERIOD) - at(sense.time)) / CONTROL_PERIOD
    return jnp.concatenate([velocity, jnp.zeros_like(velocity)])


def tilt(sense: Sense, angle: Scalar, period: Scalar) -> Twist:
    """Lean the hand in a direction that rotates once per period, s, by up to an angle, rad.

    The hand follows the rotating direction with a lag, as :func:`keep_turn` turns it, and leans by less the shorter the
    period is: by 98 % of the angle with 4 s, 93 % with 2 s, 79 % with 1 s.
    """
    round_ = 2 * math.pi * sense.time / period
    lean = angle * jnp.minimum(1.0, 4 * sense.time / period)
    wanted = jnp.stack([lean * jnp.cos(round_), lean * jnp.sin(round_), jnp.zeros_like(round_)])
    return keep_turn(sense, wanted)
