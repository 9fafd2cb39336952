"""Other methods for time series compared with words, on the same trials and the same grouped folds.

The peers use the raw wrench of the segments, in N and Nm; see experiments._lib.raw_learners for the features of each.
None uses the duration of a segment. The ridge classifiers select their penalty by leave-one-out in the training rows.
Our rows are the words of the online encoder (window 5, preset thresholds) with a nested SVM.

Run: make peers, or python -m experiments.classification.peers --repeats 10 --seed 0 where aeon and torch are installed
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import distributions
from typing import Any

import tyro

from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import BENCHMARKS, FOLDS, items_of, published_words, recorded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import FULL, PLAIN
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.types import LabelTracks, Recordings

Make = Callable[[raw.Segments, LabelledIntervals], validation.Estimator]

PEERS: dict[str, Make] = {
    "statistics + random forest": lambda x, items: raw.forest(raw.statistics(x), items.y),
    "SAX bag of words + SVM": raw.sax_words,
    "1d-SAX + SVM": raw.one_d_sax,
    "MiniRocket + ridge": lambda x, items: rocket("MiniRocketClassifier", x, items),
    "MiniRocket + ridge, offset removed": lambda x, items: rocket("MiniRocketClassifier", raw.centred(x), items),
    "MultiRocketHydra + ridge": lambda x, items: rocket("MultiRocketHydraClassifier", x, items),
}
PROBES: dict[str, Make] = {
    "duration alone": lambda x, items: validation.forest(items.seconds, items.y),
    "first sample alone": raw.first_sample,
    "first second alone": raw.first_second,
    "majority": lambda x, items: validation.majority(items.y),
}
OURS = {
    "words + SVM, without duration and offset": PLAIN,
    "words + SVM, all": (*FULL, "course", "edges"),
}
GRID = Grid(kernels=("linear", "rbf"), costs=(0.01, 0.1, 1.0, 10.0, 100.0))
# A fifth of the repeats: the first has five times the items of the others, the second takes as long as ten others.
HEAVY = ("failure types", "MultiRocketHydra + ridge")


def rocket(name: str, x: raw.Segments, items: LabelledIntervals) -> validation.Estimator:
    """A classifier of aeon with random kernels, which takes items of one length."""
    return raw.of_aeon(name, raw.resampled(x), items.y)


class Experiment:
    """The data, read once, and the functions that make each row."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed
        self.recordings: Recordings = recorded()

    @cache  # noqa: B019 (one object lives as long as the program)
    def tracks(self) -> LabelTracks:
        """Labels of all recordings; made when a row needs them."""
        return published_words(self.recordings)

    @cache  # noqa: B019
    def data(self, benchmark: str) -> tuple[LabelledIntervals, raw.Segments]:
        items = items_of(self.recordings, BENCHMARKS[benchmark])
        return items, segments(self.recordings, items)

    def learner(self, benchmark: str, method: str) -> validation.Estimator:
        items, parts = self.data(benchmark)
        if method in OURS:
            words = extract_features(self.tracks(), items, FeatureSpec(families=OURS[method])).values
            return validation.nested_svm({"": words}, items.y, items.trial, GRID)
        return (PEERS | PROBES)[method](parts, items)

    def row(self, benchmark: str, method: str) -> dict[str, Any]:
        items, _ = self.data(benchmark)
        repeats = repeats_of(benchmark, method, self.repeats)
        score = BENCHMARKS[benchmark].score(self.learner(benchmark, method), items, repeats, self.seed)
        score = validation.without_intervals(score) if method == "majority" else score
        return {"kind": kind(method), **score, "repeats": repeats, "libraries": libraries()}


def kind(method: str) -> str:
    return "ours" if method in OURS else "peer" if method in PEERS else "probe"


def libraries() -> str:
    """Versions of the libraries that decide the numbers, where they are installed."""
    names = ("aeon", "scikit-learn", "tslearn")
    installed = {name: next(iter(distributions(name=name)), None) for name in names}
    return ", ".join(f"{name} {found.version}" for name, found in installed.items() if found)


def repeats_of(benchmark: str, method: str, repeats: int) -> int:
    return max(2, repeats // 5) if benchmark in HEAVY or method in HEAVY else repeats


def about(experiment: Experiment) -> dict[str, Any]:
    facts = {
        name: benchmark.about(experiment.data(name)[0]) | {"repeats": repeats_of(name, "", experiment.repeats)}
        for name, benchmark in BENCHMARKS.items()
    }
    return {
        "what": "accuracy of other methods on the raw wrench, and of words, on the same grouped folds",
        "resampled to": raw.LENGTH,
        "folds": FOLDS,
        "repeats": experiment.repeats,
        "benchmarks": facts,
    }


def main(repeats: int = 10, seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(repeats, seed)
    wanted = {
        f"{benchmark} | {method}": partial(experiment.row, benchmark, method)
        for method in (*PROBES, *OURS, *PEERS)
        for benchmark in BENCHMARKS
    }
    Rows("peers", command_of(main, locals()), about(experiment), seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
