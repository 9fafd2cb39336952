"""Success or failure of the real trials from the stream, and its confounds.

Every real failure was recorded in session C and every success in A or B, so that "failure" and "another session" are
the same question. Three rows show how much of the score is the session:

* mixed: half of the trials of all sessions train, the other half is streamed (the number that is usually reported);
* held out: the successes of one session and half of the failures train; the other session's successes and the other
  half of the failures are streamed, so that no success of the tested session was ever seen;
* sessions: the successes of A against those of B under the same protocol, where there is no failure to recognise.

Each with all features, with features without duration and absolute offset, and, by a balanced forest, with the elapsed
time alone. Scores are mean recalls of the two classes, at one second (before any contact), at parts of the record and
at its end.

Run: python -m experiments.online.abnormal_real --repeats 50 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from tqdm import tqdm

from experiments._lib.arrays import Flags, Floats
from experiments._lib.benchmarks import REAL, REAL_FAILURES, recorded, with_interval
from experiments._lib.results_io import write_result
from experiments._lib.streams import described
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.features.recipes import TRIAL, TRIAL_RELATIVE
from rcbht_jax.introspection.alarms import Alarm
from rcbht_jax.introspection.training import Snapshots, regular_snapshots
from rcbht_jax.learning import metrics
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.svm import Grid, select
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.learning.validation import repeat_seeds

SOURCES = (REAL, REAL_FAILURES)
RATE = 10.0  # snapshots per second
FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the record
PICKED = 16  # snapshots per trial that train, evenly spaced
HOLD, LEVEL = 0.3, 0.70  # s; the paper's k
TREES = 200  # of the forest on the elapsed time
GRID = Grid(kernels=("linear", "rbf"), costs=(0.01, 1.0, 10.0), scalings=(True,), balanced=True, inner=3, floor=0.1)


@dataclass(frozen=True)
class Watched:
    """All snapshots of all real trials."""

    items: LabelledIntervals  # one per trial
    snapshots: Snapshots
    x: Floats  # [snapshot, feature]
    dt: float

    @property
    def elapsed(self) -> Floats:
        """Seconds since the record began ``[snapshot]``."""
        return (self.snapshots.now - self.snapshots.begin) * self.dt


def halves(groups: list[Flags], rng: np.random.Generator) -> tuple[Flags, Flags]:
    """Half of each group of trials to train, the others to test."""
    train = np.zeros(len(groups[0]), bool)
    for group in groups:
        rows = rng.permutation(np.flatnonzero(group))
        train[rows[: len(rows) // 2]] = True
    return train, np.any(groups, axis=0) & ~train


def mixed(names: str, session: NDArray[np.str_], rng: np.random.Generator) -> Iterator[tuple[Flags, Flags]]:
    """Half of every session of these names trains."""
    yield halves([session == name for name in names], rng)


def held_out(session: NDArray[np.str_], rng: np.random.Generator) -> Iterator[tuple[Flags, Flags]]:
    """The successes of one session train, those of the other are tested; both ways."""
    for seen, unseen in ("AB", "BA"):
        train, test = halves([session == "C"], rng)
        yield train | (session == seen), test | (session == unseen)


SPLITS: dict[str, Callable[[NDArray[np.str_], np.random.Generator], Iterator[tuple[Flags, Flags]]]] = {
    "mixed": partial(mixed, "ABC"),
    "held out": held_out,
    "sessions": partial(mixed, "AB"),
}


def evenly(snapshots: Snapshots) -> Flags:
    """Snapshots that train: evenly spaced over each record, its end always."""
    chosen = np.zeros(len(snapshots), bool)
    for interval in np.unique(snapshots.interval):
        rows = np.flatnonzero(snapshots.interval == interval)
        chosen[rows[np.unique(np.linspace(0, len(rows) - 1, PICKED).round().astype(int))]] = True
    return chosen


def score(w: Watched, x: Floats, y: NDArray[np.int64], train: Flags, test: Flags, seed: int) -> dict[str, Any]:
    """One split. ``y`` is the class of every trial, ``train`` and ``test`` select trials."""
    interval = w.snapshots.interval
    fitted, seen = train[interval] & evenly(w.snapshots), test[interval]
    groups = w.items.trial[interval]
    p = np.full((len(interval), 2), np.nan)
    if x.shape[1] == 1:  # the sigmoids of an SVM on time alone say the more frequent class nearly always
        fitted = train[interval]  # all: times that are evenly spaced over a record show its length
        forest = RandomForestClassifier(TREES, random_state=seed, class_weight="balanced")
        p[seen] = forest.fit(x[fitted], y[interval[fitted]]).predict_proba(x[seen])
    else:
        spec = select({"": x[fitted]}, y[interval[fitted]], groups[fitted], GRID, seed)
        machine = fit_probabilistic(x[fitted], y[interval[fitted]], groups[fitted], ("0", "1"), spec, seed)
        p[seen] = machine.probability(x[seen])
    out: dict[str, Any] = {"every tenth of a second": _balanced(y[interval[seen]], p[seen])}
    for name, rows in moments(w, seen).items():
        out[name] = _balanced(y[interval[rows]], p[rows])
    out["calibration error of steps"] = metrics.calibration_error(p[seen], y[interval[seen]])
    raised = {int(trial): _alarmed(w, p[:, 0], interval == trial) for trial in np.flatnonzero(test)}
    out["failures alarmed"] = float(np.mean([raised[t] for t in raised if y[t] == 0]))
    out["successes alarmed"] = float(np.mean([raised[t] for t in raised if y[t] == 1]))
    return out


def moments(w: Watched, seen: Flags) -> dict[str, NDArray[np.int64]]:
    """One snapshot per trial at one second and at each part of the record."""
    chosen: dict[str, list[int]] = {"after 1 s": [], **{f"at {f:.0%}": [] for f in FRACTIONS}}
    for interval in np.unique(w.snapshots.interval[seen]):
        rows = np.flatnonzero(w.snapshots.interval == interval)
        elapsed = w.elapsed[rows]
        chosen["after 1 s"].append(int(rows[np.searchsorted(elapsed, 1.0 - 1e-9)]))
        for f in FRACTIONS:
            chosen[f"at {f:.0%}"].append(int(rows[np.searchsorted(elapsed, f * elapsed[-1] - 1e-9)]))
    return {name: np.array(rows) for name, rows in chosen.items()}


def _balanced(y_true: NDArray[np.int64], p: Floats) -> float:
    return float(np.nanmean(metrics.recall(y_true, p.argmax(1), 2)))


def _alarmed(w: Watched, p: Floats, mine: Flags) -> bool:
    """Whether a trial raises the alarm, by the level of the paper's k."""
    alarm = Alarm(LEVEL, HOLD)
    return any(alarm.update(float(a), float(t)) for a, t in zip(p[mine], w.elapsed[mine], strict=True))


def measure(w: Watched, row: str, x: Floats, repeats: int, seed: int) -> dict[str, Any]:
    """Mean and 95 % interval of every score of a row."""
    session = w.items.session
    y = (session == "B").astype(np.int64) if row == "sessions" else w.items.y
    runs = []
    for s in tqdm(repeat_seeds(seed, repeats), desc=row, file=sys.stderr, disable=None):
        for train, test in SPLITS[row](session, np.random.default_rng(s)):
            runs.append(score(w, x, y, train, test, s))
    classes = ("A", "B") if row == "sessions" else ("C", "AB")  # that count as failures and as successes
    tested = [sum(str(one) in kind for one in session) for kind in classes]
    alarms = dict(zip(("failures alarmed", "successes alarmed"), tested, strict=True))
    equal = metrics.equal_items(tested)
    return {
        name: with_interval(
            [run[name] for run in runs],
            trials=alarms.get(name, equal),
            items=equal if name.startswith(("at ", "after ")) else 0,
        )
        for name in runs[0]
    }


def streamed() -> tuple[Watched, dict[str, Flags]]:
    """All snapshots, and the columns of each choice of features; the time that has passed is the last column."""
    recordings = recorded()
    items = labelled_intervals(recordings, TaskSpec("outcome", sources=SOURCES))
    config = EncoderConfig(dt=recordings.dt)
    snapshots = regular_snapshots(items, round(1 / (RATE * config.dt)))
    spec = FeatureSpec(families=TRIAL)
    x = described(recordings, snapshots, spec, (config, preset()), "snapshots")
    family = np.array([name.split(".")[0] for name in names(spec)] + ["elapsed"])
    elapsed = ((snapshots.now - snapshots.begin) * config.dt)[:, None]
    columns = {
        "all features": family != "elapsed",
        "relative features": np.isin(family, TRIAL_RELATIVE),
        "time alone": family == "elapsed",
    }
    return Watched(items, snapshots, np.concatenate([x, elapsed], 1).astype(np.float64), config.dt), columns


def main(repeats: int = 50, seed: int = 0) -> None:
    w, columns = streamed()
    rows = {
        row: {name: measure(w, row, w.x[:, mine], repeats, seed) for name, mine in columns.items()} for row in SPLITS
    }
    result = {
        "what": "success or failure of real trials from the stream; mean recall of the classes",
        "confound": "all failures are of session C, all successes of A or B: a mixed score is also that of the session",
        "trials": {s: int((w.items.session == s).sum()) for s in "ABC"},
        "repeats": repeats,
        "rows": rows,
    }
    command = f"python -m experiments.online.abnormal_real --repeats {repeats} --seed {seed}"
    write_result("abnormal_real", command, result, seed)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
