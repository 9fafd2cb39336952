"""The simulated sessions beside the recorded ones: onsets, outcomes, signature, seating rate.

Run: python -m experiments.sim_sessions
Reads the recorded signatures (RCBHT_GOLDEN). Simulates session B's grid of offsets, session A's repeats and mildly
randomised trials of every preset with the native engine.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from experiments.record import write_result
from sim_mjx import kinematics, presets, randomize, signature
from sim_mjx.engines import native
from sim_mjx.rollout import Rollouts, stack
from sim_mjx.scene import one_arm

SEED = 0
GRID = [(dx, dy) for dx in (0, 1, 2, -1, -2) for dy in (0, 1, 2, -1, -2)]  # mm
RECORDED_OFF = {(0, -2), (1, -2), (2, -2), (-1, -2), (-2, -2), (-1, 2), (-2, 2)}
MILD = 64
REPEATS = 16
# Session A repeated one nominal trial: only noise, a small drift of the bias and 0.1 mm of placement differ.
SAME = ("stiffness", "overlap", "friction", "mount", "gain", "goal", "speed", "tare")
REPEATED = dict.fromkeys(SAME, (1.0, 1.0)) | {
    "shift": (-1e-4, 1e-4), "turn": (-1e-3, 1e-3), "lag": (4, 4),
    "force_bias": (-0.08, 0.08), "moment_bias": (-0.004, 0.004),
}  # fmt: skip
VERTICAL = 1.96  # degrees, harmonised end of rotation


def profile(run: Rollouts, row: int) -> np.ndarray | None:
    """Wrench [4 states, 100 points, 6 axes] of one trial, or None if it never mated for a second."""
    marks = run.onset[row].copy()
    times = np.arange(run.length[row]) * presets.CONTROL_PERIOD
    if np.isnan(marks).any() or marks[3] + 1 > times[-1]:
        return None
    if marks[2] - marks[1] < 2 * presets.CONTROL_PERIOD:
        inside = (times >= marks[1]) & (times < marks[3])
        _, rotation, _ = kinematics.fk(run.joints[row, : run.length[row]][inside].astype(np.float64))
        upright = np.flatnonzero(np.degrees(kinematics.tilt(rotation)) < VERTICAL)
        marks[2] = times[inside][upright[0]] if upright.size else marks[1] + 0.9 * (marks[3] - marks[1])
    edges = [0.0, *marks[1:], marks[3] + 1.0]
    wrench = run.wrench[row, : run.length[row]]
    return np.stack(
        [
            np.stack([np.interp(np.linspace(a, b, 100), times, wrench[:, axis]) for axis in range(6)], 1)
            for a, b in pairwise(edges)
        ]
    )


def similarity(reference: np.ndarray, run: Rollouts) -> dict[str, Any]:
    found = [profile(run, row) for row in range(len(run.length))]
    kept = np.array([one for one in found if one is not None])
    if not len(kept):
        return {"trials": 0}
    said = signature.compare(reference, kept)
    return {
        "trials": len(kept),
        "coverage": round(said.coverage, 3),
        "w1_over_sd": round(said.w1_over_sd, 3),
        "dtw_over_sd": round(said.dtw_over_sd, 3),
    }


def mild(preset: str, count: int, **options: Any) -> tuple[Rollouts, float]:
    drawn, _ = randomize.draw_batch(preset, SEED, range(count), randomize.Randomisation(nominal_share=1.0, **options))
    start = time.perf_counter()
    run = native.simulate(one_arm(), drawn)
    return run, time.perf_counter() - start


def grid() -> Rollouts:
    still = {"shift": (0.0, 0.0), "turn": (0.0, 0.0), "force_bias": (-0.2, 0.2), "moment_bias": (-0.005, 0.005)}
    spec = randomize.Randomisation(nominal_share=1.0, **still)
    drawn = [randomize.draw("B", SEED, index, spec)[0] for index in range(len(GRID))]
    moved = [
        replace(one, task=replace(one.task, way_position=one.task.way_position + np.array([dx, dy, 0.0]) * 1e-3))
        for one, (dx, dy) in zip(drawn, GRID, strict=True)
    ]
    return native.simulate(one_arm(), stack(moved))


def main() -> None:
    golden = dict(np.load(Path(os.environ.get("RCBHT_GOLDEN", "../shared/golden")) / "signatures/signatures.npz"))
    result: dict[str, Any] = {}
    cells = grid()
    seats = cells.seated.all(1)
    agree = sum(bool(seat) == (cell not in RECORDED_OFF) for seat, cell in zip(seats, GRID, strict=True))
    result["B, 5 x 5 offsets"] = {
        "signature": similarity(golden["real_B__harm__all"].astype(float), cells),
        "outcomes that agree with the 25 recorded": int(agree),
        "seated": [f"{dx:+d} {dy:+d}" for (dx, dy), seat in zip(GRID, seats, strict=True) if seat],
    }
    repeats, _ = mild("A", REPEATS, **REPEATED)
    result[f"A, {REPEATS} repeats"] = {
        "signature": similarity(golden["real_A__harm__all"].astype(float), repeats),
        "median onsets, s": np.round(np.median(repeats.onset, axis=0), 3).tolist(),
        "largest Fz after mating begins, median, N": round(float(np.median(repeats.wrench[..., 2].max(axis=1))), 1),
    }
    for preset in presets.PRESETS:
        run, seconds = mild(preset, MILD)
        row = {
            "seated": round(float(run.seated.all(1).mean()), 3),
            "median onsets, s": np.round(np.nanmedian(run.onset, axis=0), 3).tolist(),
            "mean simulated seconds": round(float(run.length.mean()) * presets.CONTROL_PERIOD, 2),
            "trials per minute": round(MILD / seconds * 60),
        }
        result[f"{preset}, {MILD} mildly randomised"] = row
    write_result("sim_sessions", "python -m experiments.sim_sessions", result, seed=SEED)


if __name__ == "__main__":
    main()
