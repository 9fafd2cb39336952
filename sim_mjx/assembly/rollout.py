"""One trial's loop around the physics: sensor, state machine and delays, the same for every engine.

``control`` is one control period, pure; engines call it between physics steps, batched by ``jax.vmap``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int32, UInt32

from rcbht_jax.robots import kinematics
from rcbht_jax.types import Array
from sim_mjx.assembly import sensor, task
from sim_mjx.assembly.controllers import Joints, Wrench
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.sensor import LONGEST_DELAY, SensorParams, SensorState
from sim_mjx.assembly.task import TaskParams, TaskState

Params = TypeVar("Params")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrialParams:
    """All parameters of one trial; leaves of a batch have a leading trial axis."""

    task: TaskParams
    sensor: SensorParams
    parts: PartParams
    command_delay: Int[Array, "*batch"]  # control periods between reference and servo
    seed: UInt32[Array, "*batch 2"]  # key of the sensor's noise


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ControllerState:
    """State of the controller between control periods; ``delay`` is ``LONGEST_DELAY``."""

    task: TaskState
    sensor: SensorState
    commands: Float[Array, "*batch delay 6"]  # rad, joint references, newest first


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LogRow:
    """What is logged each control period."""

    wrench: Float[Array, "*batch reading"]  # N and Nm, world frame, as the robot logs it; six readings per wrist
    joints: Float[Array, "*batch joint"]  # rad, measured
    phase: Int[Array, "*batch"]  # numbered as the program does


@dataclass(frozen=True)
class Program:
    """What runs between physics steps: pure functions of one trial, which engines batch and compile.

    The parameters of a program are a pytree with an attribute ``parts``; its leaves have a leading trial axis.
    """

    begin: Callable[[Any, Array], Any]  # parameters, first readings [6K] -> loop state
    control: Callable[[Any, Any, Array, Array], tuple[Any, Array, LogRow]]  # see ``control``
    home: Callable[[Any], Array]  # parameters -> joint angles at time zero [..., J], rad
    timeout: Callable[[Any], Array]  # parameters -> longest time of a trial [...], s
    ended: int = task.ENDED  # number of the phase in which a trial has ended; all others are below it
    # control periods at which each phase began [..., ended], -1 = never -> starts that are reported [..., state], s
    onsets: Callable[[Any], Any] = task.onsets


@dataclass(frozen=True)
class Rollouts:
    """Simulated trials on the host, padded to the longest; rows beyond ``length`` are zero. Six readings per wrist."""

    wrench: Float32[np.ndarray, "trial time reading"]  # N and Nm, world frame
    joints: Float32[np.ndarray, "trial time joint"]  # rad
    length: Int32[np.ndarray, " trial"]  # control periods until the trial ended
    onset: Float64[np.ndarray, "trial state"]  # s, NaN = state never reached
    seated: Bool[np.ndarray, "trial tab"]  # tabs past their lips at the end, order of parts.TABS; or other marks
    diverged: Bool[np.ndarray, " trial"]  # the physics gave a value that is not finite: the trial is unusable
    past: Bool[np.ndarray, "trial time tab"]  # which tabs were past their lips at each sample


def begin(params: TrialParams, raw: Wrench) -> ControllerState:
    """Loop state before the first period; ``raw`` is the first sensor reading, wrist frame."""
    commands = jnp.broadcast_to(params.task.home, (LONGEST_DELAY, 6))
    return ControllerState(task.start(params.task), sensor.begin(params.sensor, raw), commands)


def control(
    params: TrialParams, loop: ControllerState, joints: Joints, raw: Wrench
) -> tuple[ControllerState, Float[Array, "2 6"], LogRow]:
    """One control period.

    Args:
        params: one trial.
        loop: before.
        joints: measured angles, rad.
        raw: force and moment of the part on the hand, wrist frame.

    Returns:
        the loop after it, the two servo references between which the next physics steps interpolate, and the log row.
    """
    _, rotation, _ = kinematics.fk(joints)
    noise = jax.random.normal(jax.random.fold_in(params.seed, loop.task.tick), (6,), raw.dtype)
    read, wrench = sensor.read(params.sensor, loop.sensor, raw, noise, rotation)
    state = task.advance(params.task, loop.task, joints, wrench)
    commands = jnp.concatenate([state.command[None], loop.commands[:-1]])
    # a servo interpolates: a reference that jumped every 5 ms would shake the tool by its own weight
    between = jnp.stack([commands[params.command_delay + 1], commands[params.command_delay]])
    return ControllerState(state, read, commands), between, LogRow(wrench, joints, loop.task.phase)


ONE_ARM = Program(begin, control, lambda params: params.task.home, lambda params: params.task.timeout)


def as_float32(params: Any) -> Any:
    """All real leaves of a program's parameters in single precision, for the controllers."""

    def cast(leaf: Array) -> Array:
        leaf = jax.device_put(leaf)  # jnp.asarray would compile a program for each shape
        return leaf.astype(jnp.float32) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(cast, params)


def stack(trials: list[Params]) -> Params:
    """A batch of single trials of any program."""
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *trials)


def single_trials(params: Params) -> list[Params]:
    """The trials of a batch, or of a part of its parameters, one by one."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], params) for i in range(batch_size(params))]


def repeated(trial: Params, count: int) -> Params:
    """A batch of copies of one trial, or of a part of its parameters."""
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], count, axis=0), trial)


def batch_size(params: Any) -> int:
    """Trials in a batch of a program's parameters."""
    return len(jax.tree.leaves(params)[0])
