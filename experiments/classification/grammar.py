"""Accuracy of several feature sets of words: the paper's sentences, plain words and richer words, on the same folds.

All tasks use the same families and encoders. A grammar is one encoder, or several with different windows and threshold
scales whose features are concatenated; where there are several grammars, the inner folds select one, ties go to the
fewer columns. Richer words are independent of duration and of a constant added to the wrench; levels are not. The
"tared" row subtracts the mean wrench of the trial's first second. The batches of the simulated failures differ in how
the record begins: at rest, or with the arm's weight already on the sensor.

Run: python -m experiments.classification.grammar --repeats 5 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import BENCHMARKS, FAILURES, Benchmark, items_of, published_words, recorded, svm_on
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.tasks import failure_types
from experiments._lib.zero_shot_set import TARE_SECONDS
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.features.recipes import ALL, LEVELS, PLAIN, RICHER
from rcbht_jax.io.tare import tare
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import COSTS, KERNELS, Grid
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.types import LabelTracks, Recordings

# Window in samples and factor on the preset's thresholds.
ENCODERS = {"W5": (5, 1.0), "W20 fine": (20, 1 / 16), "W20 finer": (20, 1 / 256)}
GRAMMARS = {"preset": ("W5",), "fine": ("W20 fine", "W20 finer")}

DEVIATION = Grid(kernels=("linear", "rbf"), costs=(0.01, 0.1, 1.0, 10.0, 100.0), scalings=(True,))
RANKS = replace(DEVIATION, ranks=True)
PAPER = Grid(kernels=KERNELS, costs=COSTS, scalings=(False,))


@dataclass(frozen=True)
class Method:
    """The features of one row; the inner folds choose the grammar."""

    families: tuple[str, ...]
    grammars: tuple[str, ...] = ("preset",)
    grid: Grid = RANKS
    tare: bool = False

    @property
    def spec(self) -> FeatureSpec:
        """Features of level and of movement weigh the same in all rows that have both."""
        return FeatureSpec(families=self.families, balance=True)


METHODS = {
    "the paper's sentences": Method(("sentence",), grid=PAPER),
    "plain words": Method(PLAIN, grid=DEVIATION),
    "plain words, ranks": Method(PLAIN),
    "plain words, ranks, choice of grammar": Method(PLAIN, tuple(GRAMMARS)),
    "richer words, mean and deviation": Method(RICHER, grid=DEVIATION),
    "richer words": Method(RICHER),
    "richer words, choice of grammar": Method(RICHER, tuple(GRAMMARS)),
    "levels alone": Method(("levels",)),
    "richer words and levels": Method(LEVELS),
    "richer words and levels, choice of grammar": Method(LEVELS, tuple(GRAMMARS)),
    "richer words and levels, tared": Method(LEVELS, tare=True),
    "all families": Method(ALL),
}
AT_REST, LOADED = "begins at rest", "begins loaded"
BATCHES = {
    "failure types, other batch (at rest to loaded)": (AT_REST, LOADED),
    "failure types, other batch (loaded to at rest)": (LOADED, AT_REST),
}
WITH_BATCHES = BENCHMARKS | {
    name: Benchmark(failure_types(sources=(FAILURES,)), (train,), (test,)) for name, (train, test) in BATCHES.items()
}
FEWEST = 2  # items of a class in a batch: selection needs two folds
_REST = 1.0  # N along x in the first sample: the batches have 0.04 and 2 or more


class Experiment:
    """The data, read, labelled and described once."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed
        self.recordings: Recordings = by_batch(recorded())

    @cache  # noqa: B019 (one object lives as long as the program)
    def tracks(self, encoder: str, tared: bool) -> LabelTracks:
        data = tare(self.recordings, round(TARE_SECONDS / self.recordings.dt)) if tared else self.recordings
        return published_words(data, *ENCODERS[encoder])

    @cache  # noqa: B019
    def items(self, benchmark: str) -> LabelledIntervals:
        return items_between(self.recordings, benchmark, WITH_BATCHES[benchmark])

    def candidates(self, benchmark: str, method: Method) -> dict[str, Features]:
        """Features by grammar, the one with the fewest columns first."""
        features = {}
        for grammar in method.grammars:
            tracks = {name: self.tracks(name, method.tare) for name in GRAMMARS[grammar]}
            features[grammar] = extract_features(tracks, self.items(benchmark), method.spec)
        return dict(sorted(features.items(), key=lambda item: len(item[1].names)))

    def row(self, benchmark: str, name: str) -> dict[str, Any]:
        items, chosen = self.items(benchmark), Counter[str]()
        if name == "duration alone":
            learner, columns = validation.forest(items.seconds, items.y), {}
        else:
            method = METHODS[name]
            features = self.candidates(benchmark, method)
            columns = {key: len(x.names) for key, x in features.items()}
            learner = counted(svm_on(features, method.spec, items, method.grid), chosen)
        repeats = fewer_repeats(benchmark, self.repeats)
        score = WITH_BATCHES[benchmark].score(learner, items, repeats, self.seed)
        return {**score, "repeats": repeats, "columns": columns, "chosen": dict(chosen.most_common())}

    def about(self) -> dict[str, Any]:
        methods = {
            name: {
                "families": method.families,
                "grammars": method.grammars,
                "ranks": method.grid.ranks,
                "tared": method.tare,
            }
            for name, method in METHODS.items()
        }
        return {
            "what": "accuracy of words of several kinds, nested and grouped by trial",
            "encoders": {name: {"window": w, "thresholds": f"preset x {s:g}"} for name, (w, s) in ENCODERS.items()},
            "grammars": GRAMMARS,
            "methods": methods,
            "repeats": self.repeats,
            "benchmarks": {name: b.about(self.items(name)) for name, b in WITH_BATCHES.items()},
        }


def fewer_repeats(benchmark: str, repeats: int) -> int:
    """Half as many where there are many items."""
    return max(2, repeats // 2) if benchmark == "failure types" else repeats


def counted(learner: validation.Estimator, chosen: Counter[str]) -> validation.Estimator:
    """The same learner, which also counts what the inner folds chose."""

    def learn(train: NDArray[np.int64], test: NDArray[np.int64], seed: int) -> validation.Prediction:
        predicted, choice = learner(train, test, seed)
        chosen[f"{choice['features']}: {choice['kernel']} C={choice['cost']:g}"] += 1
        return predicted, choice

    return learn


def by_batch(recordings: Recordings) -> Recordings:
    """The simulated failures as two sessions, by how their records begin."""
    began = np.where(np.abs(recordings.wrench[:, 0, 0]) < _REST, AT_REST, LOADED)
    return replace(recordings, session=np.where(recordings.source == FAILURES, began, recordings.session))


def items_between(recordings: Recordings, name: str, benchmark: Benchmark) -> LabelledIntervals:
    """The items of a benchmark; from one batch to the other only those of the classes that both have."""
    items = items_of(recordings, benchmark)
    return of_both(items, BATCHES[name]) if name in BATCHES else items


def of_both(items: LabelledIntervals, sessions: tuple[str, str]) -> LabelledIntervals:
    """Only the classes with at least FEWEST items on each side."""
    counts = [np.bincount(items.y[items.session == side], minlength=len(items.classes)) for side in sessions]
    frequent = np.flatnonzero(np.min(counts, axis=0) >= FEWEST).tolist()
    rows = np.flatnonzero(np.isin(items.y, frequent))
    number = np.full(len(items.classes), -1)
    number[frequent] = np.arange(len(frequent))
    dropped = {**items.dropped, "class not in both batches": len(items.y) - len(rows)}
    return LabelledIntervals(
        tuple(items.classes[c] for c in frequent),
        number[items.y[rows]],
        items.trial[rows],
        items.session[rows],
        tuple(part.take(rows) for part in items.intervals),
        dropped,
    )


def main(repeats: int = 5, seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(repeats, seed)
    wanted = {
        f"{benchmark} | {method}": partial(experiment.row, benchmark, method)
        for benchmark in WITH_BATCHES
        for method in ("duration alone", *METHODS)
    }
    Rows("grammar", command_of(main, locals()), experiment.about(), seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
