"""Calibration inside cross-validation: learners that choose thresholds on their training rows only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.label_durations import label_durations
from rcbht_jax.calibration.objective import Objective, scores
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.learning.validation import Estimator, Prediction, nested_svm
from rcbht_jax.types import Array, Recordings

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
# (training recordings as rows of the corpus, seed) -> threshold sets [n, 6, 4], of which inner folds choose one
Choose = Callable[[Rows, int], Floats]


@dataclass(frozen=True)
class CandidateBank:
    """Candidates and their times per label, trial by trial: what a candidate says of a trial depends on nothing else.

    So one encoding of all trials serves every fold; a fold scores the candidates on its own training trials.
    """

    limits: Floats  # [candidate, 6, 4]
    times: Array  # int32 [candidate, recording, sentence, 6, 25]
    y: NDArray[np.int32]  # [recording, sentence]
    classes: int

    @staticmethod
    def make(corpus: CalibrationData, config: EncoderConfig, limits: Floats, chunk: int = 256) -> CandidateBank:
        """Encode all trials with all candidates."""
        parts = []
        for start in range(0, len(limits), chunk):
            some = jnp.asarray(limits[start : start + chunk], corpus.windows.slope.dtype)
            parts.append(np.asarray(label_durations(config, some, corpus.windows, jnp.asarray(corpus.edges))))
        return CandidateBank(limits, np.concatenate(parts), corpus.y, len(corpus.classes))

    def rank(self, rows: Rows, objective: Objective) -> Rows:
        """Candidates from the best to the worst on the recordings ``rows``; ties to the lowest index."""
        made = scores(self.times[:, rows], self.y[rows], self.classes)
        value = (made.astype(np.float64) @ objective.weights()).round(6)
        return np.argsort(-value, kind="stable").astype(np.int64)

    def chooser(self, objective: Objective, top: int) -> Choose:
        """The ``top`` best candidates."""
        return lambda rows, seed: self.limits[self.rank(rows, objective)[:top]]


@dataclass
class CalibratedSvm:
    """Estimator: chooses thresholds on its training trials, encodes all trials with them, trains and selects an SVM.

    Attributes:
        recordings: the data set.
        items: sentences of one arm.
        config: static configuration of the encoder.
        choose: see :data:`Choose`.
        grid: what the SVM's selection may choose from, ranks or not; it chooses among the threshold sets too.
        spec: features of the labels, of any families, balanced or not.
    """

    recordings: Recordings
    items: LabelledIntervals
    config: EncoderConfig
    choose: Choose
    grid: Grid
    spec: FeatureSpec
    _known: dict[bytes, Features] = field(default_factory=dict, init=False, repr=False)

    def learner(self) -> Estimator:
        """For :func:`rcbht_jax.learning.validation.cross_validate`."""
        return self._learn

    def _learn(self, train: Rows, test: Rows, seed: int) -> Prediction:
        (spans,) = self.items.intervals
        order = list(dict.fromkeys(spans.recording.tolist()))
        rows = np.array(sorted({order.index(r) for r in spans.recording[train].tolist()}), np.int64)
        sets = self.choose(rows, seed)
        made = {str(k): self._features(limits) for k, limits in enumerate(sets)}
        matrices = {name: x.values for name, x in made.items()}
        weights = {name: x.weights(self.spec) for name, x in made.items()}
        said, chosen = nested_svm(matrices, self.items.y, self.items.trial, self.grid, weights)(train, test, seed)
        return said, {**chosen, "limits": sets[int(chosen["features"])].tolist()}

    def _features(self, limits: Floats) -> Features:
        key = limits.tobytes()
        if key not in self._known:
            (spans,) = self.items.intervals
            rows, place = np.unique(spans.recording, return_inverse=True)
            wrench, length = self.recordings.wrench[rows], self.recordings.length[rows]
            tracks = encode_batch(self.config, GradientThresholds(limits), wrench, length)
            local = replace(self.items, intervals=(replace(spans, recording=place),))
            self._known[key] = extract_features(tracks, local, self.spec)
        return self._known[key]


def fixed(limits: Any) -> Choose:
    """No calibration: the same threshold sets ``[6, 4]`` or ``[n, 6, 4]`` in every fold."""
    sets = np.asarray(limits, np.float64).reshape(-1, 6, 4)
    return lambda rows, seed: sets
