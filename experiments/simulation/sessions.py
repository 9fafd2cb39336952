"""Simulated sessions compared with the recorded ones: onsets, ringing, outcomes, signature, seating rate.

Run: python -m experiments.simulation.sessions
Reads the recorded signatures (RCBHT_GOLDEN). Simulates session B's grid of offsets, session A's repeats, the others
mildly randomised, and 64 mildly randomised trials of every preset with the native engine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments._lib.catalogue import GOLDEN
from experiments._lib.results_io import write_result
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import one_arm
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets import ONE_ARM
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.validation import sessions, signature
from sim_mjx.validation.dynamics import ringing

SEED = 0
MILD = 64
REFERENCES = {"A": "real_A__harm__all", "B": "real_B__harm__all"}  # keys of the recorded signatures


def similarity(reference: np.ndarray, run: Rollouts) -> dict[str, Any]:
    kept = sessions.profiles(run)
    distance = signature.compare(reference, kept)
    return {
        "trials": len(kept),
        "coverage": round(distance.coverage, 3),
        "w1_over_sd": round(distance.w1_over_sd, 3),
        "dtw_over_sd": round(distance.dtw_over_sd, 3),
    }


def medians(onset: np.ndarray) -> list[float | None]:
    """Median onset of each state over the trials that entered it, s; None = no trial did."""
    reached = [column[np.isfinite(column)] for column in onset.T]
    return [round(float(np.median(times)), 3) if len(times) else None for times in reached]


def as_recorded(session: str, reference: np.ndarray) -> dict[str, Any]:
    run = native.simulate(one_arm(), sessions.trials_of(preset_of(session), seed=SEED))
    out: dict[str, Any] = {"signature": similarity(reference, run)}
    out["median onsets, s"] = medians(sessions.harmonised(run))
    ring = ringing(run.wrench[..., 2], run.length, run.onset[:, 3])
    out["ring of Fz in mating"] = ring and {"hertz": round(ring.hertz, 2), "peak": round(ring.peak, 2)}
    cells = preset_of(session).placements
    if cells:
        out["outcomes that agree with the 25 recorded"] = sessions.agreement(preset_of(session), run)
        out["seated"] = [f"{dx:+d} {dy:+d}" for (dx, dy), seat in zip(cells, run.seated.all(1), strict=True) if seat]
    return out


def main() -> None:
    golden = dict(np.load(GOLDEN / "signatures/signatures.npz"))
    result: dict[str, Any] = {
        f"{session}, as recorded": as_recorded(session, golden[key].astype(float))
        for session, key in REFERENCES.items()
    }
    for preset in ONE_ARM:
        drawn, _ = get_scenario(preset).draw_batch(SEED, range(MILD), DomainRandomization(nominal_share=1.0))
        run = native.simulate(one_arm(), drawn)
        row = {
            "seated": round(float(run.seated.all(1).mean()), 3),
            "median onsets, s": medians(run.onset),
            "mean simulated seconds": round(float(run.length.mean()) * CONTROL_PERIOD, 2),
        }
        result[f"{preset}, {MILD} mildly randomised"] = row
    write_result("sim_sessions", "python -m experiments.simulation.sessions", result, seed=SEED)


if __name__ == "__main__":
    main()
