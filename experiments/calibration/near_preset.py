"""Thresholds near the preset: the value of selecting, shrinking and averaging on held-out trials.

A thousand candidates cannot be ranked with 29 trials. Here three numbers vary, each by a factor of at most eight: the
small limit of the forces, that of the moments, and all larger limits. Features are words alone (histogram, n-grams,
attributes; no duration, no offset), scaled by ranks, with a linear kernel per candidate. Selection uses repeated
grouped folds of the training side: the best candidate, the one nearest to the preset within a standard error of it, the
best by margin; or the kernels of all candidates, or of the best eight, are averaged. Two more methods rank candidates
by the accuracy of states between simulated sessions, whose sets are kept in FOLDER; the preset identified from the
tested session is left out of that.

Run: python -m experiments.calibration.near_preset STORE.zarr FOLDER
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.stats import qmc

from experiments._lib.arrays import Floats
from experiments._lib.benchmarks import REAL, SIM1, of_sources, published_words, rounded
from experiments._lib.checkpointed_rows import Rows
from experiments._lib.intervals import of_folds
from experiments._lib.kernels import cost_scores, predict_kernel, rank_kernel
from experiments._lib.tasks import states
from experiments.calibration.methods import WORDS
from experiments.classification.sim_to_real_sets import make
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning import validation
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features, labelled_intervals
from rcbht_jax.types import Recordings

OCTAVES = 3.0  # the three numbers vary by a factor of 2 ** -OCTAVES ... 2 ** OCTAVES
COSTS = (1.0, 10.0, 100.0)  # of the SVM, for kernels whose diagonal is about 1
INNER, INNER_REPEATS = 4, 2
TOP = 8
SEED = 0
SIMULATED = ("A", "B", "C", "openhrp")
SIMULATED_TRIALS = 40  # of each
CANDIDATES, REPEATS = 64, 3  # REPEATS of the five outer folds of SIM1
METHODS = (
    "preset", "best inside", "one standard error", "best margin inside", "average of the best", "average of all",
    "simulated, best", "simulated, average",
)  # fmt: skip

Kernel = NDArray[np.floating[Any]]


def candidates_of(count: int) -> tuple[Floats, Floats]:
    """GradientThresholds ``[candidate, 6, 4]``, the preset first, and their distance from it in octaves."""
    points = (2 * qmc.Sobol(3, rng=SEED).random(count) - 1) * OCTAVES
    points[0] = 0
    limits = np.repeat(np.asarray(preset().limits)[None], count, axis=0)
    forces, moments, larger = (2.0**points.T)[:, :, None]
    limits[:, :, :3] *= larger[..., None]
    limits[:, :3, 3] *= forces
    limits[:, 3:, 3] *= moments
    return np.maximum.accumulate(limits[..., ::-1], axis=-1)[..., ::-1], np.abs(points).max(1)


def words(recordings: Recordings, items: LabelledIntervals, limits: Floats) -> NDArray[np.float32]:
    """Features ``[candidate, item, feature]``."""
    tracks = (published_words(recordings, limits=one) for one in limits)
    return np.stack([extract_features(track, items, WORDS).values.astype(np.float32) for track in tracks])


def simulated_transfer(folder: Path, limits: Floats) -> dict[tuple[str, str], Floats]:
    """Accuracy ``[candidate]`` of states learned on one simulated session and predicted on another one."""
    parts = {}
    for name in SIMULATED:
        store = make(folder, "mild", name)
        recordings = store.take(np.arange(min(SIMULATED_TRIALS, len(store))))
        items = labelled_intervals(recordings, states())
        parts[name] = words(recordings, items, limits), items.y
    out = {}
    for one, other in itertools.permutations(SIMULATED, 2):
        (x, y), (test, y_true) = parts[one], parts[other]
        train = np.arange(len(y))
        right = []
        for k in range(len(limits)):
            kernel = rank_kernel(np.concatenate([x[k], test[k]]), train)
            right.append((predict_kernel(kernel, y, train, len(y) + np.arange(len(y_true)), COSTS[1]) == y_true).mean())
        out[one, other] = np.array(right)
    return out


@dataclass
class Near:
    """Learners that share the kernels of a training side."""

    x: NDArray[np.float32]  # [candidate, item, feature]
    y: NDArray[np.int64]
    groups: NDArray[np.str_]
    distance: Floats  # [candidate] octaves
    ranked: dict[str, Floats] = field(default_factory=dict)  # method -> [candidate], on simulated trials
    weight: Floats | None = None  # [feature]
    _kernels: dict[bytes, NDArray[np.float32]] = field(default_factory=dict)
    _inside: dict[bytes, tuple[Floats, Floats]] = field(default_factory=dict)

    def learner(self, method: str) -> validation.Estimator:
        return partial(self._learn, method)

    def _learn(
        self, method: str, train: NDArray[np.int64], test: NDArray[np.int64], seed: int
    ) -> validation.Prediction:
        kernels = self._kernels_of(train)
        accuracy, margin = self._inside_of(train, seed)
        chosen, cost = self._choice(method, accuracy, margin)
        kernel = kernels[chosen].mean(0)
        if len(chosen) > 1:
            cost = self._best_cost(kernel, train, seed)
        return self._predict(kernel, cost, train, test), {"candidates": chosen.tolist(), "cost": COSTS[cost]}

    def _best_cost(self, kernel: Kernel, train: NDArray[np.int64], seed: int) -> int:
        """Index of the cost for an average of kernels, by the same folds as a single one's."""
        return int(self._scores(kernel, train, seed)[0].mean(-1).argmax())

    def _predict(
        self, kernel: Kernel, cost: int, train: NDArray[np.int64], test: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        return predict_kernel(kernel, self.y, train, test, COSTS[cost])

    def _choice(self, method: str, accuracy: Floats, margin: Floats) -> tuple[NDArray[np.int64], int]:
        """Candidates and the index of a cost, from scores ``[candidate, cost, fold]``; ties to the nearest."""
        order = np.argsort(self.distance, kind="stable")
        mean = accuracy.mean(-1)
        if method.startswith("simulated"):
            ranked = order[np.argsort(-self.ranked[method][order], kind="stable")]
            several = method.endswith("average")
            return (ranked[:TOP], 0) if several else (ranked[:1], int(mean[ranked[0]].argmax()))
        value = (margin if method == "best margin inside" else accuracy).mean(-1).max(-1)
        best = order[value[order].argmax()]
        if method == "preset":
            best = np.int64(0)
        if method == "one standard error":
            folds = accuracy[best, mean[best].argmax()]
            least = folds.mean() - folds.std(ddof=1) / np.sqrt(len(folds))
            best = order[np.flatnonzero(value[order] >= least)[0]]
        if method == "average of all":
            return np.arange(len(mean)), 0
        if method == "average of the best":
            return order[np.argsort(-value[order], kind="stable")[:TOP]], 0
        return np.array([best]), int(mean[best].argmax())

    def _kernels_of(self, train: NDArray[np.int64]) -> NDArray[np.float32]:
        """Kernels ``[candidate, item, item]``, scaled by the training items."""
        if train.tobytes() not in self._kernels:
            self._kernels[train.tobytes()] = np.stack([rank_kernel(x, train, self.weight) for x in self.x])
        return self._kernels[train.tobytes()]

    def _inside_of(self, train: NDArray[np.int64], seed: int) -> tuple[Floats, Floats]:
        if train.tobytes() not in self._inside:
            kernels = self._kernels_of(train)
            both = [self._scores(kernel, train, seed) for kernel in kernels]
            self._inside[train.tobytes()] = np.stack([b[0] for b in both]), np.stack([b[1] for b in both])
        return self._inside[train.tobytes()]

    def _scores(self, kernel: Kernel, train: NDArray[np.int64], seed: int) -> tuple[Floats, Floats]:
        """Accuracy and mean margin ``[cost, fold]`` of grouped folds of the training items."""
        part = kernel[np.ix_(train, train)]
        return cost_scores(part, self.y[train], self.groups[train], COSTS, INNER, INNER_REPEATS, seed)


class Experiment:
    """The sets of the store, read and labelled once."""

    def __init__(self, store: Path, folder: Path) -> None:
        self._everything, self._folder = read_recordings(store), folder
        self._limits, self._distance = candidates_of(CANDIDATES)

    @cache  # noqa: B019 (one object lives as long as the program)
    def transfers(self) -> dict[tuple[str, str], Floats]:
        return simulated_transfer(self._folder, self._limits)

    @cache  # noqa: B019
    def of(self, source: str) -> tuple[Near, LabelledIntervals]:
        recordings = of_sources(self._everything, (source,))
        items = labelled_intervals(recordings, states())
        return Near(words(recordings, items, self._limits), items.y, items.trial, self._distance), items

    def learner(self, source: str, method: str, preset_of_test: str) -> validation.Estimator:
        """A learner on a set; candidates are not ranked on trials of the preset that the tested session gave."""
        learners, _ = self.of(source)
        if method.startswith("simulated"):
            pairs = [value for pair, value in self.transfers().items() if preset_of_test not in pair]
            learners.ranked[method] = np.asarray(np.mean(pairs, axis=0), np.float64)
        return learners.learner(method)

    def sim1(self, method: str) -> dict[str, Any]:
        _, items = self.of(SIM1)
        trials = len(np.unique(items.trial))
        splits = validation.repeated_folds(items.y, items.trial, 5, REPEATS, SEED)
        scores = validation.cross_validate(self.learner(SIM1, method, "openhrp"), items.y, splits, SEED)
        chosen = [choice["candidates"][0] for repeat in scores.chosen for choice in repeat]
        return {"accuracy": rounded(of_folds(scores, trials)["accuracy"]), "chosen": chosen}

    def transfer(self, one: str, other: str, method: str) -> dict[str, Any]:
        scores = between(self.learner(REAL, method, other), self.of(REAL)[1], one, other)
        return {"accuracy": rounded(scores.summary()["accuracy"]), "chosen": scores.chosen["candidates"][:1]}


def between(learner: validation.Estimator, items: LabelledIntervals, one: str, other: str) -> validation.HoldoutScore:
    """Train on one session of the recorded trials, test on the other."""
    split = np.flatnonzero(items.session == one), np.flatnonzero(items.session == other)
    return validation.holdout_score(learner, items.y, items.trial, split, SEED)


def main(store: tyro.conf.Positional[Path], folder: tyro.conf.Positional[Path]) -> None:
    experiment = Experiment(store, folder)
    wanted: dict[str, Callable[[], Any]] = {}
    for method in METHODS:
        wanted[f"REAL A -> B | {method}"] = partial(experiment.transfer, "A", "B", method)
        wanted[f"REAL B -> A | {method}"] = partial(experiment.transfer, "B", "A", method)
    wanted |= {f"SIM1 | {method}": partial(experiment.sim1, method) for method in METHODS}
    about = {
        "features": "words, scaled by ranks; states, harmonised",
        "candidates": CANDIDATES, "repeats": REPEATS, "octaves": OCTAVES, "costs": COSTS,
    }  # fmt: skip
    command = "python -m experiments.calibration.near_preset STORE.zarr FOLDER"
    Rows("calibration_near", command, about, SEED).fill(wanted)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
