"""Confidence while a sub-task runs: the belief in its true class over its course, per class, as in the paper's figure.

Half of the trials train, the other half is streamed at 10 Hz, repeated with other halves as in
``experiments.online.table2``. The result has mean and middle 80 % of the probability of the true class at twenty
moments of the sub-task, over all test intervals and repeats; a belief holds until the next one.

Run: python -m experiments.online.confidence --repeats 10 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.streams import halves
from experiments.online.table2 import MAIN_RATE, SETS, streamed
from rcbht_jax.features.recipes import SUBTASK
from rcbht_jax.introspection.training import Snapshots
from rcbht_jax.learning.validation import repeat_seeds
from rcbht_jax.types import Recordings

PARTS = 20  # of a sub-task


def measure(recordings: Recordings, name: str, repeats: int, seed: int) -> dict[str, Any]:
    stream = streamed(recordings, name)
    items = stream.items
    length = items.intervals[0].end - items.intervals[0].start
    parts = []
    for one in tqdm(repeat_seeds(seed, repeats), desc=name, file=sys.stderr, disable=None):
        seen, p = stream.given(False, halves(items, one), one)
        true = p[np.arange(len(p)), items.y[seen.interval]]
        parts += [(items.y[s], held(seen, true, s, length[s])) for s in np.unique(seen.interval)]
    y, p = np.array([c for c, _ in parts]), np.array([course for _, course in parts])
    seconds = [float(np.median(length[items.y == c])) * recordings.dt for c in np.unique(y)]
    belief = {name: summary(p[y == c]) for c, name in enumerate(items.classes)}
    return rounded({"seconds of a sub-task, median": seconds, "belief": belief})


def held(snapshots: Snapshots, p: np.ndarray, interval: int, length: int) -> np.ndarray:
    """The latest belief at each moment of one interval; NaN before the first."""
    mine = snapshots.interval == interval
    moments = (np.arange(PARTS) + 0.5) / PARTS
    last = np.searchsorted((snapshots.now[mine] - snapshots.begin[mine]) / length, moments, side="right") - 1
    return np.where(last < 0, np.nan, p[mine][last])


def summary(p: np.ndarray) -> dict[str, list[float | None]]:
    """Mean and middle 80 % of ``[interval, moment]``; None where less than half of the intervals have a belief."""
    cells = [column[~np.isnan(column)] for column in p.T]
    kinds = {"mean": np.mean, "low": lambda v: np.quantile(v, 0.1), "high": lambda v: np.quantile(v, 0.9)}
    return {kind: [float(f(v)) if 2 * v.size >= len(p) else None for v in cells] for kind, f in kinds.items()}


def main(repeats: int = 10, seed: int = 0, only: Only = ALL_ROWS) -> None:
    recordings = recorded()
    about = {
        "what": "probability of the true class over the course of a sub-task, streamed, trials not trained on",
        "rate, Hz": MAIN_RATE,
        "repeats": repeats,
        "families": SUBTASK,
    }
    wanted = {name: partial(measure, recordings, name, repeats, seed) for name in SETS}
    Rows("confidence", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
