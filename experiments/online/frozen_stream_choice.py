"""The choice of what the frozen method streams, made on the authors' simulated trials and session A alone.

The beginnings are not given (``experiments.online.causal``). Options are the families of the two heads, the recipes of
``rcbht train-online`` or richer words and levels, and which belief counts: that of the head "phase", of the filter over
it, or of the head "state" with the beginnings that the filter detects. The best mean of the two step accuracies is
frozen.

Run: python -m experiments.online.frozen_stream_choice (reads RCBHT_DATA)
"""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
import tyro

from experiments._lib import frozen
from experiments._lib.benchmarks import REAL, SIM1, recorded, rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.streams import halves
from experiments.online import causal
from rcbht_jax.features.recipes import LEVELS, SUBTASK, TRIAL
from rcbht_jax.introspection.training import ENDS, GRID, TRIAL_GRID
from rcbht_jax.types import Recordings

SEED, REPEATS = 100, 2  # of the halves: not those of the headline
RATE = 10.0  # snapshots per second


def head(families: tuple[str, ...], balance: bool, ranks: bool) -> dict[str, Any]:
    """A head as the frozen file has it."""
    grid = GRID if ranks else TRIAL_GRID
    return {"families": list(families), "balance": balance, "grid": asdict(grid), "ends": ENDS if ranks else 1}


OPTIONS = {
    "recipes": (head(SUBTASK, True, True), head(TRIAL, False, False)),
    "levels": (head(LEVELS, True, True), head(LEVELS, True, True)),
}


def heads(option: str) -> dict[str, Any]:
    """The heads that an option streams, whichever belief counts."""
    state, phase = OPTIONS[option]
    return {"encoder": "W5", "rate": RATE, "state": state, "phase": phase}


def streamed(option: str, belief: str) -> dict[str, Any]:
    """The section "streamed" of the frozen file."""
    return {**heads(option), "belief": belief}


def permitted(known: Recordings) -> Recordings:
    """The trials that may choose."""
    return known.take((known.session == "A") | (known.source == SIM1))


def row(data: Recordings, option: str) -> dict[str, Any]:
    method = frozen.FrozenMethod({"thresholds": "hiro", **ENCODER, "streamed": heads(option)})
    found: dict[str, dict[str, list[float]]] = {}  # belief -> set -> scores
    for name, filters in (("SIM1", {"sources": (SIM1,)}), ("A", {"sources": (REAL,), "sessions": ("A",)})):
        stream = causal.Stream(method, data, **filters)
        for seed in range(SEED, SEED + REPEATS):
            for belief, scores in causal.unaided(stream, False, halves(stream.items, seed), seed).items():
                found.setdefault(belief, {}).setdefault(name, []).append(scores["macro step accuracy"])
    return {belief: _means(sets) for belief, sets in found.items()}


ENCODER = {"encoders": {"W5": {"window": 5, "scale": 1.0}}}


def _means(sets: dict[str, list[float]]) -> dict[str, float]:
    means = {name: float(np.mean(scores)) for name, scores in sets.items()}
    return rounded(means | {"mean": float(np.mean(list(means.values())))})


def main(only: Only = ALL_ROWS) -> None:
    data = permitted(recorded())
    about = {
        "what": "options of the streamed part of the frozen method, scored on simulated trials and session A alone",
        "measure": "macro step accuracy where nobody tells the beginnings",
        "repeats": REPEATS,
        "options": {name: heads(name) for name in OPTIONS},
    }
    rows = Rows("frozen_stream_choice", "python -m experiments.online.frozen_stream_choice", about, SEED)
    rows.fill({name: partial(row, data, name) for name in OPTIONS}, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
