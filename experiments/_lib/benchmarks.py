"""Classification benchmarks on the recorded trials, and how an estimator is scored on them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments._lib.arrays import Floats
from experiments._lib.catalogue import DATA
from experiments._lib.intervals import of_folds, of_splits
from experiments._lib.tasks import failure_types, states
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.io.hiro.importer import read_hiro
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid, Split
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import LabelTracks, Recordings

FOLDS = 5
REAL, SIM1 = "REAL_HIRO_ONE_SA_SUCCESS", "SIM_HIRO_ONE_SA_SUCCESS"
SIM2, FAILURES = "SIM_HIRO_TWO_SA_SUCCESS", "SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob"
REAL_FAILURES = "REAL_HIRO_ONE_SA_ERROR_CHARAC"

# Confounds of the authors' recordings, in addition to those that rcbht_jax.learning.confounds finds in any data.
CONFOUNDS = {
    "states": (
        "The states differ in length, and in sessions B and C the recorded rotation is one 5 ms sample: read the score "
        "beside the duration-only one, and say which boundaries were used."
    ),
    "outcome": (
        "Success and failure were recorded in different sessions, with other sensor bias and other lengths, and are "
        "separable before contact: duration alone tells nearly all real trials, and two success sessions are "
        "separated just as well. A mixed-session score does not show that failure was recognised."
    ),
    "failure-type": (
        "The authors perturb the approach, so the type can be predicted before contact. The failures of one batch "
        "share starting pose and length: types are recognised far less well in a batch that was held out than in mixed "
        "ones."
    ),
}


@dataclass(frozen=True)
class Benchmark:
    """A task, and how training and test are divided."""

    task: TaskSpec
    train_on: tuple[str, ...] = ()  # sessions; empty = repeated grouped folds
    test_on: tuple[str, ...] = ()

    def splits(self, items: LabelledIntervals, repeats: int, seed: int) -> list[list[Split]]:
        """``[repeat][fold]``; one split where sessions decide."""
        if not self.train_on:
            return validation.repeated_folds(items.y, items.trial, FOLDS, repeats, seed)
        train, test = (np.flatnonzero(np.isin(items.session, side)) for side in (self.train_on, self.test_on))
        return [[(train, test)]]

    def score(self, learner: validation.Estimator, items: LabelledIntervals, repeats: int, seed: int) -> dict[str, Any]:
        """Accuracy and balanced accuracy with their 95% intervals, and the seconds it took."""
        began = time.perf_counter()
        splits = self.splits(items, repeats, seed)
        if self.train_on:
            scores = validation.holdout_score(learner, items.y, items.trial, splits[0][0], seed).summary()
        else:
            made = validation.cross_validate(learner, items.y, splits, seed)
            scores = of_folds(made, len(np.unique(items.trial)))
        return rounded(scores) | {"seconds": round(time.perf_counter() - began, 1)}

    def about(self, items: LabelledIntervals) -> dict[str, Any]:
        """Facts that are needed to interpret a score."""
        across = f"{' '.join(self.train_on)} to {' '.join(self.test_on)}"
        return {
            "classes": list(items.classes),
            "items": len(items.y),
            "trials": len(np.unique(items.trial)),
            "left out": items.dropped,
            "boundaries": self.task.boundaries if self.task.task == "states" else "whole record",
            "split": across if self.train_on else f"{FOLDS} folds, grouped by trial",
            "confounds": CONFOUNDS[self.task.task],
        }


def _across(boundaries: str, train_on: str, test_on: str) -> Benchmark:
    return Benchmark(states(boundaries=boundaries, sources=(REAL,)), (train_on,), (test_on,))


BENCHMARKS = {
    "REAL states": Benchmark(states(sources=(REAL,))),
    "SIM1 states": Benchmark(states(sources=(SIM1,))),
    "SIM2 states": Benchmark(states(sources=(SIM2,), arms="both")),
    "REAL states, A to B": _across("harmonised", "A", "B"),
    "REAL states, B to A": _across("harmonised", "B", "A"),
    "REAL merged states, A to B": _across("merged", "A", "B"),
    "REAL merged states, B to A": _across("merged", "B", "A"),
    "failure types": Benchmark(failure_types(sources=(FAILURES,))),
}


def mistakes(classes: tuple[str, ...], y: NDArray[np.int64], predicted: NDArray[np.int64]) -> dict[str, int]:
    """How often which class was taken for which other one."""
    wrong = zip(y[y != predicted].tolist(), predicted[y != predicted].tolist(), strict=True)
    return dict(Counter(f"{classes[true]} as {classes[answer]}" for true, answer in wrong))


def recorded() -> Recordings:
    """The authors' trials, from the folder that RCBHT_DATA names."""
    return read_hiro(DATA)[0]


def of_sources(recordings: Recordings, sources: tuple[str, ...]) -> Recordings:
    """The recordings of some data sets."""
    return recordings.take(np.isin(recordings.source, sources))


def published_words(
    recordings: Recordings, window: int = 5, scale: float | Floats = 1.0, limits: Floats | None = None
) -> LabelTracks:
    """Labels by the published rule.

    Args:
        recordings: one data set.
        window: samples.
        scale: factor on the limits, ``[6, 1]`` where axes differ.
        limits: gradient limits ``[6, 4]``, N/s and Nm/s; None = the preset's.
    """
    thresholds = GradientThresholds(np.asarray(preset().limits if limits is None else limits) * scale)
    return encode_batch(EncoderConfig(window, recordings.dt), thresholds, recordings.wrench, recordings.length)


def segments(recordings: Recordings, items: LabelledIntervals) -> list[Floats]:
    """The wrench of every item ``[time, 6 x arms]``, N and Nm."""
    arms = [
        [recordings.wrench[row, start:end] for row, start, end in zip(i.recording, i.start, i.end, strict=True)]
        for i in items.intervals
    ]
    return [np.concatenate(parts, 1).astype(np.float64) for parts in zip(*arms, strict=True)]


def svm_on(
    features: Mapping[str, Features], spec: FeatureSpec, items: LabelledIntervals, grid: Grid
) -> validation.Estimator:
    """A nested SVM on one of several matrices of features, which inner folds choose, with the weights of families."""
    matrices = {name: one.values for name, one in features.items()}
    weights = {name: one.weights(spec) for name, one in features.items()}
    return validation.nested_svm(matrices, items.y, items.trial, grid, weights)


def items_of(recordings: Recordings, benchmark: Benchmark) -> LabelledIntervals:
    return labelled_intervals(recordings, benchmark.task)


def with_interval(
    scores: ArrayLike, test_to_train: float = 1.0, places: int = 3, trials: float = 0, items: float = 0
) -> dict[str, Any]:
    """What :func:`intervals.of_splits` gives, rounded, with the ends as a pair."""
    score = of_splits(scores, test_to_train, trials, items)
    ends = {"interval": [round(score["low"], places), round(score["high"], places)]} if "low" in score else {}
    return {"mean": round(score["mean"], places), **ends}


def rounded(value: Any) -> Any:
    """Numbers of a nested result to four places."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [rounded(part) for part in value]
    return round(value, 4) if isinstance(value, float) else value
