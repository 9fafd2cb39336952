"""The choice of the one method for recordings of other laboratories, made on HIRO alone.

Run: python -m experiments.external.choice (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import BENCHMARKS, items_of, recorded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments.external import method
from rcbht_jax.features.recipes import LEVELS
from rcbht_jax.learning.tasks import LabelledIntervals

NAMES = (
    "failure types", "SIM1 states", "REAL states, A to B", "REAL states, B to A", "REAL merged states, A to B",
    "REAL merged states, B to A",
)  # fmt: skip
WORDS = {"words": method.FAMILIES, "richer words": (*LEVELS, "edges")}
COMBINATIONS = (
    ("SVM on words", "trees on wrench"),
    ("SVM on richer words", "trees on wrench"),
    ("trees on richer words", "trees on wrench"),
    ("SVM on wrench", "trees on wrench"),
    ("SVM on richer words", "SVM on wrench", "trees on wrench"),
    ("trees on wrench",),
    ("SVM on words",),
    ("SVM on richer words",),
    ("trees on richer words",),
)


class Experiment:
    """The data, read once."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.recordings = recorded()

    @cache  # noqa: B019 (one object lives as long as the program)
    def described(self, name: str) -> tuple[LabelledIntervals, dict[str, Any]]:
        items = items_of(self.recordings, BENCHMARKS[name])
        words = {key: method.describe(self.recordings, items, families) for key, families in WORDS.items()}
        return items, {key: part[0] for key, part in words.items()} | {"wrench": words["words"][1]}

    @cache  # noqa: B019
    def probability(self, name: str, member: str) -> list[Any]:
        """Of the test rows of every fold."""
        items, matrices = self.described(name)
        make = method.svm if member.startswith("SVM") else method.trees
        x = matrices[member.split(" on ")[1]]
        return [make(x, items.y, train, test, self.seed) for train, test in self.folds(name)]

    def folds(self, name: str) -> list[Any]:
        return BENCHMARKS[name].splits(self.described(name)[0], 1, self.seed)[0]

    def row(self, members: tuple[str, ...]) -> dict[str, Any]:
        scores = {}
        for name in NAMES:
            y, folds = self.described(name)[0].y, self.folds(name)
            votes = [sum(parts) for parts in zip(*(self.probability(name, part) for part in members), strict=True)]
            right = [vote.argmax(1) == y[test] for vote, (_, test) in zip(votes, folds, strict=True)]
            scores[name] = round(float(np.concatenate(right).mean()), 4)
        return {"mean": round(float(np.mean(list(scores.values()))), 4), "benchmarks": scores}


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Score every combination on six benchmarks of HIRO; by scikit-learn's probabilities the method was the best."""
    experiment = Experiment(seed)
    rows = Rows("external_choice", command_of(main, locals()), {"method": method.ABOUT}, seed)
    rows.fill({" + ".join(members): partial(experiment.row, members) for members in COMBINATIONS}, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
