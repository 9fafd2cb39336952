"""What runs between physics steps, for any assembly on any arm: sensor, phases, motion, joint references."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.types import Array
from sim_mjx.assemblies.assembly import Assembly, AssemblyTrial
from sim_mjx.assembly import sensor
from sim_mjx.assembly.controllers import Wrench
from sim_mjx.assembly.rollout import LogRow, Program
from sim_mjx.assembly.sensor import LONGEST_DELAY, SensorState
from sim_mjx.assembly.task import CONTROL_PERIOD, periods, starts
from sim_mjx.controllers import Sense, resolved_rates
from sim_mjx.robots.chain import Angles, Rotation, SerialChain, Vector, pose, rotation_vector, times

HOME, TIMEOUT = attrgetter("home"), attrgetter("timeout")  # the same objects for all programs, which are compared
UPRIGHT = np.diag([1.0, -1.0, -1.0]).astype(np.float32)  # the wrist's axes in the world, its z axis pointing down


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Loop:
    """State of the controller between control periods of one trial."""

    tick: Int[Array, "*batch"]  # control periods since the start
    phase: Int[Array, "*batch"]
    since: Int[Array, "*batch"]  # tick at which the phase began
    entered: Float[Array, "*batch 3"]  # m, place of the tip at that tick
    sensor: SensorState
    commands: Float[Array, "*batch delay joint"]  # rad, joint references, newest first


@dataclass(frozen=True, eq=False)
class Controller:
    """An assembly's phases on one arm."""

    assembly: Assembly
    chain: SerialChain  # of the tip
    mouth: Float[np.ndarray, " 3"]  # m, world, nominal place of the female part's mouth

    def program(self) -> Program:
        """The functions that engines call."""
        ended = len(self.assembly.phases)
        return Program(self.begin, self.control, HOME, TIMEOUT, ended, starts)

    def begin(self, params: AssemblyTrial, raw: Wrench) -> Loop:
        """State before the first period; ``raw`` is the first sensor reading, wrist frame."""
        zero = jnp.int32(0)
        commands = jnp.broadcast_to(params.home, (LONGEST_DELAY, *params.home.shape))
        entered, _ = self._tip(params, params.home)
        return Loop(zero, zero, zero, entered, sensor.begin(params.sensor, raw), commands)

    def control(
        self, params: AssemblyTrial, loop: Loop, joints: Angles, raw: Wrench
    ) -> tuple[Loop, Float[Array, "2 joint"], LogRow]:
        """One control period; see ``sim_mjx.assembly.rollout.control``."""
        _, rotation = pose(self.chain, joints)
        noise = jax.random.normal(jax.random.fold_in(params.seed, loop.tick), (6,), raw.dtype)
        read, wrench = sensor.read(params.sensor, loop.sensor, raw, noise, rotation)
        before = self._sense(params, loop, joints, rotation, wrench)
        ended, phases = len(self.assembly.phases), self.assembly.phases
        leaves = jnp.stack([phase.leave(before, params.task) for phase in phases])
        phase = jnp.where((loop.phase < ended) & leaves[jnp.minimum(loop.phase, ended - 1)], loop.phase + 1, loop.phase)
        late = loop.tick >= periods(params.timeout)
        phase = jnp.where(late, jnp.int32(ended), phase)
        new = phase != loop.phase
        since = jnp.where(new, loop.tick, loop.since)
        time, entered = _seconds(loop.tick - since, wrench), jnp.where(new, before.place, loop.entered)
        now = replace(before, time=time, entered=entered)
        twists = jnp.stack([phase.move(now, params.task) for phase in phases])
        twist = jnp.where(phase == ended, 0.0, twists[jnp.minimum(phase, ended - 1)])
        command = resolved_rates(self.chain, loop.commands[0], twist, params.home)
        commands = jnp.concatenate([command[None], loop.commands[:-1]])
        between = jnp.stack([commands[params.command_delay + 1], commands[params.command_delay]])
        after = Loop(loop.tick + 1, phase, since, entered, read, commands)
        return after, between, LogRow(wrench, joints, loop.phase)

    def _tip(self, params: AssemblyTrial, joints: Angles) -> tuple[Vector, Vector]:
        """Place of the tip from the mouth's assumed place, m, and the hand's turn from upright, rad."""
        # how the part sits in the hand is unknown to a controller
        place, rotation = pose(self.chain, joints)
        turn = rotation_vector(times(rotation, jnp.asarray(UPRIGHT).T))
        return place - self.mouth - params.hand, turn

    def _sense(self, params: AssemblyTrial, loop: Loop, joints: Angles, rotation: Rotation, wrench: Array) -> Sense:
        place, turn = self._tip(params, joints)
        wanted_place, wanted_turn = self._tip(params, loop.commands[0])
        lever = self.assembly.reach * rotation[:, 2]
        time = _seconds(loop.tick - loop.since, wrench)
        moment = wrench[3:] - jnp.cross(lever, wrench[:3])
        return Sense(time, place, turn, wanted_place, wanted_turn, loop.entered, wrench[:3], moment)


def _seconds(ticks: Int[Array, ""], like: Array) -> Float[Array, ""]:
    return ticks.astype(like.dtype) * CONTROL_PERIOD
