"""The choice of the frozen method, made on the authors' simulated trials and session A alone.

Sessions B and C are not read. Every option is a list of grammars and one of families of features; the inner folds
choose among them, and ties go to the earlier. Five scores: states of the simulated trials, of session A, and from each
of these two to the other (merged), and types of the simulated failures. The option with the best mean is frozen; of
those within a thousandth of it, the one that leaves least to be chosen.

Run: python -m experiments.classification.frozen_choice (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import FAILURES, FOLDS, REAL, SIM1, published_words, recorded, rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.intervals import by_trial, of_splits
from experiments._lib.tasks import failure_types, states
from experiments.classification.grammar import ENCODERS, RANKS
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import ALL, LEVELS, RICHER
from rcbht_jax.learning import metrics
from rcbht_jax.learning.class_groups import fewest_groups
from rcbht_jax.learning.svm import Split, Weight, grouped_folds, predictions, select
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, extract_features, labelled_intervals
from rcbht_jax.types import LabelTracks

SEED = 100  # of the folds: not those of the headline
CLOSE = 0.001  # of two options whose scores differ by less, the simpler is taken
GRAMMARS = {"preset": ("W5",), "fine": ("W20 fine", "W20 finer"), "preset and fine": tuple(ENCODERS)}
FAMILIES = {
    "levels": LEVELS,
    "relative": RICHER,
    "untimed": tuple(family for family in ALL if family != "duration"),  # a duration is a confound: no option has it
}
ACROSS = {"merged states, A to SIM1": ("A", "SIM1"), "merged states, SIM1 to A": ("SIM1", "A")}
TASKS: dict[str, TaskSpec] = {
    "SIM1 states": states(sources=(SIM1,)),
    "session A states": states(sources=(REAL,), sessions=("A",)),
    "failure types": failure_types(sources=(FAILURES,)),
    **{name: states(boundaries="merged", sessions=("A", "SIM1")) for name in ACROSS},
}
REPEATS = {"SIM1 states": 2, "session A states": 2, "failure types": 1}
OPTIONS = [
    *[((g,), (f,)) for g, f in product(GRAMMARS, FAMILIES)],
    *[(("preset", "fine"), families) for families in [("levels",), ("relative",), ("levels", "relative")]],
    *[(("preset", "fine"), families) for families in [("relative", "levels"), ("untimed", "levels", "relative")]],
    *[(("preset and fine",), families) for families in [("levels", "relative"), ("relative", "levels")]],
    *[(("preset and fine",), families) for families in [("untimed", "relative"), ("untimed", "levels", "relative")]],
    (("preset", "fine", "preset and fine"), ("levels", "relative")),
]

Answer = tuple[float, NDArray[np.int64]]  # score of the inner folds, classes of the test rows


class Experiment:
    """Session A and the simulated trials, read, labelled and described once."""

    def __init__(self) -> None:
        known = recorded()
        self.recordings = known.take((known.session == "A") | np.isin(known.source, (SIM1, FAILURES)))

    @cache  # noqa: B019 (one object lives as long as the program)
    def tracks(self, encoder: str) -> LabelTracks:
        return published_words(self.recordings, *ENCODERS[encoder])

    @cache  # noqa: B019
    def items(self, task: str) -> LabelledIntervals:
        return labelled_intervals(self.recordings, TASKS[task])

    @cache  # noqa: B019
    def splits(self, task: str) -> list[Split]:
        items = self.items(task)
        if task in ACROSS:
            train, test = (np.flatnonzero(items.session == session) for session in ACROSS[task])
            return [(train, test)]
        seeds = range(SEED, SEED + REPEATS[task])
        return [split for one in seeds for split in grouped_folds(items.y, items.trial, FOLDS, one)]

    @cache  # noqa: B019
    def answers(self, task: str, grammar: str, families: str) -> list[Answer]:
        """The predictions of one candidate in every split, and its score in the inner folds."""
        items = self.items(task)
        tracks = {name: self.tracks(name) for name in GRAMMARS[grammar]}
        spec = FeatureSpec(FAMILIES[families], balance=True)
        features = extract_features(tracks, items, spec)
        x, weight = features.values.astype(np.float64), features.weights(spec)
        return [self.answer(x, weight, items, split, SEED + k) for k, split in enumerate(self.splits(task))]

    def answer(
        self, x: NDArray[np.float64], weight: Weight, items: LabelledIntervals, split: Split, seed: int
    ) -> Answer:
        train, test = split
        y, groups = items.y, items.trial[train]
        best = select({"": x[train]}, y[train], groups, RANKS, seed, {"": weight})
        folds = grouped_folds(y[train], groups, min(RANKS.inner, fewest_groups(y[train], groups)), seed)
        inner = [
            metrics.accuracy(y[train[b]], predictions(x, y, train[a], train[b], best, [best.cost], weight)[0])
            for a, b in folds
        ]
        return float(np.mean(inner)), predictions(x, y, train, test, best, [best.cost], weight)[0]

    def score(self, task: str, grammars: tuple[str, ...], families: tuple[str, ...]) -> dict[str, Any]:
        """Accuracy of an option with its interval; inner folds choose among its candidates, ties to the earlier."""
        per_candidate = [self.answers(task, g, f) for g, f in product(grammars, families)]
        right = []
        for split, answers in zip(self.splits(task), zip(*per_candidate, strict=True), strict=True):
            best = int(np.argmax([round(inner, 9) for inner, _ in answers]))
            right.append(metrics.accuracy(self.items(task).y[split[1]], answers[best][1]))
        tested = len(np.unique(np.concatenate([self.items(task).trial[test] for _, test in self.splits(task)])))
        if task in ACROSS:
            return by_trial(right[0], tested)
        return of_splits(right, 1 / (FOLDS - 1), tested, len(self.items(task).y))

    def row(self, grammars: tuple[str, ...], families: tuple[str, ...]) -> dict[str, Any]:
        scores = {task: self.score(task, grammars, families) for task in TASKS}
        return rounded({
            "mean": float(np.mean([round(score["mean"], 4) for score in scores.values()])),
            "scores": {task: score["mean"] for task, score in scores.items()},
            "intervals": {task: [score["low"], score["high"]] for task, score in scores.items()},
        })  # fmt: skip


def option_name(grammars: tuple[str, ...], families: tuple[str, ...]) -> str:
    return f"{' or '.join(grammars)} | {' or '.join(families)}"


def main(only: Only = ALL_ROWS) -> None:
    experiment = Experiment()
    about = {
        "what": "options of one method, scored on the authors' simulated trials and session A alone",
        "rule": f"best mean; within {CLOSE:g} of it the option that leaves least to be chosen",
        "families": FAMILIES,
        "grammars": GRAMMARS,
        "trials": {task: len(np.unique(experiment.items(task).trial)) for task in TASKS},
        "intervals": "95 %, corrected, over folds no narrower than Wilson's by item; from one session to another, "
        "or without a mistake, Wilson's by trial",
    }
    rows = Rows("frozen_choice", "python -m experiments.classification.frozen_choice", about, SEED)
    rows.fill({option_name(*option): partial(experiment.row, *option) for option in OPTIONS}, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
