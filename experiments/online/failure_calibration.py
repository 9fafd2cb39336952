"""Calibration of beliefs in a type of failure: calibration error by quarter of the record and by class.

Early in the approach, which the authors perturb, the wrench carries little information on the type; sigmoids fitted on
all snapshots of a record are overconfident early and underconfident late, and in a pooled error the two cancel. Here a
belief is calibrated by progress as ``rcbht train-online`` does (:mod:`rcbht_jax.learning.progress`): in every quarter
of the median record of the training trials a temperature and a share of the classes' frequencies, fitted by likelihood.
Five folds grouped by trial; the calibration of a fold is fitted on the beliefs about the trials of the other folds,
none of which trained the classifier that they come from. Those classifiers were trained on the trials of the fold; two
numbers per quarter hardly transfer that.

Errors are expected calibration errors of the likeliest type, and of every type by itself (its belief against how often
it is true), over ten bins and all snapshots of a quarter of the trial's own record.

Run: python -m experiments.online.failure_calibration --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.arrays import Floats, Ints
from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import drawn, sums
from experiments.online.failure_types import FOLDS, METHODS, streams
from rcbht_jax.learning import metrics
from rcbht_jax.learning.progress import PARTS, ProgressCalibration, part_of
from rcbht_jax.learning.validation import repeated_folds

TARGET = 0.08
BINS = 10


def by_progress(p: Floats, y: Ints, fold: Ints, seconds: Floats, trial: NDArray[np.str_], planned: Floats) -> Floats:
    """Calibrated beliefs: those of a fold by what was fitted on the other folds.

    Beliefs ``[step, class]`` are those of classifiers that did not see the trial, folds ``[step]`` those in which it
    was tested; ``planned`` is the median length of the records that did not test in a fold, s.
    """
    out = np.empty_like(p)
    for number in np.unique(fold):
        mine, others = fold == number, fold != number
        learn = (p[others], y[others], seconds[others], trial[others])
        out[mine] = ProgressCalibration.fit(*learn, float(planned[number]))(p[mine], seconds[mine])
    return out


def errors(p: Floats, y: Ints, quarter: Ints, classes: tuple[str, ...], trial: NDArray[Any]) -> dict[str, Any]:
    """Calibration errors of each quarter of the record, of the likeliest class and of every class."""
    top, right = p.max(1), p.argmax(1) == y
    found: dict[str, Any] = {"pooled": metrics.calibration_error(p, y), "pooled interval": interval(top, right, trial)}
    for part in range(PARTS):
        mine = quarter == part
        alone = [error(p[mine, c], y[mine] == c) for c in range(len(classes))]
        worst = int(np.argmax(alone))
        found[f"quarter {part + 1}"] = {
            "likeliest": metrics.calibration_error(p[mine], y[mine]),
            "likeliest interval": interval(top[mine], right[mine], trial[mine]),
            "mean belief": float(top[mine].mean()),
            "accuracy": metrics.accuracy(y[mine], p[mine].argmax(1)),
            "worst class": alone[worst],
            "worst class interval": interval(p[mine, worst], y[mine] == worst, trial[mine]),
            "classes": dict(zip(classes, alone, strict=True)),
        }
    return rounded(found)


def interval(p: Floats, true: NDArray[np.bool_], trial: NDArray[Any]) -> list[float]:
    """95 % interval of the calibration error of a belief ``[step]`` from trials drawn with replacement.

    A draw adds noise, which an error counts as error: what the draws exceed it by in the mean is subtracted.
    """
    bin_of = np.minimum((p * BINS).astype(np.int64), BINS - 1)
    gap = sums((p - true)[:, None] * (bin_of[:, None] == np.arange(BINS)), trial)  # [trial, bin]
    steps, counts = sums(np.ones(len(p)), trial), drawn(len(gap), 0)
    found = np.abs(counts @ gap).sum(1) / (counts @ steps)
    low, high = np.array(metrics.percentile_interval(found, len(gap))) - found.mean() + error(p, true)
    return [max(float(low), 0.0), float(high)]


def error(p: Floats, true: NDArray[np.bool_]) -> float:
    """Calibration error of a belief ``[step]`` in what is true or not."""
    return metrics.calibration_error(p[:, None], (~true).astype(np.int64), BINS)  # of one class, number 0


def row(name: str, seed: int) -> dict[str, Any]:
    recordings = recorded()
    data = streams(recordings, METHODS[name])
    items, snapshots, y = data.items, data.snapshots, data.y
    length = ((items.intervals[0].end - items.intervals[0].start) * recordings.dt).astype(np.float64)
    p = np.full((len(snapshots), len(items.classes)), np.nan)
    fold, planned = np.zeros(len(snapshots), np.int64), np.zeros(FOLDS)
    for number, (train, test) in enumerate(repeated_folds(items.y, items.trial, FOLDS, 1, seed)[0]):
        beliefs, mine = data.believed(test, seed)[1], np.isin(snapshots.interval, test)
        p[mine], fold[mine], planned[number] = beliefs[mine], number, np.median(length[train])
    seconds, trial = (snapshots.now - snapshots.begin) * recordings.dt, items.trial[snapshots.interval]
    quarter = part_of(seconds / length[snapshots.interval] - 1e-9)
    made = {"as they are": p, "by progress": by_progress(p, y, fold, seconds, trial, planned)}
    return {kind: errors(q, y, quarter, items.classes, trial) for kind, q in made.items()}


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    about = {
        "what": "calibration of streamed beliefs in types of the authors' simulated failures, by quarter of the record",
        "target": TARGET,
        "folds": FOLDS,
        "bins": BINS,
    }
    wanted = {name: partial(row, name, seed) for name in ("richer words", "richer words, thresholds / 256")}
    Rows("failure_calibration", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
