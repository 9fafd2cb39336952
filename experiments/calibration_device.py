"""Thresholds from simulated trials that never leave the device: rollouts, labels and scores without host copies.

Run: python -m experiments.calibration_device --engine mjx --trials 4096 (GPU), or --engine native --trials 64 (CPU,
where the rollouts are C MuJoCo's and the rest runs as on a GPU).
Half of the trials choose the thresholds, the other half measures them.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.record import write_result
from rcbht_jax.calibrate.objective import SCORES, Objective
from rcbht_jax.calibrate.on_device import score_wrench
from rcbht_jax.calibrate.search import SearchOptions, Space
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.tasks import STATES
from sim_mjx import engines, task
from sim_mjx.engines import device
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.randomize import Randomisation, draw_batch
from sim_mjx.scene import one_arm

SEED = 0


def rollouts(engine: str, trials: int) -> tuple[jax.Array, jax.Array]:
    """Wrench ``[trial, time, 6]`` and state edges ``[trial, 5]`` on the device; edges of a missing state coincide."""
    params, _ = draw_batch("B", SEED, range(trials), Randomisation(nominal_share=1.0))
    if engine == "native":
        run = engines.simulate(one_arm(), params, engine)
        starts = np.where(np.isnan(run.onset), 0, np.rint(np.nan_to_num(run.onset) / CONTROL_PERIOD))
        starts[np.isnan(run.onset).any(1)] = 0
        return jnp.asarray(run.wrench), jnp.asarray(np.c_[starts, run.length], jnp.int32)
    out = device.run(one_arm(), params, engines.IMPLEMENTATIONS[engine])
    limits = (task.APPROACH, task.ROTATION, task.INSERTION, task.MATING, task.ENDED)
    return out.wrench, jnp.stack([(out.phase < phase).sum(1, dtype=jnp.int32) for phase in limits], axis=1)


def measure(engine: str, trials: int, candidates: int) -> dict[str, Any]:
    start = time.perf_counter()
    wrench, edges = jax.block_until_ready(rollouts(engine, trials))
    simulated = time.perf_counter() - start
    complete = jnp.flatnonzero((jnp.diff(edges, axis=1) > 0).all(1))
    wrench, edges = wrench[complete], edges[complete]
    half = len(complete) // 2
    y = jnp.broadcast_to(jnp.arange(len(STATES), dtype=jnp.int32)[None], (len(complete), len(STATES)))
    config = EncoderConfig(5, CONTROL_PERIOD)
    options = SearchOptions(candidates=candidates, space=Space(groups=(0, 0, 0, 1, 1, 1)), seed=SEED)
    limits = jnp.asarray(options.space.limits(options.points()), jnp.float32)
    weights = Objective().weights()

    def scores(limits: jax.Array, rows: slice) -> np.ndarray:
        made = score_wrench(config, limits, wrench[rows], edges[rows], y[rows], classes=len(STATES))
        return np.asarray(made, np.float64)

    start = time.perf_counter()
    made = scores(limits, slice(0, half))
    searched = time.perf_counter() - start
    best = int((made @ weights).round(6).argmax())
    both = scores(limits[jnp.array([0, best])], slice(half, None))
    return {
        "engine": engine,
        "trials": trials,
        "complete trials": len(complete),
        "seconds to simulate, compilation included": round(simulated, 1),
        "candidates": candidates,
        "seconds to score them, compilation included": round(searched, 1),
        "limits": np.round(np.asarray(limits[best]), 4).tolist(),
        "training half": {"preset": _named(made[0]), "chosen": _named(made[best])},
        "held-out half": {"preset": _named(both[0]), "chosen": _named(both[1])},
    }


def _named(values: np.ndarray) -> dict[str, float]:
    return dict(zip(SCORES, np.round(values, 4).tolist(), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=engines.ENGINES, default="native")
    parser.add_argument("--trials", type=int, default=64)
    parser.add_argument("--candidates", type=int, default=256)
    given = parser.parse_args()
    result = measure(given.engine, given.trials, given.candidates)
    command = f"python -m experiments.calibration_device --engine {given.engine} --trials {given.trials}"
    write_result(f"calibration_device_{given.engine}", command, result, seed=SEED)


if __name__ == "__main__":
    main()
