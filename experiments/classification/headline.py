"""The headline: one frozen method on every benchmark, compared with simpler methods.

The method is read from ``experiments/frozen_method.json``; the result has its digest. Each benchmark has four
rows on the same folds: the method, the same without what an offset or a duration changes, the duration alone, and a
random forest on statistics of the raw wrench. Intervals are corrected for the overlap of folds or, from one session to
another and where no mistake was made, Wilson's by trial; then the result also says how large a share of trials with a
mistake none in so many allows (rule of three). Success and failure are scored by mean recall.

Run: python -m experiments.classification.headline --repeats 3 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import tyro

from experiments._lib import frozen
from experiments._lib import raw_learners as raw
from experiments._lib.arrays import Ints
from experiments._lib.benchmarks import CONFOUNDS, Benchmark, recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import by_trial, of_folds
from experiments.classification.grammar import BATCHES, WITH_BATCHES, by_batch, fewer_repeats, items_between
from experiments.classification.probes import held_out
from rcbht_jax.learning import validation
from rcbht_jax.learning.metrics import rule_of_three
from rcbht_jax.learning.svm import Split
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec

OUTCOME, HELD_OUT = "REAL success or failure", "REAL success or failure, session held out"
FOLDED = ("REAL states", "SIM1 states", OUTCOME, HELD_OUT, "failure types")
ACROSS = tuple(f"REAL {kind}states, {way}" for kind in ("merged ", "") for way in ("A to B", "B to A"))
NAMES = (*FOLDED[:4], *ACROSS, FOLDED[4], *BATCHES)
METHOD, RELATIVE, DURATION, PEER = "frozen", "frozen, relative", "duration alone", "statistics + random forest"
ROWS = (METHOD, RELATIVE, DURATION, PEER)
SESSIONS = ("A", "B")  # of the real successes
ASKED = {
    **WITH_BATCHES,
    **dict.fromkeys((OUTCOME, HELD_OUT), Benchmark(TaskSpec("outcome", sessions=("A", "B", "C"), outcomes=()))),
}


class Experiment:
    """The data, read, labelled and described once."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed
        self.method = frozen.load()
        self.recordings = by_batch(recorded())

    @cache  # noqa: B019 (one object lives as long as the program)
    def grammars(self) -> frozen.Grammars:
        return self.method.grammars(self.recordings)

    @cache  # noqa: B019
    def items(self, name: str) -> LabelledIntervals:
        return items_between(self.recordings, name, ASKED[name])

    def splits(self, name: str) -> list[list[Split]]:
        """``[repeat][fold]``; one split from one session or batch to another."""
        items = self.items(name)
        if name == HELD_OUT:
            return [held_out(items, SESSIONS, one) for one in validation.repeat_seeds(self.seed, self.repeats)]
        return ASKED[name].splits(items, fewer_repeats(name, self.repeats), self.seed)

    def learner(self, name: str, row: str) -> validation.Estimator:
        items = self.items(name)
        if row == DURATION:
            return validation.forest(items.seconds, items.y)
        if row == PEER:
            return raw.forest(raw.statistics(segments(self.recordings, items)), items.y)
        return self.method.learner(self.grammars(), items, relative=row == RELATIVE)

    def row(self, name: str, row: str) -> dict[str, Any]:
        items, splits = self.items(name), self.splits(name)
        wrong: set[str] = set()
        learner = noting(self.learner(name, row), items, wrong)
        score = scored(learner, items, splits, name, self.seed)
        tested = len(np.unique(items.trial[np.concatenate([test for _, test in splits[0]])]))
        made = {"trials tested": tested, "trials with a mistake": len(wrong)}
        allows = {} if wrong else {"trials with a mistake, at most": round(rule_of_three(tested), 4)}
        return rounded(score) | made | allows | {"method": self.method.sha256 if row in ROWS[:2] else ""}

    def about(self) -> dict[str, Any]:
        facts = {
            name: {
                "classes": list(self.items(name).classes),
                "items": len(self.items(name).y),
                "trials": len(np.unique(self.items(name).trial)),
                "score": measure_of(name),
                "confounds": CONFOUNDS[ASKED[name].task.task],
                "repeats": len(self.splits(name)),
            }
            for name in NAMES
        }
        return {
            "what": "the frozen method on every benchmark, and what a simpler thing reaches on the same folds",
            "sha256 of the method": self.method.sha256,
            "repeats": self.repeats,
            "benchmarks": facts,
        }


def measure_of(name: str) -> str:
    """Mean recall for success and failure, whose numbers differ."""
    return "balanced_accuracy" if ASKED[name].task.task == "outcome" else "accuracy"


def noting(learner: validation.Estimator, items: LabelledIntervals, wrong: set[str]) -> validation.Estimator:
    """The same learner, which also records the trials with a misclassified item."""

    def learn(train: Ints, test: Ints, seed: int) -> validation.Prediction:
        predicted, choice = learner(train, test, seed)
        wrong.update(items.trial[test][predicted != items.y[test]].tolist())
        return predicted, choice

    return learn


def scored(
    learner: validation.Estimator, items: LabelledIntervals, splits: list[list[Split]], name: str, seed: int
) -> dict[str, Any]:
    """The score with an interval that has a width."""
    measure = measure_of(name)
    if len(splits[0]) == 1:
        result = validation.holdout_score(learner, items.y, items.trial, splits[0][0], seed)
        tested = len(np.unique(items.trial[splits[0][0][1]]))
        return {"score": by_trial(getattr(result, measure), tested), "chosen": [_chosen(result.chosen)]}
    run = validation.cross_validate(learner, items.y, splits, seed)
    chosen = [_chosen(choice) for repeat in run.chosen for choice in repeat]
    counts = {text: chosen.count(text) for text in sorted(set(chosen))}
    return {"score": of_folds(run, len(np.unique(items.trial)))[measure], "chosen": counts}


def _chosen(choice: dict[str, Any]) -> str:
    return f"{choice['features']}: {choice['kernel']} C={choice['cost']:g}" if choice else ""


def main(repeats: int = 3, seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(repeats, seed)
    wanted = {f"{name} | {row}": partial(experiment.row, name, row) for name in NAMES for row in ROWS}
    Rows("headline", command_of(main, locals()), experiment.about(), seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
