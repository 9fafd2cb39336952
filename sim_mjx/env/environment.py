"""An environment: pure functions of one trial, for users to map and compile.

The interface follows MuJoCo Playground's ``MjxEnv``: ``reset(rng) -> State``, ``step(state, action) -> State``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.errors import InputError
from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import Program
from sim_mjx.assembly.sensor import LONGEST_DELAY
from sim_mjx.assembly.task import CONTROL_PERIOD, periods
from sim_mjx.engines.common import LARGEST, single
from sim_mjx.env.actions import action_size, joint_increments, with_set_points
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.physics import Fields, Glance, Physics
from sim_mjx.env.senses import Senses, SensesState

Key = Any  # of jax.random: a typed one, or uint32 [2]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trials:
    """Settled trials from which episodes are drawn; leaves have a leading trial axis."""

    params: Any  # of the scenario's program, single precision
    fields: Fields  # of the model
    body: Any
    glance: Glance


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvData:
    """The state of an episode, without observation and reward."""

    body: Any  # of the physics
    glance: Glance
    loop: Any  # of the scenario's program
    params: Any  # of the trial
    fields: Fields  # of the model
    shifts: Float[Array, "*batch delay joint"]  # rad, what actions added to the references, newest first
    senses: SensesState
    tick: Int[Array, "*batch"]  # control periods since time zero
    held: Int[Array, "*batch"]  # control periods for which all tabs have been seated
    phase: Int[Array, "*batch"]  # of the controller at the last sample


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """State of one environment; a pytree whose leaves have a leading axis when environments are mapped.

    Attributes:
        data: state of physics, controller, encoder and classifiers.
        obs: the observation.
        reward: of the last step.
        done: 1 = the episode has ended; results of further steps are undefined.
        metrics: "seated" (share of tabs), "success" (0 or 1), "force" (N, size of the measured force), and what
            wrappers add; ``step`` keeps the latter.
        info: "truncation" (1 = ended by time), "time_out" (the same, which Brax's wrappers leave), "diverged" (1 =
            the physics failed), "trial" (row of the environment's trials), "time" (s), "phase" (of the controller),
            and what wrappers add.
    """

    data: EnvData
    obs: Float[Array, "*batch size"]
    reward: Float[Array, "*batch"]
    done: Float[Array, "*batch"]
    metrics: dict[str, Any]
    info: dict[str, Any]

    @property
    def pipeline_state(self) -> EnvData:
        """``data`` by the name that Brax's wrappers use."""
        return self.data

    def replace(self, **changes: Any) -> State:
        """The state with changed values; wrappers of MuJoCo Playground and Brax call this.

        Args:
            changes: of the attributes; ``pipeline_state`` changes ``data``.
        """
        if "pipeline_state" in changes:
            changes["data"] = changes.pop("pipeline_state")
        return replace(self, **changes)


class Environment:
    """A scenario as an environment; :func:`sim_mjx.env.load` makes one.

    Args:
        program: of the scenario.
        physics: of the scene.
        trials: from which episodes are drawn.
        senses: what is observed.
        config: what an action does and when an episode has succeeded.

    Raises:
        InputError: actions are set-points, but the controller has no force law.
    """

    def __init__(self, program: Program, physics: Physics, trials: Trials, senses: Senses, config: EnvConfig) -> None:
        self.program, self.physics, self.trials, self.senses, self.config = program, physics, trials, senses, config
        if config.action == "set-points":
            with_set_points(trials.params, jnp.zeros((self.trial_count, 6)))

    @property
    def action_size(self) -> int:
        """Size of an action; each number is between -1 and 1."""
        twist, joints = self.trials.glance.jacobian.shape[1:]
        return action_size(self.config, joints, twist // 6)

    @property
    def observation_size(self) -> int:
        """Size of an observation."""
        return sum(self.senses.sizes.values())

    @property
    def observation_slices(self) -> dict[str, slice]:
        """Slices of the parts of an observation, by name."""
        out, at = {}, 0
        for part, size in self.senses.sizes.items():
            out[part] = slice(at, at + size)
            at += size
        return out

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return self.config.dt

    @property
    def sim_dt(self) -> float:
        """Seconds per step of the physics."""
        return CONTROL_PERIOD / self.physics.substeps

    @property
    def n_substeps(self) -> int:
        """Steps of the physics per step."""
        return self.config.periods * self.physics.substeps

    @property
    def unwrapped(self) -> Environment:
        """The environment without wrappers: itself."""
        return self

    @property
    def trial_count(self) -> int:
        """Number of trials from which episodes are drawn."""
        return int(self.trials.glance.seated.shape[0])

    def reset(self, rng: Key) -> State:
        """Begin an episode of a randomly drawn trial, with new sensor noise."""
        choose, noise = jax.random.split(rng)
        row = jax.random.randint(choose, (), 0, self.trial_count, jnp.int32)  # the same with 64 bits
        return self.reset_to(row, jax.random.bits(noise, (2,), jnp.uint32))

    def reset_to(self, row: Int[Array, ""], seed: Array | None = None) -> State:
        """Begin an episode of a given trial, without randomness.

        Args:
            row: of ``trials``.
            seed: key of the sensor's noise, as of ``jax.random.key`` or ``PRNGKey``; None = the trial's own.

        Raises:
            InputError: no row or no key, or there is no such row. Compiled or mapped functions cannot ask for the
                latter: they begin another one.
        """
        if not _scalar(row):
            raise InputError(f"The row of a trial is {row!r}; expected one whole number (jax.vmap takes several).")
        if not isinstance(row, jax.core.Tracer) and not 0 <= int(row) < self.trial_count:
            raise InputError(f"There is no trial {int(row)}; expected 0 to {self.trial_count - 1}.")
        if isinstance(seed, jax.Array) and jnp.issubdtype(seed.dtype, jax.dtypes.prng_key):
            seed = jax.random.key_data(seed)
        if seed is not None and (np.shape(seed), getattr(seed, "dtype", None)) != ((2,), np.uint32):
            raise InputError("The seed of the noise is no key; expected one as of jax.random.key or PRNGKey.")
        return self.begin(jax.tree.map(lambda leaf: jnp.asarray(leaf)[row], self.trials), row, seed)

    @single
    def begin(self, trial: Trials, row: Int[Array, ""], seed: Array | None = None) -> State:
        """Begin an episode of a trial that need not be one of ``trials``.

        Args:
            trial: leaves of one trial. To run thousands, map over them; ``reset_to`` closes over its trials.
            row: the number of the trial in ``info``.
            seed: key of the sensor's noise, uint32 [2]; None = the trial's own.
        """
        params = trial.params if seed is None else replace(trial.params, seed=seed)
        loop = self.program.begin(params, self.physics.raw(trial.body))
        joints = self.program.home(params) + self.physics.joints(trial.body)
        shifts = jnp.zeros((LONGEST_DELAY, joints.shape[-1]), joints.dtype)
        zero, none = jnp.int32(0), jnp.float32(0.0)
        senses = self.senses.begun
        data = EnvData(trial.body, trial.glance, loop, params, trial.fields, shifts, senses, zero, zero, zero)
        metrics = {"seated": _share(trial.glance), "success": none, "force": none}
        named = jnp.asarray(row, jnp.int32)
        info = {"truncation": none, "time_out": none, "diverged": none, "trial": named, "time": none, "phase": zero}
        wrench = jnp.zeros(self.senses.axes, jnp.float32)  # none has been measured yet
        state = State(data, self.senses.observe(senses, joints, wrench), none, none, metrics, info)
        return jax.tree.map(jnp.copy, state)  # no leaf shares memory with another: programs may donate them

    @single
    def step(self, state: State, action: Float[Array, " action"]) -> State:
        """Run ``config.periods`` control periods with one action, which is clipped to -1 and 1.

        The reward is the increase of the share of seated tabs, plus 1 for success.

        Raises:
            InputError: the action has the wrong shape.
        """
        if isinstance(action, list | tuple):  # a pytree of numbers where it is compiled
            action = jnp.asarray(action, jnp.float32)
        if jnp.shape(action) != (self.action_size,):
            raise InputError(f"An action has shape {jnp.shape(action)}; expected ({self.action_size},).")
        action = jnp.clip(jnp.asarray(action, jnp.float32), -1.0, 1.0)
        data, joints, wrench, phase = self._periods(state.data, action)
        sane = (jnp.abs(wrench) < LARGEST).all() & jnp.isfinite(joints).all()  # false for NaN
        sane = sane & ~jnp.isnan(action).any()  # set-points are not read before contact
        success = sane & (data.held >= max(1, round(self.config.hold / CONTROL_PERIOD)))
        late = data.tick >= periods(self.program.timeout(data.params))
        if self.config.controller == "recorded":
            late = late | (phase[-1] == self.program.ended)
        rise = _share(data.glance) - _share(state.data.glance)  # wrappers that reset put back data alone
        metrics = state.metrics | {
            "seated": _share(data.glance), "success": success.astype(jnp.float32),
            "force": jnp.linalg.norm(jnp.nan_to_num(wrench[-1, :3])),
        }  # fmt: skip
        truncation = (late & sane & ~success).astype(jnp.float32)
        info = state.info | {
            "truncation": truncation, "time_out": truncation, "diverged": (~sane).astype(jnp.float32),
            "time": data.tick.astype(jnp.float32) * CONTROL_PERIOD, "phase": data.phase,
        }  # fmt: skip
        return State(
            data,
            self.senses.observe(data.senses, joints[-1], wrench[-1]),
            jnp.where(sane, rise + metrics["success"], 0.0),
            (success | late | ~sane).astype(jnp.float32),
            metrics,
            info,
        )

    def _periods(self, data: EnvData, action: Array) -> tuple[EnvData, Array, Array, Array]:
        """The control periods of a step: the data after it, and joints, wrench and phase of each [period, ...]."""
        acted = data.params
        if self.config.action == "set-points":
            scale = jnp.array([self.config.force] * 3 + [self.config.moment] * 3, jnp.float32)
            acted = with_set_points(data.params, action * scale)
        home = self.program.home(data.params)
        moves = joint_increments(self.config, action, data.glance.jacobian)

        def period(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], tuple[Array, ...]]:
            body, glance, loop, shifts, held = carry
            joints = home + self.physics.joints(body)
            loop, ends, log = self.program.control(acted, loop, joints, self.physics.raw(body))
            shifts = jnp.concatenate([(shifts[0] + moves)[None], shifts[:-1]])
            body, glance = self._substeps(data.fields, body, glance, self._from_home(acted, home, ends, shifts))
            held = jnp.where(glance.seated.all(), held + 1, jnp.zeros_like(held))
            return (body, glance, loop, shifts, held), (log.joints, log.wrench, log.phase)

        start = (self.physics.enter(data.body), data.glance, data.loop, data.shifts, data.held)
        (body, glance, loop, shifts, held), (joints, wrench, phase) = jax.lax.scan(
            period, start, length=self.config.periods
        )
        senses = self.senses.take(data.senses, wrench, phase, data.phase)
        tick = data.tick + self.config.periods
        after = EnvData(
            self.physics.leave(body), glance, loop, data.params, data.fields, shifts, senses, tick, held, phase[-1]
        )
        return after, joints, wrench, phase

    def _from_home(self, params: Any, home: Array, ends: Array, shifts: Array) -> Array:
        """The references between which the coming physics steps go [2, J], rad from home."""
        if self.config.action == "set-points":
            return ends - home[None]
        delay = params.command_delay if hasattr(params, "command_delay") else jnp.int32(0)
        added = jnp.stack([shifts[delay + 1], shifts[delay]])
        return added if self.config.controller == "none" else ends + added - home[None]

    def _substeps(self, fields: Fields, body: Any, glance: Glance, between: Array) -> tuple[Any, Glance]:
        before, after = between
        shares = jnp.arange(1, self.physics.substeps + 1, dtype=jnp.float32) / self.physics.substeps

        def substep(carry: tuple[Any, Glance], share: Array) -> tuple[tuple[Any, Glance], None]:
            return self.physics.step(fields, carry[0], before + share * (after - before)), None

        carry, _ = jax.lax.scan(substep, (body, glance), shares, unroll=self.physics.unroll)
        return carry


def _scalar(row: Any) -> bool:
    """Whether a value is one whole number, also in a compiled function."""
    return isinstance(row, int) or (getattr(row, "shape", None) == () and jnp.issubdtype(row.dtype, jnp.integer))


def _share(glance: Glance) -> Array:
    """Share of the tabs that are seated."""
    return glance.seated.astype(jnp.float32).mean()
