"""Confounds of success, failure and session: accuracy of duration, the first sample and the first second alone.

The real successes were recorded in two sessions (A, B), the real failures in a third (C). If probes that separate
failure from success also separate the two sessions of successes, their score is no evidence of failure recognition. The
control: train on one session of successes and half of the failures, test on the other session and the other half, both
ways round; a score above one half is then not due to the session of the successes.

Run: python -m experiments.classification.probes --repeats 10 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import FOLDS, published_words, recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import of_folds
from experiments.classification.peers import PEERS, PROBES
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid, Split
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, extract_features, labelled_intervals
from rcbht_jax.types import LabelTracks

GRID = Grid(kernels=("linear", "rbf"), costs=(0.01, 0.1, 1.0, 10.0, 100.0), scalings=(True,), balanced=True)
WORDS = "words + SVM, without duration and offset"
VIEWS = (
    "majority", "duration alone", "first sample alone", "first second alone", "statistics + random forest", WORDS,
)  # fmt: skip


@dataclass(frozen=True)
class Question:
    """Two groups of sessions to be classified, by whole records."""

    classes: tuple[tuple[str, ...], tuple[str, ...]]
    hold_out: bool = False  # train on one session of the second group, test on the other

    @property
    def sessions(self) -> tuple[str, ...]:
        return self.classes[0] + self.classes[1]


QUESTIONS = {
    "REAL failure (C) or success (A, B)": Question((("C",), ("A", "B"))),
    "REAL success A or success B": Question((("A",), ("B",))),
    "REAL failure (C) or success A": Question((("C",), ("A",))),
    "REAL failure (C) or success B": Question((("C",), ("B",))),
    "REAL failure or success, success session held out": Question((("C",), ("A", "B")), hold_out=True),
    "SIM failure or success": Question((("SIM1F",), ("SIM1",))),
}


class Experiment:
    """The data, read and labelled once."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed, self.recordings = repeats, seed, recorded()

    @cache  # noqa: B019 (one object lives as long as the program)
    def tracks(self) -> LabelTracks:
        return published_words(self.recordings)

    @cache  # noqa: B019
    def items(self, question: str) -> LabelledIntervals:
        """Whole records; the class is the group of the session."""
        asked = QUESTIONS[question]
        session = self.recordings.session
        outcome = np.where(np.isin(session, asked.classes[0]), "failure", "success")
        spec = TaskSpec("outcome", sessions=asked.sessions, outcomes=())
        result = labelled_intervals(replace(self.recordings, outcome=outcome), spec)
        names = tuple(" ".join(group) for group in asked.classes)
        return replace(result, classes=names)

    def learner(self, question: str, view: str) -> validation.Estimator:
        items = self.items(question)
        if view == WORDS:
            x = extract_features(self.tracks(), items, FeatureSpec()).values
            return validation.nested_svm({"": x}, items.y, items.trial, GRID)
        return (PROBES | PEERS)[view](segments(self.recordings, items), items)

    def row(self, question: str, view: str) -> dict[str, Any]:
        items = self.items(question)
        splits = self.splits(question)
        result = validation.cross_validate(self.learner(question, view), items.y, splits, self.seed)
        counts = dict(zip(items.classes, np.bincount(items.y).tolist(), strict=True))
        scores = of_folds(result, len(np.unique(items.trial)))
        return {"trials": counts, **rounded(validation.without_intervals(scores) if view == "majority" else scores)}

    def splits(self, question: str) -> list[list[Split]]:
        items, asked = self.items(question), QUESTIONS[question]
        if not asked.hold_out:
            return validation.repeated_folds(items.y, items.trial, FOLDS, self.repeats, self.seed)
        return [held_out(items, asked.classes[1], one) for one in validation.repeat_seeds(self.seed, self.repeats)]


def held_out(items: LabelledIntervals, sessions: tuple[str, ...], seed: int) -> list[Split]:
    """Two folds: each holds one session of successes and a random half of the failures."""
    failures = np.random.default_rng(seed).permutation(np.flatnonzero(items.y == 0))
    first = failures[: len(failures) // 2]
    in_first = np.isin(np.arange(len(items.y)), first) | (items.session == sessions[0])
    sides: tuple[NDArray[np.int64], NDArray[np.int64]] = (np.flatnonzero(in_first), np.flatnonzero(~in_first))
    return [sides, (sides[1], sides[0])]


def main(repeats: int = 10, seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(repeats, seed)
    about = {
        "what": "balanced accuracy of what cannot know whether the assembly failed, beside statistics and words",
        "folds": f"{FOLDS}, grouped by trial; where a success session is held out: 2, by session",
        "repeats": repeats,
    }
    wanted = {f"{name} | {view}": partial(experiment.row, name, view) for name in QUESTIONS for view in VIEWS}
    Rows("probes", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
