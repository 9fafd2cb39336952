"""Environments by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any

import jax
import numpy as np

from rcbht_jax._util.compiling import compiler_options
from rcbht_jax.encoding.thresholds import Thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.model import IntrospectionModel
from sim_mjx import engines
from sim_mjx.assemblies import ASSEMBLIES
from sim_mjx.assembly.rollout import as_float32, batch_size
from sim_mjx.engines import device
from sim_mjx.env.config import EnvConfig
from sim_mjx.env.environment import Environment, Trials
from sim_mjx.env.physics import new_physics, settled
from sim_mjx.env.senses import new_senses
from sim_mjx.own_code import whole
from sim_mjx.presets import DEFAULT, PRESETS
from sim_mjx.registry import SNAP, Scenario, get_scenario

# task -> the scenario that stands for it
ALIASES = {SNAP: DEFAULT} | {name: f"{name}@panda" for name in ASSEMBLIES}


def load(
    name: str | Scenario,
    config: EnvConfig | None = None,
    *,
    spec: Any = None,
    trials: int = 256,
    seed: int = 0,
    params: Any = None,
    model: IntrospectionModel | None = None,
    thresholds: Thresholds | None = None,
    engine: str = "mjx",
    parallel: int = 8192,
) -> Environment:
    """Make an environment of a scenario: draw its trials, put them on the device and settle them.

    Args:
        name: a task, such as "camera-snap" or "peg-in-hole", or a scenario, such as "hooked-A" or "plug@ur5e"; either
            half may be your own, as in "key.py:KEY@panda". Or a scenario, as of
            ``sim_mjx.registry.pair(assembly, robot)``.
        config: what an action does and what is observed; None = the defaults.
        spec: distributions of the trials, as the scenario's ``draw`` takes them; None = the defaults, without faults.
        trials: number of trials to draw, from which :meth:`Environment.reset` chooses.
        seed: seed of the trials.
        params: a batch of trials to use instead of drawn ones; then ``spec``, ``trials`` and ``seed`` are not used.
        model: makes the observed beliefs, and the words; None = no beliefs.
        thresholds: for words without a model, ``[6, 4]`` for every wrist or ``[axis, 4]``, in N/s and Nm/s; None =
            HIRO's.
        engine: "mjx", or "warp" on an NVIDIA GPU.
        parallel: largest number of environments that step at once; "warp" reserves memory for this number.

    Raises:
        InputError: an unknown scenario or engine, one that does not run on the device, ``params`` that are not a batch
            of trials, or a model, thresholds or a configuration that does not fit the scenario.
    """
    config = EnvConfig() if config is None else config
    if not isinstance(config, EnvConfig):
        raise InputError(f"config is {config!r}; expected an EnvConfig.")
    engines.check(engine)
    if engine not in engines.IMPLEMENTATIONS:
        raise InputError(
            f"An environment cannot use the engine {engine!r}; expected {' or '.join(engines.IMPLEMENTATIONS)}."
        )
    if not all(whole(count, 1) for count in (trials, parallel)):
        raise InputError(f"trials is {trials!r} and parallel {parallel!r}; expected whole numbers, 1 or more.")
    if not isinstance(model, IntrospectionModel | None):
        raise InputError(f"model is {model!r}; expected what rcbht_jax.introspection.model.load returns.")
    if not isinstance(name, Scenario) and (
        not isinstance(name, str) or (name not in (*ALIASES, *PRESETS) and "@" not in name)
    ):
        raise InputError(
            f"There is no environment {name!r}; expected one of {', '.join([*ALIASES, *PRESETS])}, or ASSEMBLY@ROBOT "
            "(either may be FILE.py:NAME)."
        )
    scenario = name if isinstance(name, Scenario) else get_scenario(ALIASES.get(name, name))
    scene = scenario.scene()
    if params is None:
        spec = scenario.spec(nominal_share=1.0) if spec is None else spec
        if not is_dataclass(spec):
            raise InputError(f"spec is {spec!r}; expected distributions, such as those of the scenario's spec().")
        params, _ = scenario.draw_batch(seed, range(trials), spec)
    if len(counts := {np.shape(leaf)[:1] for leaf in jax.tree.leaves(params)}) != 1 or counts <= {(), (0,)}:
        raise InputError("params is no batch of trials; expected that of a scenario's draw_batch, one trial or more.")
    like = scenario.draw_batch(0, range(1), scenario.spec())[0]
    if _kinds(params) != _kinds(like):
        raise InputError("params has trials of another scenario; expected those of its draw_batch.")
    physics = new_physics(scene, engines.IMPLEMENTATIONS[engine], max(parallel, batch_size(params)))
    senses = new_senses(config, 6 * len(scene.forces), len(scene.joints), model, thresholds)
    drawn = Trials(as_float32(params), device.fields_of(scene, params), *settled(scene, params))
    return Environment(scene.program, physics, drawn, senses, config)


def _kinds(params: Any) -> tuple[Any, list[tuple[int, ...]]]:
    """The classes of a batch of trials, and the shapes of one trial's numbers."""
    leaves, tree = jax.tree.flatten(params)
    return tree, [np.shape(leaf)[1:] for leaf in leaves]


def jit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """``jax.jit`` with the compiler options that the physics needs: without them it is far slower on a CPU.

    Args:
        function: a function of environments, such as ``jax.vmap(env.step)``.
        options: options of ``jax.jit``.

    >>> float(jit(lambda x: x + 1)(2.0))
    3.0
    """
    return jax.jit(function, compiler_options=compiler_options(jax.default_backend()), **options)
