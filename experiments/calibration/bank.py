"""A bank of encoders with different thresholds and windows, whose kernels are selected or averaged.

Each member of the bank is an encoder: the preset's limits times 1/256 ... 2, forces and moments together or apart,
windows of 5, 10 and 20 samples. Features are plain words, richer words (both without duration and absolute offset) or
all families, scaled by ranks, with a linear kernel per member. One member is selected on the training side, or kernels
are averaged: all, those of one window, the best eight, or weighted by their alignment with the classes of the training
side. "gain" is the difference, fold by fold, from the preset alone on the same features.

Run: python -m experiments.calibration.bank STORE.zarr
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import REAL, SIM1, of_sources, published_words, rounded
from experiments._lib.checkpointed_rows import Rows
from experiments._lib.intervals import of_folds, with_width
from experiments._lib.kernels import alignment_weights
from experiments._lib.results_io import defaults_of, given
from experiments._lib.tasks import states
from experiments.calibration.near_preset import Near, between
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.features.recipes import ALL, PLAIN, RICHER
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning import metrics, validation
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features, labelled_intervals
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import LabelTracks, Recordings

WINDOWS = (5, 10, 20)  # samples
SCALES = (1.0, 2.0, 1 / 4, 1 / 16, 1 / 64, 1 / 256)  # of the preset's limits
APART = tuple((s, t) for s, t in itertools.permutations((1.0, 1 / 16, 1 / 64), 2) if 1.0 in (s, t))
# Window, factor on the limits of the forces, of the moments; the preset first.
BANK = (*((w, s, s) for w in WINDOWS for s in SCALES), *((WINDOWS[0], s, t) for s, t in APART))
SPECS = {
    "words": FeatureSpec(families=PLAIN),
    "richer words": FeatureSpec(families=RICHER),
    "all families": FeatureSpec(families=ALL, balance=True),
}
METHODS = (
    "preset", "best inside", "average of the best", "average of all", "average, window 5 only", "weighted by alignment",
)  # fmt: skip
FILLED = 0.015  # s; a mark within this of one second after the one before, or before the end, was filled in by hand
SEED = 0


class Bank(Near):
    """Learners on the kernels of the bank."""

    def _learn(
        self, method: str, train: NDArray[np.int64], test: NDArray[np.int64], seed: int
    ) -> validation.Prediction:
        uniform = np.array([w == WINDOWS[0] for w, _, _ in BANK], float)
        weights = {"weighted by alignment": self.alignment, "average, window 5 only": lambda _: uniform / uniform.sum()}
        if method not in weights:
            return super()._learn(method, train, test, seed)
        weight = weights[method](train)
        kernel = np.tensordot(weight, self._kernels_of(train), 1)
        cost = self._best_cost(kernel, train, seed)
        return self._predict(kernel, cost, train, test), {"candidates": np.argsort(-weight, kind="stable").tolist()}

    def alignment(self, train: NDArray[np.int64]) -> NDArray[np.float64]:
        """Weights ``[member]`` by the alignment of kernels with the classes of the training side."""
        kernels = np.stack([kernel[np.ix_(train, train)] for kernel in self._kernels_of(train)])
        return alignment_weights(kernels, self.y[train])


def labelled(recordings: Recordings) -> list[LabelTracks]:
    """The labels that each member of the bank gives."""
    scales = [(window, np.repeat([forces, moments], 3)[:, None]) for window, forces, moments in BANK]
    return [published_words(recordings, window, scale) for window, scale in scales]


def bank(recordings: Recordings, items: LabelledIntervals, tracks: list[LabelTracks], spec: FeatureSpec) -> Bank:
    members: list[Features] = [extract_features(track, items, spec) for track in tracks]
    distance = np.array([abs(np.log2([s, t, w / WINDOWS[0]])).max() for w, s, t in BANK])
    x = np.stack([one.values.astype(np.float32) for one in members])
    return Bank(x, items.y, items.trial, distance, weight=members[0].weights(spec))


def filled_in(recordings: Recordings, items: LabelledIntervals) -> NDArray[np.bool_]:
    """Sentences ``[item]`` of trials whose last mark stands one second after the one before, or before the end."""
    (spans,) = items.intervals
    last, before = recordings.starts(RECORDED)[spans.recording, 3], recordings.starts(RECORDED)[spans.recording, 2]
    end = recordings.length[spans.recording] * recordings.dt
    gaps = np.stack([last - before, end - last])
    return np.asarray((np.abs(gaps - 1) < FILLED).any(0))


class Experiment:
    """The sets of the store, read and labelled once."""

    def __init__(self, store: Path, repeats: int) -> None:
        self._everything, self._repeats = read_recordings(store), repeats
        recordings, items, _ = self.of(SIM1)
        self.about: dict[str, Any] = {
            "bank": [f"W{w}, forces x {s:g}, moments x {t:g}" for w, s, t in BANK],
            "features": {name: spec.families for name, spec in SPECS.items()},
            "repeats": repeats,
            "SIM1 trials": len(np.unique(items.trial)),
            "SIM1 trials whose S3 was filled in": len(np.unique(items.trial[filled_in(recordings, items)])),
        }

    @cache  # noqa: B019 (one object lives as long as the program)
    def of(self, source: str) -> tuple[Recordings, LabelledIntervals, list[LabelTracks]]:
        """Recordings, sentences and the labels of the bank."""
        recordings = of_sources(self._everything, (source,))
        return recordings, labelled_intervals(recordings, states()), labelled(recordings)

    @cache  # noqa: B019
    def learners(self, source: str, spec: str) -> Bank:
        return bank(*self.of(source), SPECS[spec])

    @cache  # noqa: B019
    def folds(self, spec: str, method: str) -> validation.CrossValidation:
        """Scores on SIM1."""
        items = self.of(SIM1)[1]
        splits = validation.repeated_folds(items.y, items.trial, 5, self._repeats, SEED)
        return validation.cross_validate(self.learners(SIM1, spec).learner(method), items.y, splits, SEED)

    def sim1(self, spec: str, method: str) -> dict[str, Any]:
        items, scores = self.of(SIM1)[1], self.folds(spec, method)
        halved = (1 + scores.accuracy - self.folds(spec, "preset").accuracy) / 2  # a difference may be negative
        gain = (2 * limit - 1 for limit in metrics.corrected_interval(halved, 1 / 4))
        chosen = Counter(choice["candidates"][0] for repeat in scores.chosen for choice in repeat)
        return {
            "accuracy": rounded(of_folds(scores, len(np.unique(items.trial)))["accuracy"]),
            "gain": rounded(with_width(dict(zip(("mean", "low", "high"), gain, strict=True)), 0)),
            "chosen": {self.about["bank"][member]: times for member, times in chosen.most_common()},
            "confusion": scores.confusion.tolist(),
        }

    def transfer(self, one: str, other: str, spec: str, method: str) -> dict[str, Any]:
        """Train on one session of the recorded trials, test on the other."""
        scores = between(self.learners(REAL, spec).learner(method), self.of(REAL)[1], one, other)
        return {
            "accuracy": rounded(scores.summary()["accuracy"]),
            "chosen": self.about["bank"][scores.chosen["candidates"][0]],
        }


def main(
    store: tyro.conf.Positional[Path], repeats: Annotated[int, tyro.conf.arg(help="Of SIM1's folds.")] = 10
) -> None:
    experiment = Experiment(store, repeats)
    wanted: dict[str, Callable[[], Any]] = {}
    for spec, method in itertools.product(SPECS, METHODS):
        wanted[f"{spec} | SIM1 | {method}"] = partial(experiment.sim1, spec, method)
        wanted[f"{spec} | REAL A -> B | {method}"] = partial(experiment.transfer, "A", "B", spec, method)
        wanted[f"{spec} | REAL B -> A | {method}"] = partial(experiment.transfer, "B", "A", spec, method)
    command = "python -m experiments.calibration.bank STORE.zarr" + given(locals(), defaults_of(main))
    Rows("calibration_bank", command, experiment.about, SEED).fill(wanted)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
