"""Evaluation of label features on a task: nested, grouped, repeated, beside baselines on the same folds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.digest import data_hash
from rcbht_jax.errors import InputError
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.learning import validation
from rcbht_jax.learning.model_io import TrainedModel
from rcbht_jax.learning.svm import Grid, Split, Weight, fit, select
from rcbht_jax.learning.tasks import CONFOUNDS, LabelledIntervals, TaskSpec, extract_features, labelled_intervals
from rcbht_jax.types import LabelTracks, Recordings


@dataclass(frozen=True)
class EvaluationProtocol:
    """How to measure: repeated grouped k-fold, or training and testing on different sessions."""

    folds: int = 5
    repeats: int = 10
    seed: int = 0
    grid: Grid = field(default_factory=Grid)
    train_on: tuple[str, ...] = ()  # sessions; empty = cross-validation
    test_on: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.train_on) != bool(self.test_on):
            raise InputError("train-on and test-on belong together; give the sessions of both or of neither.")
        if set(self.train_on) & set(self.test_on):
            both = ", ".join(sorted(set(self.train_on) & set(self.test_on)))
            raise InputError(f"session {both} is in train-on and in test-on; a session can be in one only.")
        if self.repeats < 1:
            raise InputError(f"{self.repeats} repeats were asked for; at least one is needed.")


@dataclass(frozen=True)
class EvaluationResult:
    """Everything needed to read a score, compare it and repeat it; ``to_json`` gives plain JSON values."""

    task: dict[str, Any]
    protocol: dict[str, Any]
    classes: tuple[str, ...]
    items: dict[str, int]  # class -> items
    trials: int
    dropped: dict[str, int]  # reason -> trials left out
    score: dict[str, Any]  # accuracy and balanced accuracy with limits; min, mean, max over folds
    duration_baseline: dict[str, Any]  # random forest on the length of the sentence alone
    majority_baseline: dict[str, Any]
    fold_accuracy: list[list[float]]  # [repeat][fold]
    confusion: list[list[int]]  # [true][said], summed over repeats
    chosen: dict[str, int]  # hyper-parameters as one line -> outer folds that chose them
    confounds: str
    provenance: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings."""
        return asdict(self)


# Choices of grammars by name, each the labels of one or several encoders (by name) that are put side by side.
Grammars = Mapping[str, Mapping[str, LabelTracks]]


def candidates(
    tracks: LabelTracks | Grammars, items: LabelledIntervals, features: FeatureSpec | Mapping[str, FeatureSpec]
) -> dict[str, tuple[Features, Weight]]:
    """Every grammar described by every specification, in the order given: features and their weights by name."""
    grammars = {"": tracks} if isinstance(tracks, LabelTracks) else tracks
    specs = {"": features} if isinstance(features, FeatureSpec) else features
    made: dict[str, tuple[Features, Weight]] = {}
    for grammar, labels in grammars.items():
        for name, spec in specs.items():
            found = extract_features(labels, items, spec)
            made[" ".join(filter(None, (grammar, name)))] = found, found.weights(spec)
    return made


def evaluate(
    recordings: Recordings,
    tracks: LabelTracks | Grammars,
    task: TaskSpec,
    features: FeatureSpec | Mapping[str, FeatureSpec],
    protocol: EvaluationProtocol,
    label_attrs: Mapping[str, Any] | None = None,
    progress: Callable[[int], Any] | None = None,
) -> EvaluationResult:
    """Score the labels on a task.

    Args:
        recordings: the data set.
        tracks: its labels, arrays ``[recording, axis, slot]``, or several grammars of which the inner folds choose one.
        task: what to classify.
        features: one specification, or several by name of which the inner folds choose one; ties go to the earlier.
        protocol: how to measure.
        label_attrs: how the labels were made; goes into the result.
        progress: called with 1 after each fold of the SVM.

    Raises:
        InputError: unknown sessions, too few trials for the folds, or fewer than two classes.
    """
    specs = {"": features} if isinstance(features, FeatureSpec) else dict(features)
    items = labelled_intervals(recordings, task)
    made = candidates(tracks, items, features)
    provenance = {
        "version": rcbht_jax.__version__,
        "labels": dict(label_attrs or {}),
        "features": {name: asdict(spec) for name, spec in specs.items()},
        "data_hash": data_hash(recordings),
    }
    matrices = {name: found.values for name, (found, _) in made.items()}
    weights = {name: weight for name, (_, weight) in made.items()}
    return score(items, matrices, protocol, asdict(task), provenance, weights, progress)


def score(
    items: LabelledIntervals,
    matrices: Mapping[str, NDArray[Any]],
    protocol: EvaluationProtocol,
    task: dict[str, Any],
    provenance: dict[str, Any],
    weights: Mapping[str, Weight] | None = None,
    progress: Callable[[int], Any] | None = None,
) -> EvaluationResult:
    """Score feature matrices ``[item, feature]`` of any origin, and the two baselines, on the same splits."""
    learners = {
        "svm": validation.nested_svm(matrices, items.y, items.trial, protocol.grid, weights, progress),
        "duration": validation.forest(items.seconds, items.y),
        "majority": validation.majority(items.y),
    }
    if protocol.train_on:
        split = _split(items, protocol)
        made = {k: validation.holdout_score(x, items.y, items.trial, split, protocol.seed) for k, x in learners.items()}
        fold_accuracy, chosen = [[made["svm"].accuracy]], [made["svm"].chosen]
        tables = {k: (x.summary(), x.confusion) for k, x in made.items()}
    else:
        folds = validation.repeated_folds(items.y, items.trial, protocol.folds, protocol.repeats, protocol.seed)
        runs = {k: validation.cross_validate(x, items.y, folds, protocol.seed) for k, x in learners.items()}
        fold_accuracy = runs["svm"].accuracy.tolist()
        chosen = [choice for repeat in runs["svm"].chosen for choice in repeat]
        tables = {k: (x.summary(), x.confusion) for k, x in runs.items()}
    return EvaluationResult(
        task=task,
        protocol=asdict(protocol),
        classes=items.classes,
        items=dict(zip(items.classes, np.bincount(items.y).tolist(), strict=True)),
        trials=len(np.unique(items.trial)),
        dropped=items.dropped,
        score=tables["svm"][0],
        duration_baseline=tables["duration"][0],
        majority_baseline=tables["majority"][0],
        fold_accuracy=fold_accuracy,
        confusion=tables["svm"][1].tolist(),
        chosen=dict(Counter(_line(c) for c in chosen).most_common()),
        confounds=CONFOUNDS[task["task"]],
        provenance=provenance,
    )


def _split(items: LabelledIntervals, protocol: EvaluationProtocol) -> Split:
    known = set(items.session.tolist())
    missing = (set(protocol.train_on) | set(protocol.test_on)) - known
    if missing:
        raise InputError(
            f"session {', '.join(sorted(missing))} has no sentence in this task; there are {', '.join(sorted(known))}."
        )
    train, test = (np.flatnonzero(np.isin(items.session, s)) for s in (protocol.train_on, protocol.test_on))
    if len(np.unique(items.y[train])) < 2:
        raise InputError(f"the training sessions {', '.join(protocol.train_on)} have only one class.")
    shared = np.intersect1d(items.trial[train], items.trial[test])
    if shared.size:
        raise InputError(f"the trial {shared[0]} is on both sides of the split.")
    return train, test


def _line(choice: dict[str, Any]) -> str:
    name = f"{choice['features']} " if choice["features"] else ""
    scaled = " ranks" if choice["ranks"] else " scaled" if choice["scaling"] else ""
    return f"{name}{choice['kernel']} C={choice['cost']:g}{scaled}"


def train(
    recordings: Recordings,
    tracks: LabelTracks | Grammars,
    task: TaskSpec,
    features: FeatureSpec,
    grid: Grid | None = None,
    encoder: Mapping[str, Any] | None = None,
    seed: int = 0,
    progress: Callable[[int], Any] | None = None,
) -> TrainedModel:
    """Fit on all sentences of a task, with hyper-parameters chosen by grouped cross-validation among them.

    Args:
        recordings: the data set.
        tracks: its labels, or several grammars of which one is chosen as well.
        task: what to classify.
        features: what to make of the labels.
        grid: what to choose from; None = everything.
        encoder: how the labels were made, thresholds included (JSON values), by the names of the labels where
            grammars are given; stored in the model, by name only where the chosen grammar has several encoders.
        seed: of the folds.
        progress: called with 1 after each inner fold of the choice of hyper-parameters.

    Raises:
        InputError: fewer than two classes, or a class with a single trial.
    """
    items = labelled_intervals(recordings, task)
    made = candidates(tracks, items, features)
    matrices = {name: found.values for name, (found, _) in made.items()}
    weights = {name: weight for name, (_, weight) in made.items()}
    chosen = select(matrices, items.y, items.trial, grid or Grid(), seed, weights, progress)
    best, weight = made[chosen.features]
    svm = fit(best.values, items.y, items.classes, chosen, weight)
    how = dict(encoder or {})
    if not isinstance(tracks, LabelTracks):
        used = {name: how.get(name, {}) for name in tracks[chosen.features]}
        how = used if len(used) > 1 else next(iter(used.values()))
    return TrainedModel(
        svm=svm,
        feature_spec=features,
        feature_names=best.names,
        task=asdict(task),
        encoder=how,
        data_hash=data_hash(recordings),
        extra={"items": len(items.y), "trials": len(np.unique(items.trial)), "seed": seed},
    )
