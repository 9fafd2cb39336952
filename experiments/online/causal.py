"""Sub-tasks of a stream by the frozen method, with beginnings given and detected, compared with simple baselines.

Where the beginnings are given (the protocol of the paper's Table II) counting them is enough. Otherwise a classifier of
the whole trial so far and a filter over time detect them; only this is possible on a robot. Half of the trials train
and the others are streamed, or one session trains and the other is streamed. Baselines use the time since the beginning
(given) or since the start of the record (detected), alone or with the wrench of the last tenth of a second, in a random
forest.

The last rows measure how well features without duration and offset predict the time since a sub-task began: a ridge
regression of its logarithm on their ranks, within each class, trained on half of the trials and scored on the others.

Run: python -m experiments.online.causal --repeats 3 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import RidgeCV
from sklearn.metrics import r2_score

from experiments._lib import frozen, streams
from experiments._lib.arrays import Flags, Floats, Ints
from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import at_least, drawn, of_splits, sums
from experiments._lib.streams import halves
from experiments._lib.tasks import states
from experiments.online.table2 import SETS
from rcbht_jax.introspection.training import Snapshots, since_trial_start
from rcbht_jax.learning import metrics
from rcbht_jax.learning.scaling import fit_scale
from rcbht_jax.learning.validation import repeat_seeds
from rcbht_jax.types import Recordings

LAST = 0.1  # s of wrench that the baseline uses
TREES = 200
SPLITS = {"REAL": ("REAL", ()), "A to B": ("REAL", ("A", "B")), "B to A": ("REAL", ("B", "A")), "SIM1": ("SIM1", ())}
MEASURES = ("macro step accuracy", "full-sequence accuracy", "OverallPr")
KINDS = {"frozen": False, "frozen, relative": True}
ALPHAS = tuple(10.0**power for power in range(-2, 5))  # of the ridge


class Stream(streams.Stream):
    """Trials of one arm as streams of the frozen method."""

    def __init__(self, method: frozen.FrozenMethod, data: Recordings, **filters: Any) -> None:
        heads = {head: (method.stream_spec(head), *method.stream_learning(head)) for head in ("state", "phase")}
        encoder, rate = method.stream_encoder(data.dt), method.streamed["rate"]
        super().__init__(data, states(arms="R", **filters), encoder, heads, rate)
        self.method = method


def wrench_of(stream: Stream, snapshots: Snapshots) -> Floats:
    """Mean, deviation and last value of the last tenth of a second, and seconds since the beginning."""
    data, count, rows = stream.data, round(LAST / stream.data.dt), []
    for recording, begin, now in zip(snapshots.recording, snapshots.begin, snapshots.now, strict=True):
        part = data.wrench[recording, max(0, now - count) : now].astype(np.float64)
        rows.append(np.concatenate([part.mean(0), part.std(0), part[-1], [(now - begin) * data.dt]]))
    return np.array(rows)


def measures(p: Floats, y: Ints, whole: Flags) -> dict[str, float]:
    """Scores of beliefs ``[snapshot, class]``; ``whole`` marks the last snapshot of each sub-task."""
    scores = (
        metrics.macro_step_accuracy(p, y), metrics.accuracy(y[whole], p[whole].argmax(1)),
        metrics.overall_pr(p[whole], y[whole]),
    )  # fmt: skip
    return dict(zip(MEASURES, scores, strict=True))


def inside_of(stream: Stream, sessions: tuple[str, ...], seed: int) -> Flags:
    """Which intervals train: half of the trials, or those of the sessions joined by + in the first name."""
    return np.isin(stream.items.session, sessions[0].split("+")) if sessions else halves(stream.items, seed)


def given_starts(stream: Stream, relative: bool, inside: Flags, seed: int) -> dict[str, float]:
    """The method where each beginning is given."""
    snapshots, p = stream.given(relative, inside, seed)
    return measures(p, stream.items.y[snapshots.interval], snapshots.complete)


def unaided(stream: Stream, relative: bool, inside: Flags, seed: int) -> dict[str, dict[str, float]]:
    """The method where no beginning is given: the beliefs of both heads, and of the filter."""
    found = stream.detected(relative, inside, seed)
    y, whole = stream.items.y[found.snapshots.interval], found.snapshots.complete
    beliefs = {"phase": found.phase, "filter": found.filtered, "state": found.state}
    return {name: measures(p, y, whole) for name, p in beliefs.items()}


def counted(stream: Stream, inside: Flags) -> dict[str, float]:
    """The class is the number of beginnings given so far."""
    rows = np.flatnonzero(~inside[stream.regular.interval])
    place = np.zeros(len(stream.items.y), np.int64)
    for trial in np.unique(stream.items.trial):
        mine = np.flatnonzero(stream.items.trial == trial)
        place[mine[np.argsort(stream.items.intervals[0].start[mine])]] = np.arange(len(mine))
    p = np.eye(len(stream.items.classes))[place[stream.regular.interval[rows]]]
    return measures(p, stream.items.y[stream.regular.interval[rows]], stream.regular.complete[rows])


def little(stream: Stream, inside: Flags, seed: int, from_trial: bool, wrench: bool) -> dict[str, float]:
    """A forest on the time that has passed, with or without the wrench of the last tenth of a second."""
    train, test = stream.training, stream.regular
    if from_trial:
        train, test = since_trial_start(train), stream.trial
    a, b = np.flatnonzero(inside[train.interval]), np.flatnonzero(~inside[test.interval])
    first, second = wrench_of(stream, train.take(a)), wrench_of(stream, test.take(b))
    columns = slice(None) if wrench else slice(-1, None)
    forest = RandomForestClassifier(TREES, random_state=seed, class_weight="balanced")
    forest.fit(first[:, columns], stream.items.y[train.interval[a]])
    return measures(forest.predict_proba(second[:, columns]), stream.items.y[test.interval[b]], test.complete[b])


def split(stream: Stream, sessions: tuple[str, ...], seed: int) -> dict[str, dict[str, float]]:
    """All rows of one split."""
    inside = inside_of(stream, sessions, seed)
    out = {"given | counting beginnings": counted(stream, inside)}
    for wrench, name in ((False, "elapsed time"), (True, "last 0.1 s and elapsed time, forest")):
        out[f"given | {name}"] = little(stream, inside, seed, from_trial=False, wrench=wrench)
        out[f"detected | {name}"] = little(stream, inside, seed, from_trial=True, wrench=wrench)
    for name, relative in KINDS.items():
        out[f"given | {name}"] = given_starts(stream, relative, inside, seed)
        for belief, scores in unaided(stream, relative, inside, seed).items():
            out[f"detected | {name}, {belief}"] = scores
    return out


def row(stream: Callable[[], Stream], sessions: tuple[str, ...], seeds: range) -> dict[str, Any]:
    """Every row of a data set with its intervals."""
    stream_ = stream()
    runs = [split(stream_, sessions, seed) for seed in (seeds[:1] if sessions else seeds)]
    outside = [~inside_of(stream_, sessions, seed) for seed in seeds[: len(runs)]]
    tested = len(np.unique(stream_.items.trial[outside[0]]))
    sentences = int(np.any(outside, axis=0).sum())  # those that some split tests, each right or wrong at its end
    out: dict[str, Any] = {"trials tested": tested, "splits": len(runs), "method": stream_.method.sha256}
    for name in runs[0]:
        out[name] = {measure: of_splits([run[name][measure] for run in runs], 1.0, tested) for measure in MEASURES}
        out[name][MEASURES[1]] = at_least(out[name][MEASURES[1]], sentences)
    return rounded(out)


def time_known(stream: Callable[[], Stream], seeds: range) -> dict[str, Any]:
    """R^2 of the logarithm of elapsed time within each class, from features without duration and offset.

    The median of the halves that test; its interval from trials drawn with replacement, the same for every half.
    """
    made = stream()
    snapshots = made.regular
    elapsed = np.log((snapshots.now - snapshots.begin) * made.data.dt)
    x, y = made.used(made.x("regular"), "state", True), made.items.y[snapshots.interval]
    trial = made.items.trial[snapshots.interval]
    counts = drawn(len(np.unique(trial)), 0)
    found: dict[str, list[float]] = {name: [] for name in made.items.classes}
    draws: dict[str, list[Floats]] = {name: [] for name in made.items.classes}
    for seed in seeds:
        inside = halves(made.items, seed)[snapshots.interval]
        for number, name in enumerate(made.items.classes):
            a, b = np.flatnonzero(inside & (y == number)), np.flatnonzero(~inside & (y == number))
            scale = fit_scale(x[a], True, 0.0, True)
            machine = RidgeCV(ALPHAS).fit(scale(x[a]), elapsed[a])
            predicted = machine.predict(scale(x[b]))
            found[name].append(float(r2_score(elapsed[b], predicted)))
            tested = np.isin(np.unique(trial), trial[b])
            draws[name].append(drawn_r2(elapsed[b], predicted, trial[b], counts[:, tested]))
    ends = {name: metrics.percentile_interval(np.median(each, 0), counts.shape[1]) for name, each in draws.items()}
    return rounded(
        {name: {"mean": float(np.median(found[name])), "low": low, "high": high} for name, (low, high) in ends.items()}
    )


def drawn_r2(true: Floats, predicted: Floats, trial: NDArray[Any], counts: Ints) -> Floats:
    """R^2 of each draw, where trials count so often ``[draw, trial]``."""
    parts = np.stack([np.ones(len(true)), true, true**2, (true - predicted) ** 2], 1)
    number, total, square, rest = (counts @ sums(parts, trial)).T
    return np.asarray(1 - rest / (square - total**2 / number))


def main(repeats: int = 3, seed: int = 0, only: Only = ALL_ROWS) -> None:
    method = frozen.load()
    data = recorded()
    streams = {name: cache(partial(Stream, method, data, sources=(SETS[name],))) for name in ("REAL", "SIM1")}
    about = {
        "what": "states of a stream by the frozen method, with beginnings given and detected, beside simple baselines",
        "confound": "where beginnings are given, counting them is enough",
        "sha256 of the method": method.sha256,
        "belief of the method": method.streamed["belief"],
        "repeats": repeats,
    }
    seeds = repeat_seeds(seed, repeats)
    wanted: dict[str, Callable[[], Any]] = {
        name: partial(row, streams[source], sessions, seeds) for name, (source, sessions) in SPLITS.items()
    }
    wanted |= {f"time known, {name}": partial(time_known, stream, seeds) for name, stream in streams.items()}
    Rows("causal", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
