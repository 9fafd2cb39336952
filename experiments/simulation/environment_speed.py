"""Speed of the environment beside that of the batch engine: the same trials, the same time, one run.

Physics steps per second of all that are executed, settling included, the preparation on the host left out of both;
compilation apart; medians. Run on a GPU: python -m experiments.simulation.environment_speed --engine mjx warp
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments._lib.results_io import write_result
from experiments._lib.timing import timed
from sim_mjx import engines, env
from sim_mjx.assembly.rollout import batch_size
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device
from sim_mjx.engines.common import SETTLING
from sim_mjx.env.environment import State
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario

PRESET, SEED = "hooked-B", 0
CONFIGS = {
    "set-points, joints and wrench seen": env.EnvConfig(observe=("joints", "wrench")),
    "set-points, words seen too": env.EnvConfig(observe=("joints", "wrench", "words")),
    "hand moved, joints and wrench seen": env.EnvConfig(action="cartesian", observe=("joints", "wrench")),
}
CALL = 40  # steps of the environment per call


def row(steps: int, first: float, seconds: list[float], host: float = 0.0) -> dict[str, Any]:
    """Speed from the seconds of equal runs, of which ``host`` were preparation."""
    median = statistics.median(seconds) - host
    return {
        "compile_s": round(first - statistics.median(seconds), 2),
        "seconds": [round(value - host, 4) for value in seconds],
        "steps": steps,
        "steps_per_s": round(steps / median),
    }


def batch_engine(engine: str, params: Any, repeats: int) -> dict[str, Any]:
    """The engine that simulates whole trials."""
    scene, impl = get_scenario(PRESET).scene(), engines.IMPLEMENTATIONS[engine]
    first, seconds = timed(lambda: device.run(scene, params, impl), repeats)
    _, host = timed(lambda: (device.put_scene(scene, batch_size(params), impl), device.fields_of(scene, params)), 3)
    periods = -(-SETTLING // scene.substeps) + int(np.ceil(np.max(scene.program.timeout(params)) / CONTROL_PERIOD)) + 1
    executed = -(-periods // device.STRETCH) * device.STRETCH
    return row(executed * scene.substeps * batch_size(params), first, seconds, statistics.median(host))


def environment(config: env.EnvConfig, engine: str, params: Any, repeats: int) -> dict[str, Any]:
    """Episodes of the same trials from their beginning, steered by noise."""
    count = batch_size(params)
    scene = env.load(PRESET, config, params=params, engine=engine, parallel=count)
    start = env.jit(jax.vmap(scene.begin))(scene.trials, jnp.arange(count))
    rng = np.random.default_rng(SEED)
    actions = jnp.asarray(rng.uniform(-0.1, 0.1, (CALL, count, scene.action_size)), jnp.float32)
    steps = env.jit(lambda state, actions: jax.lax.scan(_step(scene), state, actions)[0])
    calls = int(np.ceil(float(np.max(params.task.timeout)) / scene.dt / CALL))

    def work() -> State:
        state = start
        for _ in range(calls):
            state = steps(state, actions)
        return state

    first, seconds = timed(work, repeats)
    return row(calls * CALL * config.periods * scene.physics.substeps * count, first, seconds)


def _step(scene: env.Environment) -> Callable[[State, Any], tuple[State, None]]:
    return lambda state, action: (jax.vmap(scene.step)(state, action), None)


def main(
    engine: Annotated[tuple[str, ...], tyro.conf.arg(help="mjx, warp or both.")] = ("mjx",),
    batch: int = 8192,
    seconds: Annotated[float, tyro.conf.arg(help="Simulated time of each trial, s.")] = 8.0,
    repeats: int = 5,
) -> None:
    spec = DomainRandomization(nominal_share=1.0, longest=seconds)
    params, _ = get_scenario(PRESET).draw_batch(SEED, range(batch), spec)
    result: dict[str, Any] = {"batch": batch, "simulated_s": seconds, "repeats": repeats, "engines": {}}
    for name in engine:
        whole = batch_engine(name, params, repeats)
        rows = {label: environment(config, name, params, repeats) for label, config in CONFIGS.items()}
        for found in rows.values():
            found["share_of_batch_engine"] = round(found["steps_per_s"] / whole["steps_per_s"], 3)
        result["engines"][name] = {"batch engine": whole, "environment": rows}
    options = f"--engine {' '.join(engine)} --batch {batch} --seconds {seconds:g} --repeats {repeats}"
    write_result("environment_speed", f"python -m experiments.simulation.environment_speed {options}", result, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
