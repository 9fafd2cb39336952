"""Failure types of the authors' simulated failures, believed from the stream: accuracy at parts of the record.

Five folds grouped by trial: four train, the fifth is streamed at 10 Hz. A streamed classifier has one encoder: finer
ones take a window of 20 samples and a fraction of the preset's thresholds. "Richer words" are features without elapsed
time and absolute level. The baseline is the most frequent class. With so many classes the likeliest class and the one
with most votes of the pairs differ; both are reported. The weight of a complete record (twenty snapshots) and the cost
of richer words were chosen on two of these folds, so expect a little less on new trials.

Run: python -m experiments.online.failure_types --repeats 1 --seed 0
Every finished row is kept; run it again to go on where it was interrupted. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.benchmarks import recorded, with_interval
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.streams import described
from experiments._lib.tasks import failure_types
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import RICHER, TRIAL
from rcbht_jax.introspection.training import (
    TRIAL_GRID,
    Snapshots,
    learn,
    regular_snapshots,
    training_snapshots,
)
from rcbht_jax.learning import metrics
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.learning.validation import repeated_folds
from rcbht_jax.types import Recordings

RATE = 10.0  # snapshots per second
PICKED = 4  # half of a trial's snapshots that train
FOLDS = 5
FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the record
GRID = replace(TRIAL_GRID, kernels=("rbf",), costs=(1.0, 10.0))
RANKS = replace(GRID, costs=(1.0,), ranks=True)  # with ranks all costs from here on are much the same
ENDS = 20  # snapshots that a complete record counts for: early ones have little information on the failure

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """The encoder and features of one row."""

    families: tuple[str, ...]
    window: int = 5
    scale: float = 1.0  # factor on the preset's thresholds
    grid: Grid = GRID


METHODS = {
    "plain words": Method(TRIAL),
    "richer words": Method(RICHER, grid=RANKS),
    "richer words, thresholds / 16": Method(RICHER, 20, 1 / 16, RANKS),
    "richer words, thresholds / 256": Method(RICHER, 20, 1 / 256, RANKS),
}


def moments(items: LabelledIntervals, snapshots: Snapshots) -> dict[str, NDArray[np.int64]]:
    """The first snapshot of every trial at or after each part of its record."""
    length = (items.intervals[0].end - items.intervals[0].start)[snapshots.interval]
    rows = {}
    for fraction in FRACTIONS:
        late = np.flatnonzero(snapshots.now - snapshots.begin >= fraction * length)
        rows[f"at {fraction:.0%}"] = late[np.unique(snapshots.interval[late], return_index=True)[1]]
    return rows


def streamed(
    items: LabelledIntervals,
    snapshots: Snapshots,
    training: NDArray[np.bool_],
    x: Floats,
    method: Method,
    test: Floats,
    seed: int,
) -> tuple[ProbabilisticSvm, Floats]:
    """A classifier of all trials but ``test``, and its beliefs ``[snapshot, class]`` about those, NaN elsewhere."""
    tested = np.isin(snapshots.interval, test)
    rows = np.flatnonzero(~tested & training)
    spec = FeatureSpec(families=method.families)
    machine = learn(x[rows], snapshots.take(rows), items, spec, method.grid, ENDS, seed)
    p = np.full((len(tested), len(items.classes)), np.nan)
    p[tested] = machine.probability(x[tested])
    return machine, p


def fold(
    items: LabelledIntervals,
    snapshots: Snapshots,
    training: NDArray[np.bool_],
    x: Floats,
    method: Method,
    test: Floats,
    seed: int,
) -> dict[str, Any]:
    """Train on the trials that are not in ``test``, stream those."""
    machine, p = streamed(items, snapshots, training, x, method, test, seed)
    tested, y = np.isin(snapshots.interval, test), items.y[snapshots.interval]
    out: dict[str, Any] = {"every tenth of a second": metrics.accuracy(y[tested], p[tested].argmax(1))}
    for name, at in moments(items, snapshots).items():
        mine = at[tested[at]]
        out[name] = metrics.accuracy(y[mine], p[mine].argmax(1))
        votes = machine.svm.predict_index(x[mine])
        out[f"{name}, votes of pairs"] = metrics.accuracy(y[mine], votes)
    out["true and said at 100%, votes of pairs"] = metrics.confusion(y[mine], votes, len(items.classes))
    out["calibration error of steps"] = metrics.calibration_error(p[tested], y[tested])
    out["chosen"] = f"{machine.svm.spec.kernel} C={machine.svm.spec.cost:g}"
    return out


def summary(runs: list[dict[str, Any]], trials: int) -> dict[str, Any]:
    """Mean and 95 % interval of every score, at a moment of each of the ``trials``; the sum of what is counted."""
    out: dict[str, Any] = {}
    for name in runs[0]:
        values = [run[name] for run in runs]
        if isinstance(values[0], str):
            out[name] = {word: values.count(word) for word in sorted(set(values))}
            continue
        if np.ndim(values[0]):
            out[name] = np.sum(values, 0).tolist()
            continue
        once = trials if name.startswith("at ") else 0
        out[name] = with_interval(values, 1 / (FOLDS - 1), trials=once, items=once)
    return out


def watched(recordings: Recordings, snapshots: Snapshots, method: Method) -> Floats:
    """Features of all snapshots."""
    config = EncoderConfig(window=method.window, dt=recordings.dt)
    limits = GradientThresholds(np.asarray(preset().limits) * method.scale)
    spec = FeatureSpec(families=method.families)
    return described(recordings, snapshots, spec, (config, limits), "snapshots").astype(np.float64)


def that_train(items: LabelledIntervals, snapshots: Snapshots, dt: float) -> NDArray[np.bool_]:
    """Which of the regular snapshots train."""
    chosen = training_snapshots(items, round(1 / (RATE * dt)), PICKED, early=False)
    return np.isin(snapshots.interval * 10**7 + snapshots.now, chosen.interval * 10**7 + chosen.now)


def row(
    recordings: Recordings, items: LabelledIntervals, snapshots: Snapshots, method: Method, repeats: int, seed: int
) -> dict[str, Any]:
    training = that_train(items, snapshots, recordings.dt)
    x = watched(recordings, snapshots, method)
    splits = repeated_folds(items.y, items.trial, FOLDS, repeats, seed)
    parts = [(seed + k, test) for k, folds in enumerate(splits) for _, test in folds]
    runs = [fold(items, snapshots, training, x, method, test, s) for s, test in tqdm(parts, disable=None)]
    return summary(runs, len(items.y))


def main(repeats: int = 1, seed: int = 0, only: Only = ALL_ROWS) -> None:
    recordings = recorded()
    items = labelled_intervals(recordings, failure_types())
    snapshots = regular_snapshots(items, round(1 / (RATE * recordings.dt)))
    about = {
        "what": "failure type of simulated failures from the stream; folds grouped by trial",
        "trials": len(items.y),
        "left out": items.dropped,
        "classes": {c: int((items.y == k).sum()) for k, c in enumerate(items.classes)},
        "most frequent class": round(float(np.bincount(items.y).max() / len(items.y)), 3),
        "folds": FOLDS,
        "repeats": repeats,
        "complete record counts for": ENDS,
    }
    command = f"python -m experiments.online.failure_types --repeats {repeats} --seed {seed}"
    wanted = {name: partial(row, recordings, items, snapshots, m, repeats, seed) for name, m in METHODS.items()}
    Rows("failure_types_online", command, about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
