"""Sub-tasks that the controller does not announce: when they are detected, and the effect on the beliefs.

A classifier "phase" estimates the present state from the features of the whole trial; a filter over time, whose states
only follow each other, detects when the next one begins. Half of the trials train, the other half is streamed at 10 Hz.
Beliefs about the state (from the features of the sub-task, as in table2) are made with the given starts (harmonised)
and with the detected ones; both are compared with the true state, and so are the classifier and the filter alone. The
filter's two constants were chosen on these trials, with the paper's words.

All of this by the paper's words and by those of the fit rule: as they are, weighed by time and change of value, and
with a quarter of the tolerance (experiments.classification.fitted_words). Tolerances are learned as there, without
labels: of the robot from session A, of the simulation from its own trials.

Run: python -m experiments.online.detected_starts --repeats 10 --seed 0
Finished rows are stored; the same command resumes an interrupted run. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.benchmarks import recorded, with_interval
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.fit_words import FIT_RULE, WORDS, Words, tolerances
from experiments._lib.tasks import states
from experiments.online.table2 import SETS, halves
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
from rcbht_jax.introspection.alarms import PhaseFilter
from rcbht_jax.introspection.training import (
    HeadSpec,
    Snapshots,
    learn,
    regular_snapshots,
    since_trial_start,
    snapshot_features,
    training_snapshots,
)
from rcbht_jax.learning import metrics
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.learning.validation import repeat_seeds
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings

RATE = 10.0  # snapshots per second
NEAR = 0.5  # s, within which a start counts as detected
STREAMED = ("REAL", "SIM1")

Encoder = tuple[AnyConfig, AnyLimits]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class View:
    """Snapshots with their features."""

    snapshots: Snapshots
    x: NDArray[np.float32]
    head: HeadSpec


def heads(words: Words) -> dict[str, HeadSpec]:
    """The two classifiers."""
    return {name: HeadSpec(states(), phase=name == "phase", weighing=words.weighing) for name in ("state", "phase")}


def fitted(items: LabelledIntervals, view: View, inside: NDArray[np.bool_], seed: int) -> ProbabilisticSvm:
    """A classifier of the states, trained on the snapshots of the training trials as by ``rcbht train-online``."""
    rows = inside[view.snapshots.interval]
    x = view.x[rows].astype(np.float64)
    return learn(x, view.snapshots.take(rows), items, view.head.view.spec, *view.head.learning, seed)


def detected_beginnings(p: Floats, time: Floats, classes: tuple[str, ...]) -> dict[int, float]:
    """When each sub-task but the first is detected, s: state -> time."""
    phases, starts = PhaseFilter(classes), {}
    for row, t in zip(p, time.tolist(), strict=True):
        if phases.update(row, t):
            starts[phases.current] = t
    return starts


def going_on(snapshots: Snapshots, starts: dict[int, dict[int, float]], dt: float) -> Ints:
    """The detected sub-task at each snapshot."""
    out = np.zeros(len(snapshots), np.int64)
    for recording, detected in starts.items():
        for state, time in detected.items():
            out[(snapshots.recording == recording) & (snapshots.now * dt >= time - dt / 2)] = state
    return out


def with_beginnings(snapshots: Snapshots, starts: dict[int, dict[int, float]], dt: float) -> Snapshots:
    """The same moments with sub-tasks that begin at their detection."""
    begin = np.zeros_like(snapshots.begin)
    for recording, detected in starts.items():
        mine = snapshots.recording == recording
        for time in sorted(detected.values()):
            sample = round(time / dt)
            begin[mine & (snapshots.now > sample)] = sample
    return replace(snapshots, begin=begin)


def repeat(
    data: Recordings, items: LabelledIntervals, views: dict[str, View], encoder: Encoder, seed: int
) -> dict[str, Any]:
    """Scores of one half-split."""
    inside, dt = halves(items, seed), data.dt
    state, phase = (fitted(items, views[name], inside, seed) for name in ("state trains", "phase trains"))
    given, trial = views["state"], views["phase"]
    test = ~inside[trial.snapshots.interval]
    snapshots = trial.snapshots.take(test)
    p = phase.probability(trial.x[test].astype(np.float64))
    starts, errors = {}, []
    for recording in np.unique(snapshots.recording).tolist():
        mine = snapshots.recording == recording
        starts[recording] = detected_beginnings(p[mine], snapshots.now[mine] * dt, items.classes)
        onset = data.starts(HARMONISED)[recording]
        errors.append([starts[recording].get(s, np.nan) - onset[s] for s in range(1, len(items.classes))])
    own = with_beginnings(snapshots, starts, dt)
    order = np.lexsort((own.now, own.recording))
    x = snapshot_features(data, own.take(order), given.head.view, *encoder)
    mine = ~inside[given.snapshots.interval]
    scores = {
        "given": (items.y[given.snapshots.interval[mine]], state.probability(given.x[mine].astype(np.float64))),
        "detected": (items.y[own.interval[order]], state.probability(x.astype(np.float64))),
        "phase alone": (items.y[snapshots.interval], p),
        "filter alone": (items.y[snapshots.interval], np.eye(len(items.classes))[going_on(snapshots, starts, dt)]),
    }
    out: dict[str, Any] = {
        f"macro step accuracy, {name}": metrics.macro_step_accuracy(probability, y_true)
        for name, (y_true, probability) in scores.items()
    }
    return out | {"errors": np.array(errors)}


def summary(runs: list[dict[str, Any]], classes: tuple[str, ...]) -> dict[str, Any]:
    """Scores with intervals; errors of the beginnings over all repeats."""
    out: dict[str, Any] = {n: with_interval([run[n] for run in runs]) for n in runs[0] if n != "errors"}
    errors = np.concatenate([run["errors"] for run in runs])
    for column, name in enumerate(classes[1:]):
        e = errors[:, column]
        seen = e[np.isfinite(e)]
        quantiles = np.quantile(seen, [0.05, 0.25, 0.5, 0.75, 0.95]) if len(seen) else np.full(5, np.nan)
        out[f"beginning of {name}"] = {
            "detected": round(float(np.isfinite(e).mean()), 3),
            f"within {NEAR:g} s": round(float((np.abs(seen) <= NEAR).sum() / len(e)), 3),
            "s late, quantiles .05 .25 .5 .75 .95": [round(float(q), 2) for q in quantiles],
        }
    return out


def views_of(data: Recordings, items: LabelledIntervals, words: Words, encoder: Encoder) -> dict[str, View]:
    """All snapshots that any repeat needs, with features."""
    every = round(1 / (RATE * data.dt))
    training, regular = training_snapshots(items, every), regular_snapshots(items, every)
    wanted = {
        "state trains": training,
        "state": regular,
        "phase trains": since_trial_start(training),
        "phase": since_trial_start(regular),
    }
    out = {}
    for name, snapshots in wanted.items():
        with tqdm(total=len(snapshots), desc=name, file=sys.stderr, disable=None) as bar:
            head = heads(words)[name.split()[0]]
            out[name] = View(snapshots, snapshot_features(data, snapshots, head.view, *encoder, bar.update), head)
    return out


def row(data: Recordings, name: str, words: Words, encoder: Encoder, seeds: range) -> dict[str, Any]:
    """Scores of one set with words of one kind."""
    items = labelled_intervals(data, states(sources=(SETS[name],), arms="R"))
    views = views_of(data, items, words, encoder)
    runs = [repeat(data, items, views, encoder, s) for s in tqdm(seeds, desc=name, file=sys.stderr, disable=None)]
    return {"trials": len(np.unique(items.trial)), **summary(runs, items.classes)}


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
    command = f"python -m experiments.online.detected_starts --repeats {repeats} --seed {seed}"
    Rows("detected_starts", command, about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
