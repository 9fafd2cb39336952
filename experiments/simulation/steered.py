"""A controller that searches: learnt set-points of the force law, and a spiral of the hand with some give.

The same policy steers an environment on the device, and a program of the native engine, which has no environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array
from sim_mjx.assembly import task
from sim_mjx.assembly.rollout import Program
from sim_mjx.assembly.sensor import LONGEST_DELAY
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.env.actions import joint_increments, with_set_points
from sim_mjx.env.config import EnvConfig

# Every number of a policy with its unit and range; narrowed by hand on a few trials of a third seed, in which a descent
# and a spiral seated half of the parts and a give of 0.5 mm/s per N none.
RANGES: dict[str, tuple[float, float]] = {
    "force x": (-6.0, 6.0),  # N, added to the recorded set-points in world axes
    "force y": (-4.0, 4.0),  # N
    "force z": (-6.0, 10.0),  # N
    "moment y": (-20.0, 20.0),  # Nm
    "descent": (1.0, 8.0),  # mm/s, after the approach while nothing touches
    "radius": (1.0, 8.0),  # mm, of the spiral at its widest
    "turns": (0.1, 0.8),  # per s
    "duration": (2.0, 10.0),  # s, in which the spiral widens
    "give": (-0.2, 0.2),  # mm/s per N of the force from aside
}
LOW, HIGH = (np.array(ends) for ends in zip(*RANGES.values(), strict=True))
RECORDED: NDArray[np.float64] = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 5.0, 0.0])  # changes nothing
CONFIG = EnvConfig(action="cartesian", observe=("joints", "wrench"))


def set_points(policy: Float[np.ndarray, "*batch 9"]) -> Float[np.ndarray, "*batch 6"]:
    """What a policy adds to the force law's set-points, N and Nm."""
    zero = np.zeros_like(policy[..., 0])
    return np.stack([*np.moveaxis(policy[..., :3], -1, 0), zero, policy[..., 3], zero], axis=-1)


def act(
    policy: Float[Array, " 9"], late: Array, since: Array, touched: Array, wrench: Float[Array, " 6"]
) -> Float[Array, " 6"]:
    """The action of a step, within -1 and 1: of an environment with ``CONFIG``.

    Args:
        policy: numbers as in ``RANGES``.
        late: s since the approach should have ended; negative before.
        since: s since contact.
        touched: whether there has been a contact.
        wrench: measured, N and Nm, world axes.
    """
    descent, radius, turns, duration, give = (policy[number] for number in range(4, 9))

    def place(at: Array) -> Array:
        wide = radius * jnp.clip(at / duration, 0.0, 1.0)
        return wide * jnp.stack([jnp.cos(2 * jnp.pi * turns * at), jnp.sin(2 * jnp.pi * turns * at)])

    around = (place(since + CONFIG.dt) - place(since)) / CONFIG.dt  # mm/s
    aside = around + give * wrench[:2]
    down = jnp.where((late > 0.0) & ~touched, -descent, 0.0)
    speed = jnp.concatenate([jnp.where(touched, aside, 0.0), down[None]])
    moved = speed * (1e-3 * CONFIG.dt / CONFIG.shift)
    return jnp.clip(jnp.concatenate([moved, jnp.zeros(3, moved.dtype)]), -1.0, 1.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SteeredParams:
    """A trial and its policy; leaves of a batch have a leading trial axis."""

    trial: Any  # of the steered program
    policy: Float[Array, "*batch 9"]

    @property
    def parts(self) -> Any:
        """The parameters that the engine needs of every trial."""
        return self.trial.parts


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SteeredLoop:
    """State of the steered program and of the policy."""

    inner: Any
    shifts: Float[Array, "*batch delay 6"]  # rad, newest first
    action: Float[Array, "*batch 6"]
    touched: Array  # control period of the contact, -1 = none


def steered(program: Program) -> Program:
    """The one-arm program with a policy's action on top, as an environment adds it."""

    def begin(params: SteeredParams, raw: Array) -> SteeredLoop:
        inner = program.begin(params.trial, raw)
        return SteeredLoop(inner, jnp.zeros((LONGEST_DELAY, 6)), jnp.zeros(6), jnp.int32(-1))

    def control(params: SteeredParams, loop: SteeredLoop, joints: Array, raw: Array) -> tuple[Any, Array, Any]:
        tick = loop.inner.task.tick
        inner, ends, log = program.control(params.trial, loop.inner, joints, raw)
        moves = joint_increments(CONFIG, loop.action, jnp.concatenate(kinematics.jacobian(joints)))
        shifts = jnp.concatenate([(loop.shifts[0] + moves)[None], loop.shifts[:-1]])
        delay = params.trial.command_delay
        ends = ends + jnp.stack([shifts[delay + 1], shifts[delay]])
        touched = jnp.where((loop.touched < 0) & (log.phase > task.APPROACH), tick, loop.touched)
        now = act(params.policy, *clocks(params.trial, tick + 1, touched), log.wrench)
        action = jnp.where((tick + 1) % CONFIG.periods == 0, now, loop.action)
        return SteeredLoop(inner, shifts, action, touched), ends, log

    return Program(
        begin, control, lambda params: program.home(params.trial), lambda params: program.timeout(params.trial)
    )


def clocks(trial: Any, tick: Array, touched: Array) -> tuple[Array, Array, Array]:
    """Seconds since the planned end of the approach; since contact (at period ``touched``, -1 = none); whether any."""
    now = tick.astype(jnp.float32) * CONTROL_PERIOD
    since = jnp.where(touched >= 0, (tick - touched).astype(jnp.float32) * CONTROL_PERIOD, 0.0)
    return now - trial.task.way_time[-1], since, touched >= 0


def with_policies(trials: Any, policies: Float[np.ndarray, "trial 9"]) -> Any:
    """Trials whose set-points are those of their policies."""
    return with_set_points(trials, set_points(policies))
