"""Calibration inside cross-validation: estimators that choose thresholds on their training rows only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.label_durations import label_durations
from rcbht_jax.calibration.objective import Objective, scores
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, Thresholds, limits_of, validate
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.learning.validation import Estimator, Prediction, nested_svm
from rcbht_jax.types import Recordings

Rows = NDArray[np.int64]
# (training recordings as rows of the calibration data, seed) -> thresholds [n, axis, 4]; inner folds choose one of them
Choose = Callable[[Rows, int], GradientThresholds]


@dataclass(frozen=True)
class CandidateBank:
    """Candidates and the time of each label in each sentence.

    The labels of a trial depend on nothing but the trial and the candidate, so one encoding of all trials serves every
    fold; a fold scores the candidates on its own training trials.
    """

    thresholds: GradientThresholds  # [candidate, axis, 4]
    times: Int[np.ndarray, "candidate recording sentence 6 25"]  # int32, samples
    y: Int[np.ndarray, "recording sentence"]  # int32
    classes: int

    @staticmethod
    def make(data: CalibrationData, config: EncoderConfig, thresholds: Thresholds, chunk: int = 256) -> CandidateBank:
        """Encode all trials with all candidates ``[candidate, axis, 4]``, ``chunk`` of them at once.

        Raises:
            InputError: a candidate is not ordered, positive and finite.
        """
        limits = np.asarray(limits_of(thresholds))
        validate(limits)
        parts = []
        for start in range(0, len(limits), chunk):
            some = jnp.asarray(limits[start : start + chunk], data.windows.slope.dtype)
            parts.append(np.asarray(label_durations(config, some, data.windows, jnp.asarray(data.edges))))
        return CandidateBank(GradientThresholds(limits), np.concatenate(parts), data.y, len(data.classes))

    def rank(self, rows: Rows, objective: Objective) -> Rows:
        """Candidates from the best to the worst on the recordings ``rows``; ties go to the lowest index."""
        values = scores(self.times[:, rows], self.y[rows], self.classes)
        value = (values.astype(np.float64) @ objective.weights()).round(6)
        return np.argsort(-value, kind="stable").astype(np.int64)

    def chooser(self, objective: Objective, top: int) -> Choose:
        """The ``top`` best candidates."""
        limits = np.asarray(self.thresholds.limits)
        return lambda rows, seed: GradientThresholds(limits[self.rank(rows, objective)[:top]])


def calibrated_svm(
    recordings: Recordings,
    items: LabelledIntervals,
    config: EncoderConfig,
    choose: Choose,
    grid: Grid,
    spec: FeatureSpec,
) -> Estimator:
    """Estimator: chooses thresholds on its training trials, encodes all trials with them, trains and selects an SVM.

    Args:
        recordings: the data set.
        items: sentences of one arm.
        config: static configuration of the encoder.
        choose: see :data:`Choose`.
        grid: hyper-parameters of the SVM; they are selected together with one of the thresholds.
        spec: features of the labels.
    """
    (spans,) = items.intervals
    order = list(dict.fromkeys(spans.recording.tolist()))
    rows, place = np.unique(spans.recording, return_inverse=True)
    wrench, length = recordings.wrench[rows], recordings.length[rows]
    local = replace(items, intervals=(replace(spans, recording=place),), recordings=len(rows))

    @cache  # folds often choose the same thresholds, and encoding is the longest part
    def features(limits: bytes) -> Features:
        thresholds = GradientThresholds(np.frombuffer(limits).reshape(-1, 4))
        return extract_features(encode_batch(config, thresholds, wrench, length), local, spec)

    def predict(train: Rows, test: Rows, seed: int) -> Prediction:
        mine = np.array(sorted({order.index(r) for r in spans.recording[train].tolist()}), np.int64)
        limits = np.asarray(choose(mine, seed).limits, np.float64)
        described = {str(k): features(one.tobytes()) for k, one in enumerate(limits)}
        matrices = {name: x.values for name, x in described.items()}
        weights = {name: x.weights(spec) for name, x in described.items()}
        predicted, chosen = nested_svm(matrices, items.y, items.trial, grid, weights)(train, test, seed)
        return predicted, {**chosen, "limits": limits[int(chosen["features"])].tolist()}

    return predict


def fixed(thresholds: Thresholds) -> Choose:
    """No calibration: the same thresholds ``[axis, 4]`` or ``[n, axis, 4]`` in every fold.

    Raises:
        InputError: they are not ordered, positive and finite.
    """
    limits = np.asarray(limits_of(thresholds), np.float64)
    limits = limits.reshape(-1, *limits.shape[-2:])
    validate(limits)
    return lambda rows, seed: GradientThresholds(limits)
