"""Whether a device gives a trial twice: the same trials again, and in other lanes of the batch.

Run: python -m experiments.simulation.repeatability --engine fused warp mjx
and XLA_FLAGS=--xla_gpu_deterministic_ops=true python -m experiments.simulation.repeatability --engine mjx, which adds
its rows to the former ones.
"""

from __future__ import annotations

import os
import time
from dataclasses import fields
from typing import Annotated, Any, Literal

import jax
import numpy as np
import tyro

from experiments._lib.results_io import committed, write_result
from experiments.simulation.engines import PRESET, SEED, trials_of
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.registry import get_scenario

LONGEST = 8.0  # s
DETERMINISTIC = "--xla_gpu_deterministic_ops=true"


def compared(first: Rollouts, second: Rollouts) -> dict[str, Any]:
    """What is the same of the same trials simulated twice."""
    equal, largest = 0, 0.0
    for row, (a, b) in enumerate(zip(first.length, second.length, strict=True)):
        samples = min(a, b)
        off = np.abs(first.wrench[row, :samples] - second.wrench[row, :samples]).max(1)
        equal += int(a == b and not off.any())
        largest = max(largest, float(off.max()))
    return {
        "trials": len(first.length),
        "equal": equal,
        "largest_difference": largest,  # N or Nm
        "same_outcome": int((first.seated == second.seated).all(1).sum()),
        "same_length": int((first.length == second.length).sum()),
    }


def backwards(out: Rollouts) -> Rollouts:
    """The trials in the opposite order."""
    return Rollouts(**{field.name: getattr(out, field.name)[::-1] for field in fields(Rollouts)})


def main(
    engine: Annotated[tuple[Literal["native", "mjx", "warp", "fused"], ...], tyro.conf.arg(help="engines")] = (
        "fused",
    ),
    trials: int = 512,
) -> None:
    """Measure and store."""
    scene, params, rows = get_scenario(PRESET).scene(), trials_of(trials, LONGEST), dict[str, Any]()
    ordered = DETERMINISTIC in os.environ.get("XLA_FLAGS", "")
    if ordered:
        rows = committed("repeatability")["engines"]
    for name in engine:
        first = engines.simulate(scene, params, name)
        turned = engines.simulate(scene, jax.tree.map(lambda leaf: leaf[::-1].copy(), params), name)
        start = time.perf_counter()
        again = engines.simulate(scene, params, name)
        seconds = time.perf_counter() - start
        rows[f"{name}, XLA in fixed order" if ordered else name] = {
            "again": compared(first, again) | {"seconds": round(seconds, 1)},
            "in other lanes": compared(first, backwards(turned)),
        }
    command = f"python -m experiments.simulation.repeatability --engine {' '.join(engine)} --trials {trials}"
    write_result("repeatability", command, {"longest_s": LONGEST, "engines": rows}, SEED)


if __name__ == "__main__":
    tyro.cli(main)
