"""Accuracy over the number of training trials, and over kernel and cost: the paper's supplement on our labels.

Both for the states of the real and of the authors' simulated one-arm trials, from the paper's features (offline labels,
label sentences resampled to the longest) and from our words (online labels; histogram, n-grams, attributes; neither
duration nor offset). Curves use fixed classifiers, since two trials are too few for selection; trials are drawn anew in
every repeat and all others are test trials. Grids use repeated folds grouped by trial. Nothing is selected here: the
best cell of a grid is an optimistic score.

Run: python -m experiments.classification.curves --repeats 20 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import BENCHMARKS, FOLDS, of_sources, published_words, recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments.classification.table1_ours import papers_features
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning import metrics, validation
from rcbht_jax.learning.svm import COSTS, KERNELS, Grid, SvmSpec, predictions
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features, labelled_intervals
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.types import Recordings

SETS = ("REAL states", "SIM1 states")
SIZES = (2, 3, 4, 6, 8, 12, 16, 20, 24, 28)  # training trials, of which five must remain to test
REMAIN = 5
GRID_REPEATS = 4  # of the folds, in the grids
SCALINGS = {"paper's features, offline labels": False, "words, online labels": True}
FEATURES = tuple(SCALINGS)
STATISTICS = "statistics of the raw wrench + random forest"


@dataclass(frozen=True, eq=False)
class Data:
    """A set's trials, read once, and its features, made when a row needs them."""

    recordings: Recordings

    @cache  # noqa: B019 (one object lives as long as the program)
    def part(self, name: str) -> tuple[Recordings, LabelledIntervals]:
        spec = BENCHMARKS[name].task
        trials = of_sources(self.recordings, spec.sources)
        return trials, labelled_intervals(trials, spec)

    @cache  # noqa: B019
    def features(self, name: str, features: str) -> NDArray[np.floating]:
        trials, items = self.part(name)
        if features == FEATURES[0]:
            return papers_features(encode_dataset(trials), items)
        if features == STATISTICS:
            return raw.statistics(segments(trials, items))
        return extract_features(published_words(trials), items, FeatureSpec()).values


def learner(x: NDArray[np.floating], items: LabelledIntervals, features: str) -> validation.Estimator:
    """A classifier without anything to choose: the paper's on its features, a linear one on words."""
    if features == STATISTICS:
        return raw.forest(x, items.y)
    kernel = "poly" if features == FEATURES[0] else "linear"
    grid = Grid(kernels=(kernel,), costs=(1.0,), scalings=(SCALINGS[features],))
    return validation.nested_svm({"": x}, items.y, items.trial, grid)


def curve(data: Data, name: str, features: str, repeats: int, seed: int) -> dict[str, Any]:
    """Accuracy on all other trials, per number of training trials: mean, and the middle 90 % of the draws."""
    _, items = data.part(name)
    learn = learner(data.features(name, features), items, features)
    trials = np.unique(items.trial)
    out: dict[str, Any] = {}
    for size in (size for size in SIZES if size <= len(trials) - REMAIN):
        scores = np.zeros(repeats)
        for repeat in range(repeats):
            order = np.random.default_rng((seed, repeat)).permutation(trials)
            inside = np.isin(items.trial, order[:size])
            test = np.flatnonzero(~inside)
            predicted, _ = learn(np.flatnonzero(inside), test, 1000 * seed + repeat)
            scores[repeat] = metrics.accuracy(items.y[test], predicted)
        out[str(size)] = [float(scores.mean()), *np.quantile(scores, [0.05, 0.95]).tolist()]
    return rounded(out)


def grid(data: Data, name: str, features: str, seed: int) -> dict[str, Any]:
    """Mean accuracy ``[kernel][cost]`` over repeated grouped folds."""
    _, items = data.part(name)
    x = np.asarray(data.features(name, features), np.float64)
    folds = [f for one in validation.repeated_folds(items.y, items.trial, FOLDS, GRID_REPEATS, seed) for f in one]
    out = {}
    for kernel in KERNELS:
        spec = SvmSpec(kernel=kernel, scaling=SCALINGS[features])
        scores = [
            [metrics.accuracy(items.y[test], one) for one in predictions(x, items.y, train, test, spec, COSTS)]
            for train, test in folds
        ]
        out[kernel] = np.mean(scores, axis=0).tolist()
    return rounded(out)


def main(repeats: int = 20, seed: int = 0, only: Only = ALL_ROWS) -> None:
    data = Data(recorded())
    about = {
        "what": "accuracy over training trials (mean, 5 % and 95 % of the draws) and over kernel and cost (mean)",
        "repeats": repeats,
        "grid repeats": GRID_REPEATS,
        "costs": COSTS,
        "boundaries": "harmonised",
    }
    wanted: dict[str, Callable[[], Any]] = {}
    for name in SETS:
        for features in (*FEATURES, STATISTICS):
            wanted[f"{name} | curve | {features}"] = partial(curve, data, name, features, repeats, seed)
        for features in FEATURES:
            wanted[f"{name} | grid | {features}"] = partial(grid, data, name, features, seed)
    Rows("curves", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
