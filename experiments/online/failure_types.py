"""Failure types of the authors' simulated failures, believed from the stream: accuracy at parts of the record.

Five folds grouped by trial: four train, the fifth is streamed at 10 Hz. A streamed classifier has one encoder: finer
ones take a window of 20 samples and a fraction of the preset's thresholds. "Richer words" are features without elapsed
time and absolute level. The baseline is the most frequent class. With so many classes the likeliest class and the one
with most votes of the pairs differ; both are reported. The weight of a complete record (twenty snapshots) and the cost
of richer words were chosen on two of these folds, so expect a little less on new trials.

Run: python -m experiments.online.failure_types --repeats 1 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.arrays import Floats
from experiments._lib.benchmarks import recorded, with_interval
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
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


@dataclass(frozen=True)
class Streams:
    """The failures of all types, as a stream has them ten times a second."""

    items: LabelledIntervals  # one for each trial
    snapshots: Snapshots
    training: NDArray[np.bool_]  # [snapshot] of the regular ones, those that train
    x: Floats  # [snapshot, feature]
    method: Method

    @property
    def y(self) -> NDArray[np.int64]:
        """Class ``[snapshot]``."""
        return self.items.y[self.snapshots.interval]

    def moments(self) -> dict[str, NDArray[np.int64]]:
        """The first snapshot of every trial at or after each part of its record."""
        span, snapshots, rows = self.items.intervals[0], self.snapshots, {}
        length = (span.end - span.start)[snapshots.interval]
        for fraction in FRACTIONS:
            late = np.flatnonzero(snapshots.now - snapshots.begin >= fraction * length)
            rows[f"at {fraction:.0%}"] = late[np.unique(snapshots.interval[late], return_index=True)[1]]
        return rows

    def believed(self, test: NDArray[np.int64], seed: int) -> tuple[ProbabilisticSvm, Floats]:
        """A classifier of all trials but ``test``, and its beliefs ``[snapshot, class]`` about those, NaN elsewhere."""
        tested = np.isin(self.snapshots.interval, test)
        rows = np.flatnonzero(~tested & self.training)
        spec = FeatureSpec(families=self.method.families)
        machine = learn(self.x[rows], self.snapshots.take(rows), self.items, spec, self.method.grid, ENDS, seed)
        p = np.full((len(tested), len(self.items.classes)), np.nan)
        p[tested] = machine.probability(self.x[tested])
        return machine, p


def streams(recordings: Recordings, method: Method) -> Streams:
    """The failures with the features of a method."""
    items, every = labelled_intervals(recordings, failure_types()), round(1 / (RATE * recordings.dt))
    snapshots, chosen = regular_snapshots(items, every), training_snapshots(items, every, PICKED, early=False)
    training = np.isin(snapshots.interval * 10**7 + snapshots.now, chosen.interval * 10**7 + chosen.now)
    config = EncoderConfig(window=method.window, dt=recordings.dt)
    limits = GradientThresholds(np.asarray(preset().limits) * method.scale)
    spec = FeatureSpec(families=method.families)
    x = described(recordings, snapshots, spec, (config, limits), "snapshots").astype(np.float64)
    return Streams(items, snapshots, training, x, method)


def fold(data: Streams, test: NDArray[np.int64], seed: int) -> dict[str, Any]:
    """Train on the trials that are not in ``test``, stream those."""
    machine, p = data.believed(test, seed)
    tested, y = np.isin(data.snapshots.interval, test), data.y
    out: dict[str, Any] = {"every tenth of a second": metrics.accuracy(y[tested], p[tested].argmax(1))}
    for name, at in data.moments().items():
        mine = at[tested[at]]
        out[name] = metrics.accuracy(y[mine], p[mine].argmax(1))
        votes = machine.svm.predict_index(data.x[mine])
        out[f"{name}, votes of pairs"] = metrics.accuracy(y[mine], votes)
    out["true and said at 100%, votes of pairs"] = metrics.confusion(y[mine], votes, len(data.items.classes))
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


def row(recordings: Recordings, method: Method, repeats: int, seed: int) -> dict[str, Any]:
    data = streams(recordings, method)
    splits = repeated_folds(data.items.y, data.items.trial, FOLDS, repeats, seed)
    parts = [(seed + k, test) for k, folds in enumerate(splits) for _, test in folds]
    runs = [fold(data, test, s) for s, test in tqdm(parts, disable=None)]
    return summary(runs, len(data.items.y))


def main(repeats: int = 1, seed: int = 0, only: Only = ALL_ROWS) -> None:
    recordings = recorded()
    items = labelled_intervals(recordings, failure_types())
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
    wanted = {name: partial(row, recordings, m, repeats, seed) for name, m in METHODS.items()}
    Rows("failure_types_online", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
