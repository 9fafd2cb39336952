"""Table II of the paper on held-out trials: beliefs while the sub-task runs.

Half of the trials train a classifier of the states, the other half is streamed; repeated with other halves. Kernel and
cost are chosen inside the training half. A belief at a sample uses what a stream had at that sample: the labels
published by then and the encoder's provisional ones. The paper's own measures (k, counts, AvgLen, m over the class
average) are given as well, at the paper's three rates.

"relative" repeats everything with features without duration and absolute offset.

Run: python -m experiments.online.table2 --repeats 50 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from experiments._lib.arrays import Floats
from experiments._lib.benchmarks import REAL, SIM1, SIM2, recorded, with_interval
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.streams import Stream, halves
from experiments._lib.tasks import states
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import SUBTASK, SUBTASK_RELATIVE
from rcbht_jax.introspection.training import ENDS, GRID, Snapshots
from rcbht_jax.learning import metrics
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.learning.validation import repeat_seeds
from rcbht_jax.types import Recordings

KINDS = {"all": SUBTASK, "relative": SUBTASK_RELATIVE}
MAIN_RATE = 10.0
RATES = (MAIN_RATE, 2.0, 100.0)
FRACTIONS = 10  # of the sub-task, for the early-classification curve
SETS = {"REAL": REAL, "SIM1": SIM1, "SIM2": SIM2}
FULL = "full-sequence accuracy"
TARGETS = {
    "REAL": {"macro step accuracy": 0.90, FULL: 0.98, "OverallPr": 0.93, "own m at .70": 0.60},
    "SIM1": {FULL: 0.95, "OverallPr": 0.88},
}
PAPER = {"REAL": {FULL: 0.95, "OverallPr": 0.84, "m at .70": [0.95, 0.10, 0.36, 0.68]}}

WHOLE = "beliefs and classes of full sequences"
CHANCE = "ECE full sequences, were they calibrated perfectly"


def certainty_rows(p: Floats, snapshots: Snapshots, items: LabelledIntervals) -> dict[str, Any]:
    """Counts and m of the streamed test intervals at every k."""
    order = np.unique(snapshots.interval)
    parts = [p[snapshots.interval == s] for s in order]
    y_true = [int(items.y[s]) for s in order]
    rows = {}
    for k in metrics.CERTAINTY_LEVELS:
        c = metrics.certainties(parts, y_true, k)
        names = ("count_min", "count_mean", "count_max", "avg_len", "m_paper", "m_own")
        rows[f"k={k:.2f}"] = {name: getattr(c, name) for name in names}
    return rows


def time_to_confidence(p: Floats, snapshots: Snapshots, items: LabelledIntervals, k: float, dt: float) -> Floats:
    """Median seconds until a belief is first right and certain for good, per class; inf where most never are."""
    seconds: list[list[float]] = [[] for _ in items.classes]
    for s in np.unique(snapshots.interval):
        mine = snapshots.interval == s
        sure = (p[mine].argmax(1) == items.y[s]) & (p[mine].max(1) > k)
        last_doubt = np.flatnonzero(~sure)
        first = int(last_doubt[-1]) + 1 if last_doubt.size else 0
        elapsed = (snapshots.now[mine] - snapshots.begin[mine]) * dt
        seconds[items.y[s]].append(float(elapsed[first]) if first < len(elapsed) else np.inf)
    return np.array([np.median(x) for x in seconds])


def early(p: Floats, snapshots: Snapshots, items: LabelledIntervals) -> Floats:
    """Accuracy ``[class, fraction]`` at 10, 20, ... 100 % of the sub-task."""
    where = items.intervals[0]
    length = (where.end - where.start)[snapshots.interval]
    bucket = np.minimum(((snapshots.now - snapshots.begin) * FRACTIONS - 1) // length, FRACTIONS - 1)
    right = (p.argmax(1) == items.y[snapshots.interval]).astype(float)
    cell = items.y[snapshots.interval] * FRACTIONS + bucket
    size = len(items.classes) * FRACTIONS
    total = np.bincount(cell, minlength=size)
    hits = np.bincount(cell, right, minlength=size)
    return np.divide(hits, total, out=np.full(size, np.nan), where=total > 0).reshape(-1, FRACTIONS)


def repeat(stream: Stream, relative: bool, seed: int) -> Any:
    """All numbers of one half-split."""
    items, inside = stream.items, halves(stream.items, seed)
    seen, p = stream.given(relative, inside, seed)
    y_true, whole, dt = items.y[seen.interval], seen.complete, stream.data.dt
    spec = stream.trained("state", relative, inside, seed).svm.spec
    return {
        "macro step accuracy": metrics.macro_step_accuracy(p, y_true),
        FULL: metrics.accuracy(y_true[whole], p[whole].argmax(1)),
        "OverallPr": metrics.overall_pr(p[whole], y_true[whole]),
        "ClassPr": metrics.class_pr(p[whole], y_true[whole]),
        "ECE steps": metrics.calibration_error(p, y_true),
        "ECE full sequences": metrics.calibration_error(p[whole], y_true[whole]),
        "seconds to lasting confidence at .70": time_to_confidence(p, seen, items, 0.70, dt),
        "accuracy by tenth of the sub-task": early(p, seen, items),
        "certainty": certainty_rows(p, seen, items),
        "confusion of full sequences": metrics.confusion(y_true[whole], p[whole].argmax(1), len(items.classes)),
        "reliability": metrics.reliability(p, y_true),
        "chosen": f"{spec.kernel} C={spec.cost:g}",
        WHOLE: (p[whole], y_true[whole]),
    }


def together(runs: list[Any], seed: int) -> dict[str, float]:
    """Calibration error of full sequences, repeats together, and that expected in one if beliefs were calibrated."""
    parts, rng = [run.pop(WHOLE) for run in runs], np.random.default_rng(seed)
    p, y_true = (np.concatenate(part) for part in zip(*parts, strict=True))
    drawn = [(one, (one.cumsum(1)[:, :-1] < rng.random((len(one), 1))).sum(1)) for one, _ in parts]
    return {
        "ECE full sequences, repeats together": round(metrics.calibration_error(p, y_true), 4),
        CHANCE: round(float(np.mean([metrics.calibration_error(*part) for part in drawn])), 4),
    }


def summary(runs: list[Any], items: int = 0) -> Any:
    """Means over the repeats, and for scores in [0, 1] their corrected 95% interval; the rest as it is.

    The interval of the accuracy on whole sub-tasks is no narrower than Wilson's of so many ``items``.
    """
    first = runs[0]
    if isinstance(first, dict):
        return {key: summary([run[key] for run in runs], items if key == FULL else 0) for key in first}
    if isinstance(first, str):
        return {word: runs.count(word) for word in sorted(set(runs))}
    stacked = np.asarray(runs, float)
    if stacked.ndim == 1 and len(runs) > 1:
        return with_interval(stacked, places=4, items=items)
    # Unbounded: None = never in most repeats. Undefined (an empty bin): None.
    middle = np.median(stacked, axis=0) if np.isinf(stacked).any() else _mean(stacked)
    rounded: Any = np.where(np.isfinite(middle), middle.round(4), None)
    return rounded.tolist()


def _mean(stacked: Floats) -> Floats:
    """Mean over the first axis, without NaN; NaN where there is no number."""
    there = ~np.isnan(stacked)
    total, count = np.where(there, stacked, 0).sum(0), there.sum(0)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def streamed(recordings: Recordings, name: str, rate: float = MAIN_RATE) -> Stream:
    """The trials of a set, with the encoder and the features of ``rcbht train-online``."""
    heads = {"state": (FeatureSpec(SUBTASK, balance=True), GRID, ENDS)}
    task = states(sources=(SETS[name],), arms="R")
    return Stream(recordings, task, (EncoderConfig(dt=recordings.dt), preset()), heads, rate)


def measure(recordings: Recordings, name: str, rate: float, repeats: int, seed: int) -> dict[str, Any]:
    stream = streamed(recordings, name, rate)
    items = stream.items
    result: dict[str, Any] = {
        "trials": len(np.unique(items.trial)),
        "left out": items.dropped,
        "classes": items.classes,
    }
    for kind in KINDS if rate == MAIN_RATE else ("all",):
        seeds = tqdm(repeat_seeds(seed, repeats), desc=f"{name} {kind}", file=sys.stderr, disable=None)
        runs = [repeat(stream, kind == "relative", one) for one in seeds]
        result[kind] = together(runs, seed) | summary(runs, len(items.y))
    return result


def main(repeats: int = 50, seed: int = 0, only: Only = ALL_ROWS) -> None:
    recordings = recorded()
    about = {
        "what": "states streamed over the untrained half of the trials; harmonised boundaries, right arm",
        "repeats": repeats,
        "targets": TARGETS,
        "paper": PAPER,
        "families": KINDS,
    }
    wanted = {
        f"{name} at {rate:g} Hz": partial(measure, recordings, name, rate, repeats, seed)
        for rate in RATES
        for name in SETS
    }
    Rows("table2", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
