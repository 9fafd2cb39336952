"""Physics and a controller that are quick to compile: joints are where their references are, and push like springs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.introspection.model import Head, IntrospectionModel
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec
from sim_mjx.assembly import task
from sim_mjx.assembly.rollout import LogRow, Program, TrialParams, as_float32
from sim_mjx.assembly.sensor import LONGEST_DELAY
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.environment import Environment, Trials
from sim_mjx.env.physics import Glance
from sim_mjx.env.senses import new_senses
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario

STIFFNESS = np.array([40.0, -30.0, 20.0, 2.0, 3.0, -4.0], np.float32)  # N/rad and Nm/rad
DEPTH = 0.03  # rad; a tab is seated when its joint is farther from home
BROKEN = -0.05  # rad; beyond it the last joint's physics gives no number
JACOBIAN = np.diag([2.0, 1.0, 1.0, 1.0, 1.0, 0.5]).astype(np.float32)


TOUCH = 60  # control periods until the controller presses


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Loop:
    """What the controller remembers; ``delay`` is ``LONGEST_DELAY``."""

    tick: Any
    commands: Any  # rad [delay, 6], newest first


def begin(params: TrialParams, raw: Any) -> Loop:
    return Loop(jnp.int32(0), jnp.broadcast_to(params.task.home, (LONGEST_DELAY, 6)))


def control(params: TrialParams, loop: Loop, joints: Any, raw: Any) -> tuple[Loop, Any, LogRow]:
    """Sway, then press towards the first set-point, with noise and the trial's delay."""
    wrench = raw + 0.01 * jax.random.normal(jax.random.fold_in(params.seed, loop.tick), (6,))
    touched = loop.tick >= TOUCH
    goal = jnp.concatenate([params.task.force[0], params.task.moment[0]])
    sway = 0.002 * jnp.sin(0.3 * loop.tick.astype(jnp.float32)) * jnp.arange(6.0)
    moved = jnp.where(touched, 1e-4 * (goal - wrench) / STIFFNESS, sway)
    commands = jnp.concatenate([(loop.commands[0] + moved)[None], loop.commands[:-1]])
    over = loop.tick >= jnp.round(params.task.timeout / CONTROL_PERIOD).astype(jnp.int32)
    phase = jnp.where(over, jnp.int32(task.ENDED), touched.astype(jnp.int32))
    between = jnp.stack([commands[params.command_delay + 1], commands[params.command_delay]])
    return Loop(loop.tick + 1, commands), between, LogRow(wrench, joints, phase)


PROGRAM = Program(begin, control, lambda params: params.task.home, lambda params: params.task.timeout)


@dataclass(frozen=True)
class Springs:
    """One joint is one axis of the wrench; four of them hold tabs."""

    substeps: int = 2
    unroll: bool = False
    lag: float = 0.0  # share of the way to its reference that a joint does not go in a step

    def step(self, fields: dict[str, Any], body: Any, ctrl: Any) -> tuple[Any, Glance]:
        body = jnp.where(ctrl[5] < BROKEN, jnp.nan, 1.0) * (ctrl + self.lag * (body - ctrl))
        return body, Glance(body[:4] > DEPTH, jnp.asarray(JACOBIAN))

    def enter(self, body: Any) -> Any:
        return body

    def leave(self, body: Any) -> Any:
        return body

    def joints(self, body: Any) -> Any:
        return body

    def raw(self, body: Any) -> Any:
        return body * STIFFNESS


def trials(count: int = 3, longest: float = 1.0) -> TrialParams:
    """Trials of session B, of which the controller uses home, set-points, delay, seed and time-out."""
    return get_scenario("B").draw_batch(0, range(count), DomainRandomization(nominal_share=1.0, longest=longest))[0]


@cache
def model() -> IntrospectionModel:
    """Classifiers of a sub-task and of a whole trial, which have learned from noise."""
    rng, heads = np.random.default_rng(0), []
    for name, scope, kernel, classes in (("a", "subtask", "linear", "xyz"), ("b", "trial", "rbf", "uv")):
        view = FeatureView(FeatureSpec(("histogram", "elapsed")), provisional=scope == "trial")
        y = np.repeat(np.arange(len(classes)), 12)
        x = rng.uniform(0, 1, (len(y), len(names(view.spec)))) + 0.3 * y[:, None]
        machine = fit_probabilistic(x, y, np.arange(len(y)), tuple(classes), SvmSpec(kernel, 1.0, True))
        heads.append(Head(name, scope, view, machine))
    return IntrospectionModel(EncoderConfig(), np.asarray(preset().limits), tuple(heads), "abc")


def environment(
    config: EnvConfig,
    params: TrialParams | None = None,
    model: IntrospectionModel | None = None,
    lag: float = 0.0,
) -> Environment:
    """An environment of the controller on springs."""
    params = trials() if params is None else params
    count = len(params.command_delay)
    glance = Glance(np.zeros((count, 4), bool), np.broadcast_to(JACOBIAN, (count, 6, 6)).copy())
    drawn = Trials(
        as_float32(params), {"slip": np.zeros((count, 6), np.float32)}, np.zeros((count, 6), np.float32), glance
    )
    return Environment(PROGRAM, Springs(lag=lag), drawn, new_senses(config, 6, 6, model), config)
