"""Sub-tasks that the controller does not announce: when they are detected, and the effect on the beliefs.

A classifier "phase" estimates the present state from the features of the whole trial; a filter over time, whose states
only follow each other, detects when the next one begins. Half of the trials train, the other half is streamed at 10 Hz.
Beliefs about the state (from the features of the sub-task, as in table2) are made with the given starts (harmonised)
and with the detected ones; both are compared with the true state, and so are the classifier and the filter alone. The
filter's two constants were chosen on these trials, with the paper's words.

All of this by the paper's words and by those of the fit rule: as they are, weighed by time and change of value, and
with a quarter of the tolerance (experiments.classification.fitted_words). Tolerances are learned as there, without
labels: of the robot from session A, of the simulation from its own trials.

Run: python -m experiments.online.detected_starts --repeats 10 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.benchmarks import recorded, with_interval
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.fit_words import FIT_RULE, WORDS, Words, tolerances
from experiments._lib.streams import Encoder, Head, Starts, Stream, halves
from experiments._lib.tasks import states
from experiments.online.table2 import SETS
from rcbht_jax.introspection.training import HeadSpec, Snapshots
from rcbht_jax.learning import metrics
from rcbht_jax.learning.validation import repeat_seeds
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings

RATE = 10.0  # snapshots per second
NEAR = 0.5  # s, within which a start counts as detected
STREAMED = ("REAL", "SIM1")


def heads(words: Words) -> dict[str, Head]:
    """The two classifiers, as ``rcbht train-online`` learns them."""
    specs = {name: HeadSpec(states(), phase=name == "phase", weighing=words.weighing) for name in ("state", "phase")}
    return {name: (head.view.spec, *head.learning) for name, head in specs.items()}


def going_on(snapshots: Snapshots, starts: dict[int, Starts], dt: float) -> NDArray[np.int64]:
    """The detected sub-task at each snapshot."""
    out = np.zeros(len(snapshots), np.int64)
    for recording, detected in starts.items():
        for state, time in detected.items():
            out[(snapshots.recording == recording) & (snapshots.now * dt >= time - dt / 2)] = state
    return out


def repeat(stream: Stream, seed: int) -> dict[str, Any]:
    """Scores of one half-split."""
    items, dt, inside = stream.items, stream.data.dt, halves(stream.items, seed)
    given, p = stream.given(False, inside, seed)
    found = stream.detected(False, inside, seed)
    y = items.y[found.snapshots.interval]
    scores = {
        "given": (items.y[given.interval], p),
        "detected": (y, found.state),
        "phase alone": (y, found.phase),
        "filter alone": (y, np.eye(len(items.classes))[going_on(found.snapshots, found.starts, dt)]),
    }
    onset, later = stream.data.starts(HARMONISED), range(1, len(items.classes))
    errors = [[own.get(s, np.nan) - onset[recording, s] for s in later] for recording, own in found.starts.items()]
    return {"errors": np.array(errors)} | {
        f"macro step accuracy, {name}": metrics.macro_step_accuracy(probability, y_true)
        for name, (y_true, probability) in scores.items()
    }


def summary(runs: list[dict[str, Any]], classes: tuple[str, ...]) -> dict[str, Any]:
    """Scores with intervals; errors of the beginnings over all repeats."""
    out: dict[str, Any] = {n: with_interval([run[n] for run in runs]) for n in runs[0] if n != "errors"}
    away = np.abs(np.concatenate([run["errors"] for run in runs]))  # NaN = never detected
    for name, column in zip(classes[1:], away.T, strict=True):
        out[f"beginning of {name}"] = {
            "detected": round(float(np.isfinite(column).mean()), 3),
            f"within {NEAR:g} s": round(float((column <= NEAR).mean()), 3),
        }
    return out


def row(data: Recordings, name: str, words: Words, encoder: Encoder, seeds: range) -> dict[str, Any]:
    """Scores of one set with words of one kind."""
    stream = Stream(data, states(sources=(SETS[name],), arms="R"), encoder, heads(words), RATE)
    runs = [repeat(stream, seed) for seed in tqdm(seeds, desc=name, file=sys.stderr, disable=None)]
    return {"trials": len(np.unique(stream.items.trial)), **summary(runs, stream.items.classes)}


def main(repeats: int = 10, seed: int = 0, only: Only = ALL_ROWS) -> None:
    data = recorded()
    tolerance = tolerances(data)
    about = {
        "what": "beginnings of sub-tasks detected in the stream, held against the harmonised ones",
        "repeats": repeats,
        "fit rule": FIT_RULE,
        "tolerance": {source: values.tolist() for source, values in tolerance.items()},
        "choices": "families, weighing and factors on the tolerance were fixed before the first score of a fit row",
    }
    wanted: dict[str, Callable[[], Any]] = {}
    for kind, words in WORDS.items():
        for name in STREAMED:
            encoder = words.encoder(tolerance[SETS[name]], data.dt)
            wanted[f"{name} | {kind}"] = partial(row, data, name, words, encoder, repeat_seeds(seed, repeats))
    Rows("detected_starts", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
