"""Will it seat? A belief in the outcome, compared with one in any deviation, by kind of fault.

A monitor of deviations also raises the alarm in trials that seat. Here a classifier learns the outcome, from the first
seconds of the record, the same number in all trials (see ``experiments.online.seat_trials``): its features contain
neither a duration nor the length of the record. As a command:
``rcbht train-online STORE --task outcome --families course edges offset --ranks --first-seconds SECONDS``.

It trains on four moments of each training trial, and is scored at the last of them, at least about one second before
the planned end of the trial, and at the earlier ones; "by moment" has a classifier for each, which was better on trials
of seed 5, but was tried only after the first had been scored on the others. Within a session: five folds of trials,
repeated. From one session to the other: all trials of one train. "Own nominal" subtracts the median feature of a half
of the tested session's nominal trials and divides by their deviation, as one would after some trials known to be good;
these are not tested.

Scores are areas under the ROC curve of failed against seated trials of each kind. Intervals are Wilson's for as many
trials as the rarer outcome has, which is wide, and never zero. Families, ranks and cost were chosen on trials of seed 5
(60 of each kind); those of seed 9, with hooks that catch in place of blocks, were drawn afterwards.

Baselines: a forest on the wrench of the last tenth of a second, one on when the controller's sub-tasks began, one on
the same features as the method; and the same method trained to separate faulty from nominal trials, scored by the
outcome. The time that has passed, and the length of the record, are the same in all trials, and carry no information.

Run: python -m experiments.online.will_it_seat --folder seat --per-kind 80 --repeats 2 --seed 9
Simulated trials, features and finished rows are kept; run it again to go on where it was interrupted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import roc_auc_score

from experiments._lib.arrays import Flags, Floats, Ints
from experiments._lib.benchmarks import FOLDS
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import of_auc
from experiments._lib.simulated import kept_arrays
from experiments.online.fault_trials import Trials
from experiments.online.seat_trials import APART, KINDS, LENGTH, SESSIONS, SEVERITIES, seat_trials
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset as thresholds
from rcbht_jax.features import FeatureSpec, Intervals, interval_features
from rcbht_jax.introspection.fault_monitor import NOMINAL
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.learning.probability import fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec, grouped_folds
from rcbht_jax.robots.snap_assembly import RECORDED

BEFORE = (8.0, 4.0, 2.0, 0.0)  # s before the end of the used part
FAMILIES = ("course", "edges", "offset")
MACHINE = SvmSpec("rbf", 10.0, scaling=True, balanced=True, floor=0.1, ranks=True)
LAST = 0.1  # s of wrench that a baseline uses
TREES = 200
FAILED = 1  # class
TARGETS = {"area of each kind, within a session": 0.95, "area of each kind, from session to session": 0.90}
NOT_YET = 1e3  # s, in place of the beginning of a sub-task that has not begun
EVERY = "every kind of fault"


@dataclass(frozen=True)
class Seen:
    """The data of each trial at each moment."""

    trials: Trials
    x: Floats  # [moment, trial, feature]
    wrench: Floats  # [moment, trial, number] of the last tenth of a second
    began: Floats  # [moment, trial, sub-task] s, when the controller's sub-tasks began

    @property
    def y(self) -> Ints:
        """1 = failed ``[trial]``."""
        return self.trials.failed.astype(np.int64)


Matrix = Callable[[Seen], Floats]  # [moment, trial, column]
# Training data [moment, trial, column], class of each trial, data of the tested ones [moment, trial, column], seed ->
# score of failure [moment, trial].
Learner = Callable[[Floats, Ints, Floats, int], Floats]


def seen(folder: Path, session: str, per_kind: int, seed: int) -> Seen:
    """Simulate, and describe; features are kept in the folder."""
    trials = seat_trials(folder, session, per_kind, seed)
    data = trials.recordings
    ends = [round((LENGTH[session] - before) / data.dt) for before in BEFORE]
    x = kept_arrays(
        folder / f"seat-{session}-{per_kind}-{seed}-looks.npz",
        lambda: {"x": np.stack([described(data.wrench[:, :end], data.dt) for end in ends])},
    )["x"]
    began = np.nan_to_num(data.starts(RECORDED)[:, 1:], nan=NOT_YET)
    return Seen(
        trials,
        x.astype(np.float64),
        np.stack([last_of(data.wrench[:, :end], data.dt) for end in ends]),
        np.stack([np.where(began < end * data.dt, began, NOT_YET) for end in ends]),
    )


def described(wrench: NDArray[np.float32], dt: float) -> NDArray[np.float32]:
    """Features of records of one length, as a stream has them after as many samples."""
    length = np.full(len(wrench), wrench.shape[1], np.int32)
    tracks = encode_batch(EncoderConfig(dt=dt), thresholds(), np.ascontiguousarray(wrench), length)
    spans = Intervals(np.arange(len(wrench)), np.zeros(len(wrench), np.int64), length.astype(np.int64), dt)
    return interval_features(tracks, spans, FeatureSpec(families=FAMILIES)).values


def last_of(wrench: NDArray[np.float32], dt: float) -> Floats:
    """Mean, deviation and last value of the last tenth of a second ``[trial, 18]``."""
    part = wrench[:, -round(LAST / dt) :].astype(np.float64)
    return np.concatenate([part.mean(1), part.std(1), part[:, -1]], 1)


def svm(train: Floats, y: Ints, test: Floats, seed: int) -> Floats:
    """The method: an SVM with probabilities, of all moments at once."""
    moments, trials, columns = train.shape
    rows, classes = train.reshape(-1, columns), np.tile(y, moments)
    groups = np.tile(np.arange(trials), moments)
    machine = fit_probabilistic(rows, classes, groups, ("seated", "failed"), MACHINE, seed)
    return machine.probability(test.reshape(-1, columns))[:, FAILED].reshape(test.shape[:2])


def svm_by_moment(train: Floats, y: Ints, test: Floats, seed: int) -> Floats:
    """An SVM for each moment."""
    return np.concatenate([svm(a[None], y, b[None], seed) for a, b in zip(train, test, strict=True)])


def forest(train: Floats, y: Ints, test: Floats, seed: int) -> Floats:
    """A random forest for each moment."""
    out = []
    for a, b in zip(train, test, strict=True):
        trees = RandomForestClassifier(TREES, class_weight="balanced", random_state=seed).fit(a, y)
        out.append(trees.predict_proba(b)[:, FAILED])
    return np.stack(out)


METHODS: dict[str, tuple[Matrix, Learner]] = {
    "belief in the outcome": (lambda s: s.x, svm),
    "belief in a deviation": (lambda s: s.x, svm),
    "belief in the outcome, by moment": (lambda s: s.x, svm_by_moment),
    "same features, forest": (lambda s: s.x, forest),
    "last 0.1 s of wrench, forest": (lambda s: s.wrench, forest),
    "when sub-tasks began, forest": (lambda s: s.began, forest),
}
OUTCOME, DEVIATION = list(METHODS)[:2]
WITHIN, ACROSS = SESSIONS, (SESSIONS, SESSIONS[::-1])


def targets(s: Seen, name: str) -> Ints:
    """Class of each trial ``[trial]`` that a method is trained to predict."""
    return (s.trials.kind != NOMINAL).astype(np.int64) if name == DEVIATION else s.y


def area(p: Floats, y: Ints) -> dict[str, Any] | None:
    """Area under the ROC curve with its interval; None where one outcome is missing."""
    counts = np.bincount(y, minlength=2).tolist()
    if not all(counts):
        return None
    mean = float(roc_auc_score(y, p))
    low, high = of_auc(mean, counts)
    return {"mean": round(mean, 4), "low": round(low, 4), "high": round(high, 4)}


def share(right: Flags, of: Flags) -> dict[str, Any] | None:
    """The share of some trials that are right, with Wilson's interval."""
    good, trials = int((right & of).sum()), int(of.sum())
    if not trials:
        return None
    low, high = wilson(good, trials)
    return {"mean": round(good / trials, 4), "low": round(low, 4), "high": round(high, 4), "trials": trials}


def scores(s: Seen, p: Floats, tested: Flags) -> dict[str, Any]:
    """Scores of beliefs in failure ``[moment, trial]``: areas by kind and moment; decisions at the last one."""
    kind, y, last = s.trials.kind, s.y, p[-1]
    faulty = np.isin(kind, KINDS) & tested
    groups = {EVERY: faulty} | {name: faulty & (kind == name) for name in KINDS}
    out: dict[str, Any] = {"area": {name: area(last[rows], y[rows]) for name, rows in groups.items()}}
    out["area, s earlier"] = {
        f"{before:g}": (area(q[faulty], y[faulty]) or {}).get("mean") for before, q in zip(BEFORE, p, strict=True)
    }
    believed = last > 0.5
    out["said at 0.5"] = {
        name: {
            "sensitivity": share(believed, rows & (y == 1)),
            "specificity": share(~believed, rows & (y == 0)),
            "precision": share(y == 1, rows & believed),
        }
        for name, rows in (groups | {NOMINAL: tested & (kind == NOMINAL), APART: tested & (kind == APART)}).items()
    }
    return out


def within(get: Callable[[str], Seen], session: str, name: str, repeats: int, seed: int) -> dict[str, Any]:
    """A session's own trials, in folds; beliefs are averaged over the repeats."""
    s = get(session)
    matrix, learner = METHODS[name]
    x, y, groups = matrix(s), targets(s, name), np.arange(len(s.y))
    p = np.zeros((len(BEFORE), len(y)))
    cells = np.unique(np.char.add(s.trials.kind, s.y.astype(str)), return_inverse=True)[1]
    if np.bincount(cells).min() < FOLDS:  # of a short run
        cells = s.y
    for one in range(seed, seed + repeats):
        for train, test in grouped_folds(cells, groups, FOLDS, one):
            p[:, test] += learner(x[:, train], y[train], x[:, test], one) / repeats
    return scores(s, p, np.ones(len(y), bool))


def across(get: Callable[[str], Seen], ways: tuple[str, str], name: str, own: bool, seed: int) -> dict[str, Any]:
    """All trials of one session train, those of the other are tested."""
    a, b = (get(session) for session in ways)
    matrix, learner = METHODS[name]
    first, second, tested = matrix(a), matrix(b), np.ones(len(b.y), bool)
    if own:
        first, _ = nominal_scaled(first, a.trials.kind, seed)
        second, tested = nominal_scaled(second, b.trials.kind, seed)
    return scores(b, learner(first, targets(a, name), second, seed), tested)


def nominal_scaled(x: Floats, kind: NDArray[np.str_], seed: int) -> tuple[Floats, Flags]:
    """Deviations from a half of the nominal trials, in units of theirs, and which trials are left to be tested."""
    nominal = np.random.default_rng(seed).permutation(np.flatnonzero(kind == NOMINAL))
    half = nominal[: len(nominal) // 2]
    middle, spread = np.median(x[:, half], 1, keepdims=True), x[:, half].std(1, keepdims=True)
    least = 1e-3 * x.std(1, keepdims=True) + 1e-9
    return (x - middle) / (spread + least), ~np.isin(np.arange(len(kind)), half)


def shares(get: Callable[[str], Seen], session: str) -> dict[str, Any]:
    """How many trials of each kind failed, and facts about them."""
    s = get(session)
    touched = np.isfinite(s.trials.recordings.starts(RECORDED)[:, 1])
    return {
        name: {
            "trials": int(rows.sum()), "failed": int((rows & s.trials.failed).sum()),
            "approach never ended": int((rows & ~touched).sum()),
            "s from what is seen to the planned end, least and median": [
                round(float(value), 2) for value in np.quantile(s.trials.end[rows] - LENGTH[session], [0, 0.5])
            ],
        }
        for name in (NOMINAL, *KINDS, APART) for rows in [s.trials.kind == name]
    }  # fmt: skip


def main(folder: Path, per_kind: int = 80, repeats: int = 2, seed: int = 9, only: Only = ALL_ROWS) -> None:
    get = cache(partial(seen, folder, per_kind=per_kind, seed=seed))
    about = {
        "what": "failures of simulated trials foretold before the planned end; areas under the ROC curve by fault",
        "targets": TARGETS,
        "seconds of each record that are seen": LENGTH,
        "severities": {session: {kind: dict(r) for kind, r in kinds.items()} for session, kinds in SEVERITIES.items()},
        "features": FAMILIES,
        "machine": f"{MACHINE.kernel} kernel, C = {MACHINE.cost:g}, ranks",
        "folds": FOLDS,
        "repeats": repeats,
        "trials of each kind": per_kind,
    }
    wanted: dict[str, Callable[[], Any]] = {f"{s} | trials": partial(shares, get, s) for s in WITHIN}
    for name in METHODS:
        wanted |= {f"{s} | {name}": partial(within, get, s, name, repeats, seed) for s in WITHIN}
    for name in METHODS:
        for a, b in ACROSS:
            wanted[f"{a} to {b} | {name}"] = partial(across, get, (a, b), name, False, seed)
    for a, b in ACROSS:
        wanted[f"{a} to {b} | {OUTCOME}, own nominal"] = partial(across, get, (a, b), OUTCOME, True, seed)
    Rows("will_it_seat", command_of(main, locals(), "--folder FOLDER"), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
