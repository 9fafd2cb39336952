"""Physics engines compared on one machine: parity, convergence of the solver, and speed.

Run: python -m experiments.simulation.engines [--parity 64] [--speed 256] [--longest 15]
Measure speeds on an idle machine. Writes experiments/results/engines.json.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from experiments._lib.results_io import given, write_result
from experiments._lib.timing import seconds_of
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import ITERATIONS, LS_ITERATIONS, Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.validation.engine_parity import parity, reference
from sim_mjx.validation.solver_convergence import certify

SEED, PRESET = 0, "hooked-B"
CERTIFIED = 64  # trials


def trials_of(count: int, longest: float, nominal_share: float = 0.5, preset: str = PRESET) -> TrialParams:
    spec = DomainRandomization(nominal_share=nominal_share, longest=longest)
    params: TrialParams = get_scenario(preset).draw_batch(SEED, range(count), spec)[0]
    return params


def speed(engine: str, params: TrialParams, scene: Scene) -> tuple[dict[str, float], Rollouts]:
    """The second run is timed; the first one compiles. Also the trials."""
    (_, first), (out, seconds) = (seconds_of(lambda: engines.simulate(scene, params, engine)) for _ in range(2))
    steps = int(out.length.sum()) * scene.substeps
    return {
        "trials": len(out.length),
        "compile_s": round(first - seconds, 2),
        "seconds": round(seconds, 3),
        "steps_per_s": round(steps / seconds),
        "mean_simulated_seconds": round(float(out.length.mean()) * CONTROL_PERIOD, 2),
        "trials_per_minute": round(60 * len(out.length) / seconds, 1),
        "trials_of_15_s_per_minute": round(60 * out.length.sum() * CONTROL_PERIOD / 15.0 / seconds, 1),
    }, out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parity", type=int, default=64, help="trials")
    parser.add_argument("--speed", type=int, default=256, help="trials")
    parser.add_argument("--longest", type=float, default=15.0, help="s, cuts every trial")
    options = parser.parse_args()
    few, many = trials_of(options.parity, options.longest), trials_of(options.speed, options.longest)
    scene_of = get_scenario(PRESET).scene
    scene, certificate = scene_of(), certify(trials_of(CERTIFIED, options.longest), scene_of)
    result: dict[str, Any] = {
        "preset": PRESET,
        "solver": [ITERATIONS, LS_ITERATIONS],
        "certificate": asdict(certificate) | {"converged": certificate.converged},
        "native": speed("native", many, scene)[0],
    }
    expected, contact = reference(scene, few)
    measured, found = speed("mjx", few, scene)
    ratio = result["native"]["steps_per_s"] / measured["steps_per_s"]
    result["mjx"] = measured | {
        "native_is_faster_by": round(ratio, 2),
        "parity": asdict(parity(expected, contact, found)),
    }
    command = "python -m experiments.simulation.engines" + given(vars(options), vars(parser.parse_args([])))
    write_result("engines", command, result, seed=SEED)


if __name__ == "__main__":
    main()
