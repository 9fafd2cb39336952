"""Engines against each other: parity, convergence of the solver, and speed on this machine.

Run on an otherwise idle machine: python -m experiments.engines
"""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import numpy as np

from experiments.record import write_result
from sim_mjx import engines
from sim_mjx.certificate import certify
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.randomize import Randomisation, draw_batch
from sim_mjx.rollout import Rollouts, TrialParams
from sim_mjx.scene import ITERATIONS, LS_ITERATIONS, SUBSTEPS, one_arm

SEED, PRESET = 0, "B"
TRIALS = 32
LONGEST = 13.0  # s, beyond the start of mating
BEFORE_CONTACT = 20  # control periods by which the filter and the delays let a contact come later


def trials_of(count: int) -> TrialParams:
    return draw_batch(PRESET, SEED, range(count), Randomisation(longest=LONGEST))[0]


def timed(engine: str, params: TrialParams) -> tuple[Rollouts, float]:
    start = time.perf_counter()
    out = engines.simulate(one_arm(), params, engine)
    return out, time.perf_counter() - start


def parity(native: Rollouts, other: Rollouts) -> dict[str, Any]:
    """Largest differences of the logged wrench before contact, and what came of the trials."""
    samples = min(native.wrench.shape[1], other.wrench.shape[1])
    begun = np.nan_to_num(native.onset[:, 1] / CONTROL_PERIOD, nan=np.inf)
    free = np.arange(samples) < np.minimum(begun, native.length)[:, None] - BEFORE_CONTACT
    error = np.abs(native.wrench[:, :samples] - other.wrench[:, :samples])
    late = np.abs(native.onset - other.onset)
    return {
        "force_before_contact": float(error[..., :3][free].max()),
        "moment_before_contact": float(error[..., 3:][free].max()),
        "trials_with_contact": int(np.isfinite(begun).sum()),
        "median_force_difference_over_whole_trials": float(np.median(error[..., :3])),
        "state_agreement_over_time": float((_states(native, samples) == _states(other, samples)).mean()),
        "same_outcome": float((native.seated.all(1) == other.seated.all(1)).mean()),
        "onset_difference_s_percentile_95": float(np.nanpercentile(late, 95)),
    }


def _states(out: Rollouts, samples: int) -> np.ndarray:
    ticks = np.nan_to_num(np.round(out.onset / CONTROL_PERIOD), nan=np.inf)
    return (np.arange(samples)[None, :, None] >= ticks[:, None, :]).sum(2)


def speed(engine: str, params: TrialParams) -> tuple[Rollouts, dict[str, float]]:
    """The second run is timed; the first one compiles."""
    _, first = timed(engine, params)
    out, second = timed(engine, params)
    steps = int(out.length.sum()) * SUBSTEPS
    return out, {
        "compile_s": first - second,
        "seconds": second,
        "steps_per_s": steps / second,
        "trials_per_minute": 60 * len(out.length) / second,
    }


def main() -> None:
    params = trials_of(TRIALS)
    native, native_speed = speed("native", params)
    other, mjx_speed = speed("mjx", params)
    certificate = certify(params)
    result = {
        "preset": PRESET,
        "trials": TRIALS,
        "solver": [ITERATIONS, LS_ITERATIONS],
        "native": native_speed,
        "mjx": mjx_speed,
        "parity": parity(native, other),
        "certificate": asdict(certificate) | {"converged": certificate.converged},
    }
    write_result("engines", "python -m experiments.engines", result, seed=SEED)


if __name__ == "__main__":
    main()
