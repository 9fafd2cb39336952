"""Alarms about simulated faults against the outcome: specificity on trials that seat all the same, and precision.

Counts those of ``experiments.online.faults`` anew. Sensitivity is the share of failures that were noticed in time,
with contact and without; specificity is the share of trials that had a fault, seated nevertheless and raised no alarm;
precision is the share of failures among those noticed in time and the seated trials with an alarm at any time. Trials
without a fault are not in it: how many of them there are is a choice. Intervals are Wilson's with each trial counted
once, however often it was streamed.

Run: python -m experiments.online.faults_outcome
Reads faults_online.json.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import tyro

from experiments._lib.results_io import committed, write_result
from rcbht_jax.learning.metrics import wilson

COUNTS = ("detected", "failures streamed", "of them alarmed", "seated all the same")
PARTS = ("with contact", "without contact")
EVERY = "every kind"


def share(good: int, streamed: int, repeats: int) -> dict[str, Any] | None:
    """A share of trials that were streamed several times; None = there are none.

    >>> share(45, 50, 5)
    {'mean': 0.9, 'low': 0.5958, 'high': 0.9821, 'of': 50}
    """
    if not streamed:
        return None
    trials = max(1, round(streamed / repeats))
    low, high = wilson(good / streamed * trials, trials)
    return {"mean": round(good / streamed, 4), "low": round(low, 4), "high": round(high, 4), "of": streamed}


def against(counts: np.ndarray, repeats: int) -> dict[str, Any]:
    """Sensitivity, specificity on seated faults, and precision, from counts in the order of COUNTS."""
    found, failed, alarmed, seated = counts.tolist()
    return {
        "sensitivity": share(found, failed, repeats),
        "specificity on seated faults": share(seated - alarmed, seated, repeats),
        "precision": share(found, found + alarmed, repeats),
    }


def measure(preset: dict[str, Any]) -> dict[str, Any]:
    """All kinds of a session."""
    repeats = len(preset["false alarms in each repeat"])
    counts = {
        kind: np.sum([[cells[part][name] for name in COUNTS] for part in PARTS], axis=0)
        for kind, cells in preset["kinds"].items()
    }
    every = np.sum(list(counts.values()), axis=0)
    return {kind: against(numbers, repeats) for kind, numbers in {**counts, EVERY: every}.items()}


def main() -> None:
    result = {
        "what": "alarms of the monitor of simulated faults against the outcome",
        "sessions": {name: measure(preset) for name, preset in committed("faults_online")["presets"].items()},
    }
    write_result("faults_outcome", "python -m experiments.online.faults_outcome", result)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
