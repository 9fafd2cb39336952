"""The phases that pressing assemblies share: touch, search, press, pull to see whether it holds, rest.

Each is a pair of pure functions of what the controller senses and of :class:`PressTask`; an assembly picks those that
it needs, or writes its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from rcbht_jax.types import Array
from sim_mjx.assemblies.assembly import Phase, Variation
from sim_mjx.assemblies.draw import uniform
from sim_mjx.controllers import Sense, admittance, go_to, keep_turn, spiral, tilt
from sim_mjx.controllers.moves import Twist

BELOW = -0.02  # m, where the approach aims, so that it does not slow down before it touches
UNFELT = -3e-3  # m, below the mouth: a part this deep met its hole without touching the mouth


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PressTask:
    """Parameters of the controller."""

    approach_speed: Float[Array, "*batch"]  # m/s
    touch_force: Float[Array, "*batch"]  # N, that ends the approach
    press: Float[Array, "*batch"]  # N, while searching and pressing
    gain: Float[Array, "*batch"]  # m/s per N
    moment_gain: Float[Array, "*batch"]  # rad/s per Nm
    pitch: Float[Array, "*batch"]  # m, between two turns of the spiral
    search_speed: Float[Array, "*batch"]  # m/s, along the spiral
    lean: Float[Array, "*batch"]  # rad, angle of ``tilt`` while searching, of which the hand reaches 79 %; 0 = upright
    drop: Float[Array, "*batch"]  # m, below the touch, where the hole is found
    bottom: Float[Array, "*batch"]  # m, height of the tip below which the part is in
    pull: Float[Array, "*batch"]  # N, of the pull after the press
    pull_time: Float[Array, "*batch"]  # s
    rest: Float[Array, "*batch"]  # s, recorded at the end


def draw_task(spec: Variation, rng: np.random.Generator, press: float, bottom: float, **others: float) -> PressTask:
    """The controller's parameters of one trial, with random gains and press.

    Args:
        spec: the distributions. rng: of the trial.
        press: N. bottom: m.
        others: fields of :class:`PressTask` in place of their defaults.
    """
    values = {
        "approach_speed": 0.012, "touch_force": 3.0, "press": press, "gain": 6e-4, "moment_gain": 0.15,
        "pitch": 1e-3, "search_speed": 8e-3, "lean": 0.0, "drop": 1.5e-3, "bottom": bottom, "pull": 6.0,
        "pull_time": 1.0, "rest": 0.4, **others,
    }  # fmt: skip
    gain, goal = uniform(rng, spec.gain), uniform(rng, spec.goal)
    factors = {"gain": gain, "moment_gain": gain, "press": goal}
    return PressTask(**{name: np.asarray(value * factors.get(name, 1.0)) for name, value in values.items()})


def upward(force: Any) -> Any:
    """A force on the hand along z."""
    return jnp.stack([jnp.zeros_like(force), jnp.zeros_like(force), force])


def approach(sense: Sense, task: PressTask) -> Twist:
    """Move straight down."""
    return go_to(sense, upward(jnp.full_like(task.press, BELOW)), task.approach_speed)


def touched(sense: Sense, task: PressTask) -> Bool[Array, ""]:
    """Whether the force shows contact, or the part is in its hole without having touched the mouth."""
    return (sense.force[2] > task.touch_force) | (sense.place[2] < UNFELT)


def search(sense: Sense, task: PressTask) -> Twist:
    """Move along a spiral, pressing down, compliant in no other direction."""
    return _pressed_along(sense, task) + keep_turn(sense)


def search_leaning(sense: Sense, task: PressTask) -> Twist:
    """As :func:`search`, with the hand leaning in a direction that rotates once per second; see :func:`tilt`."""
    return _pressed_along(sense, task) + tilt(sense, task.lean, 1.0)


def _pressed_along(sense: Sense, task: PressTask) -> Twist:
    pressed = admittance(sense, upward(task.press), task.gain) * jnp.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return pressed + spiral(sense, task.pitch, task.search_speed)


def found(sense: Sense, task: PressTask) -> Bool[Array, ""]:
    """Whether the part has dropped into its hole."""
    return (sense.place[2] < sense.entered[2] - task.drop) | (sense.place[2] < UNFELT)


def press(sense: Sense, task: PressTask) -> Twist:
    """Press down, compliant sideways and in rotation."""
    return admittance(sense, upward(task.press), task.gain, task.moment_gain)


def at_bottom(sense: Sense, task: PressTask) -> Bool[Array, ""]:
    """Whether the part is deep enough and something stops it."""
    return (sense.place[2] < task.bottom) & (sense.force[2] > 0.7 * task.press)


def pull(sense: Sense, task: PressTask) -> Twist:
    """Pull up, compliant sideways and in rotation."""
    return admittance(sense, upward(-task.pull), task.gain, task.moment_gain)


def pulled(sense: Sense, task: PressTask) -> Bool[Array, ""]:
    """Whether the pull has lasted long enough."""
    return sense.time > task.pull_time


def let_go(sense: Sense, task: PressTask) -> Twist:
    """Give way until no force is left."""
    return admittance(sense, upward(jnp.zeros_like(task.press)), task.gain, task.moment_gain)


def rested(sense: Sense, task: PressTask) -> Bool[Array, ""]:
    """Whether the rest has lasted long enough."""
    return sense.time > task.rest


APPROACH, SEARCH = Phase("approach", approach, touched), Phase("search", search, found)
SEARCH_LEANING = Phase("search", search_leaning, found)
PULL, REST = Phase("pull", pull, pulled), Phase("rest", let_go, rested)
