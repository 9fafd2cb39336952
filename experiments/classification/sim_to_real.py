"""Trained on simulated trials only, tested on recorded ones: states, per session, and the effect of each choice.

Of the recorded trials only the mean of their first second, in free space, is used: it is subtracted (tare). Kernel,
cost and feature families are selected on simulated trials: by holding out one preset at a time or, with a single
training set, by grouped folds inside it. Thresholds are the authors' or calibrated on simulated trials.

Controllers, placement, stand and sensor are those of the recorded sessions. The parts of A, B and C are one set of
hooks that catch, fitted to recorded trials of A and to half of B's together; the OpenHRP preset has parts of its own,
and A's sensor. A row that leaves a session out of training leaves out its controller, stand and sensor, but the parts
were fitted to its trials too. In ``experiments.classification.zero_shot`` nothing was fitted to recorded trials.

Run: python -m experiments.classification.sim_to_real FOLDER [--only TEXT ...]
FOLDER holds the sets of ``experiments.classification.sim_to_real_sets``; missing ones are made.
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib import raw_learners
from experiments._lib.arrays import Ints
from experiments._lib.benchmarks import mistakes, recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.fit_words import learned_tolerance
from experiments._lib.tasks import states
from experiments._lib.thresholds import trained_thresholds
from experiments._lib.zero_shot_set import TARE_SECONDS
from experiments.classification.sim_to_real_rows import CANDIDATES, ROWS, Row
from experiments.classification.sim_to_real_sets import PRESETS, SETS, Labelling, Sets
from experiments.classification.sim_to_real_sets import SEED as SEED_OF_SETS
from rcbht_jax.calibration import contextual
from rcbht_jax.calibration.dataset import calibration_data
from rcbht_jax.calibration.objective import Objective
from rcbht_jax.calibration.search import SearchOptions, search
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.learning import metrics
from rcbht_jax.learning.svm import Grid, SvmSpec, predictions, select
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.types import Recordings

SEED = 0
BOUNDARIES = ("merged", "harmonised")
REAL = ("A", "B")
GRID = Grid(kernels=("linear", "rbf"), costs=(0.1, 1.0, 10.0, 100.0), scalings=(True,), floor=0.05)
SELECTING = 48  # trials of each training set that choose kernel, cost and features
SEARCHING, SEARCHED = 24, 512  # trials of each training set, and candidates, of a search for thresholds


@dataclass(frozen=True)
class Pool:
    """Sentences of several sets, one after the other."""

    x: dict[str, NDArray[np.float64]]  # candidate -> [item, feature]
    y: Ints  # [item]
    trial: NDArray[np.str_]  # [item]
    place: NDArray[np.str_]  # [item] name of the set
    classes: tuple[str, ...]

    def rows(self, names: tuple[str, ...]) -> Ints:
        return np.flatnonzero(np.isin(self.place, names))

    def take(self, rows: Ints) -> Pool:
        x = {name: matrix[rows] for name, matrix in self.x.items()}
        return Pool(x, self.y[rows], self.trial[rows], self.place[rows], self.classes)


class Experiment:
    """The sets, and the functions that make each row."""

    def __init__(self, folder: Path, seed: int = SEED_OF_SETS) -> None:
        self.sets = Sets(folder, recorded(), seed)

    def row(self, spec: Row) -> Callable[[], Any]:
        return lambda: {"train": list(spec.train)} | {b: self.measure(spec, b) for b in BOUNDARIES}

    @cache  # noqa: B019 (one object lives as long as the program)
    def measure(self, spec: Row, boundaries: str) -> dict[str, Any]:
        """Accuracy on every test set, of a learner trained on the training sets only."""
        how = Labelling(spec.window, spec.tare, self.limits(spec), self.tolerances(spec), spec.weighing)
        pool = self.pool(spec, how, boundaries)
        train = pool.rows(spec.train)
        train = train[np.isin(pool.trial[train], some_trials(pool, train, spec.trials, spec.draw))]
        test = pool.rows(spec.test)
        predicted, chosen = self.answers(spec, pool, train, test)
        out: dict[str, Any] = {"trials": len(np.unique(pool.trial[train])), "chosen": chosen}
        for names in [(name,) for name in spec.test] + [REAL] * (set(spec.test) >= set(REAL)):
            inside = np.isin(pool.place[test], names)
            out["+".join(names)] = scored(pool, test[inside], predicted[inside])
        return rounded(out)

    def pool(self, spec: Row, how: Labelling, boundaries: str) -> Pool:
        names = tuple(dict.fromkeys((*spec.train, *spec.test)))
        items = [self.sets.items(name, boundaries) for name in names]
        makers = {
            "duration": lambda: {"": np.concatenate([one.seconds for one in items])},
            "statistics": lambda: {"": np.concatenate([self.statistics(name, boundaries) for name in names])},
            "words": lambda: self.words(spec, names, how, boundaries),
        }
        return Pool(
            x=makers[spec.learner](),
            y=np.concatenate([one.y for one in items]),
            trial=np.concatenate([np.char.add(f"{name} ", one.trial) for name, one in zip(names, items, strict=True)]),
            place=np.repeat(names, [len(one.y) for one in items]),
            classes=items[0].classes,
        )

    def words(
        self, spec: Row, names: tuple[str, ...], how: Labelling, boundaries: str
    ) -> dict[str, NDArray[np.float64]]:
        features = [self.sets.features(name, how, boundaries) for name in names]
        whole = np.concatenate([one.values for one in features]).astype(np.float64)
        family = np.array(features[0].families)
        return {name: whole[:, np.isin(family, CANDIDATES[name])] for name in spec.candidates}

    def statistics(self, name: str, boundaries: str) -> NDArray[np.float64]:
        return raw_learners.statistics(segments(self.sets.recordings(name, True), self.sets.items(name, boundaries)))

    def answers(self, spec: Row, pool: Pool, train: Ints, test: Ints) -> tuple[Ints, dict[str, Any]]:
        """Class index of every test item, and what was chosen on the training items."""
        if spec.learner != "words":
            return raw_learners.forest(pool.x[""], pool.y)(train, test, SEED)[0], {}
        few = train[np.isin(pool.trial[train], some_trials(pool, train, SELECTING, spec.draw))]
        best, score = choose(pool.take(few))
        both = pool.take(np.concatenate([train, test]))
        learn, rest = np.split(np.arange(len(both.y)), [len(train)])
        predicted = predictions(both.x[best.features], both.y, learn, rest, best, [best.cost])[0]
        chosen = {"features": best.features, "kernel": best.kernel, "cost": best.cost, "simulated": score}
        return predicted, chosen

    @cache  # noqa: B019
    def limits(self, spec: Row) -> tuple[tuple[float, ...], ...] | None:
        """Thresholds chosen on the training sets; None = the preset's."""
        if spec.thresholds == "preset":
            return None
        trials, items = self.training(spec)
        config = EncoderConfig(spec.window, trials.dt)
        if spec.thresholds.startswith("context"):
            copy = contextual.AUTHORS_COPY if spec.thresholds == "context" else contextual.OWN
            rows = np.unique(items.intervals[0].recording)
            selected = contextual.calibrate(trials, rows, config, copy=copy).thresholds
        elif spec.thresholds == "gradient":
            selected = trained_thresholds(calibration_data(trials, items, config), config)
        else:
            options = SearchOptions(objective=Objective(), candidates=SEARCHED, seed=SEED)
            selected = search(calibration_data(trials, items, config), config, options).thresholds
        return tuple(tuple(row) for row in np.asarray(selected.limits).tolist())

    @cache  # noqa: B019
    def tolerances(self, spec: Row) -> tuple[tuple[float, ...], ...]:
        """Tolerances of the fit rule, from training trials without their labels; none for the paper's rule."""
        if spec.rule == "paper":
            return ()
        learned = learned_tolerance(self.training(spec)[0])
        return tuple(tuple((factor * learned).tolist()) for factor in spec.factors)

    def training(self, spec: Row) -> tuple[Recordings, LabelledIntervals]:
        """A few trials of each training set as one set, and their states."""
        parts = []
        for name in spec.train:
            trials, items = self.sets.recordings(name, spec.tare), self.sets.items(name, "harmonised")
            rows = np.unique(items.intervals[0].recording)
            few = np.random.default_rng(SEED).permutation(rows)[:SEARCHING]
            parts.append(trials.take(np.sort(few)))
        together = Recordings.join(parts)
        return together, labelled_intervals(together, states(outcomes=()))


def some_trials(pool: Pool, rows: Ints, most: int, draw: int) -> NDArray[np.str_]:
    """At most so many trials of each set that ``rows`` name, drawn at random; a larger number holds the smaller's."""
    chosen = []
    for place in np.unique(pool.place[rows]):
        trials = np.unique(pool.trial[rows[pool.place[rows] == place]])
        chosen.append(np.random.default_rng((SEED, draw)).permutation(trials)[:most])
    return np.concatenate(chosen)


def choose(pool: Pool) -> tuple[SvmSpec, float | None]:
    """The grid's best choice for sets that are not trained on, and its mean accuracy there.

    With a single set, by grouped folds inside it; its score does not hold for other sets and is not given.
    """
    places = np.unique(pool.place)
    if len(places) == 1:
        return select(pool.x, pool.y, pool.trial, GRID, SEED), None
    paths = GRID.paths(list(pool.x))
    scores = np.zeros((len(paths), len(GRID.costs)))
    for place in places:
        held, rest = (np.flatnonzero(side) for side in (pool.place == place, pool.place != place))
        for path, spec in zip(scores, paths, strict=True):
            predicted = predictions(pool.x[spec.features], pool.y, rest, held, spec, GRID.costs)
            path += [metrics.accuracy(pool.y[held], one) / len(places) for one in predicted]
    best = int(scores.round(9).argmax())
    selected = replace(paths[best // len(GRID.costs)], cost=GRID.costs[best % len(GRID.costs)])
    return selected, float(scores.max())


def scored(pool: Pool, test: Ints, predicted: Ints) -> dict[str, Any]:
    """Accuracy with Wilson's interval, each trial counting once, and the confusion of classes."""
    right, count = float(np.mean(pool.y[test] == predicted)), len(np.unique(pool.trial[test]))
    wrong = mistakes(pool.classes, pool.y[test], predicted)
    return {"accuracy": right, "interval": list(metrics.wilson(right * count, count)), "trials": count, "wrong": wrong}


def about(experiment: Experiment) -> dict[str, Any]:
    return {
        "what": "states of recorded trials by learners that saw simulated trials only",
        "used of a recorded trial": f"the mean of its first {TARE_SECONDS:g} s, which is subtracted",
        "presets": "controllers, placement, stand and sensor are the sessions'; A, B and C have the same hooks, "
        "fitted to trials of A and half of B's; the OpenHRP preset has parts of its own and wears A's sensor",
        "simulated by": PRESETS,
        "chance": {"merged": round(1 / 3, 4), "harmonised": 0.25},
        "sets": {name: asdict(one) | {"seed": SEED_OF_SETS} for name, one in SETS.items()},
        "candidates": {name: list(families) for name, families in CANDIDATES.items()},
        "grid": {"kernels": GRID.kernels, "costs": GRID.costs, "scaled": True, "least deviation": GRID.floor},
        "trials of each set that select": SELECTING,
    }


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    experiment = Experiment(folder)
    rows = Rows("sim_to_real", "python -m experiments.classification.sim_to_real FOLDER", about(experiment), SEED)
    rows.fill({name: experiment.row(spec) for name, spec in ROWS.items()}, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
