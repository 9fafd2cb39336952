"""Evaluation of label features on a task: nested, grouped, repeated, with baselines on the same folds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.values import expect
from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError
from rcbht_jax.features import Features, FeatureSpec
from rcbht_jax.learning import validation
from rcbht_jax.learning.class_groups import fewest_groups, groups_by, learnable, naming_left_out
from rcbht_jax.learning.confounds import confounds
from rcbht_jax.learning.svm import Grid, Split, Weight, grouped_folds
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, TrackBatches, extract_features, labelled_intervals
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import LabelTracks, Recordings

FOLDS = 5


@dataclass(frozen=True)
class EvaluationProtocol:
    """How to measure: repeated grouped k-fold, or training and testing on different sessions.

    Raises:
        InputError: sessions for one side only, a session on both sides, sessions and a group, no repeats, or a value of
            another type.
    """

    folds: int | None = None  # None = 5, or the number of trials (groups) of the rarest class, if it is smaller
    repeats: int = 10
    seed: int = 0
    grid: Grid = field(default_factory=Grid)
    train_on: tuple[str, ...] = ()  # sessions; empty = cross-validation
    test_on: tuple[str, ...] = ()
    group: str = "trial"  # column whose groups are never split by folds: an operator, a part, a day

    def __post_init__(self) -> None:
        make_plain(self)
        if bool(self.train_on) != bool(self.test_on):
            raise InputError("train-on and test-on belong together; give the sessions of both or of neither.")
        if set(self.train_on) & set(self.test_on):
            both = ", ".join(sorted(set(self.train_on) & set(self.test_on)))
            raise InputError(f"session {both} is in train-on and in test-on; a session can be in one only.")
        if self.train_on and self.group != "trial":
            raise InputError(f"folds are grouped by {self.group}, but sessions are trained and tested on; give one.")
        if self.repeats < 1:
            raise InputError(f"{self.repeats} repeats were asked for; at least one is needed.")


@dataclass(frozen=True)
class EvaluationResult:
    """A score with its baselines, protocol and provenance; ``to_json`` gives plain JSON values."""

    task: dict[str, Any]
    protocol: dict[str, Any]
    classes: tuple[str, ...]
    items: dict[str, int]  # class -> items, where sessions were chosen those of these
    trials: int
    untrained: tuple[str, ...]  # classes that are tested where no training item, of sessions or of a fold, has them
    tested: int  # of the trials, or of the protocol's groups
    dropped: dict[str, int]  # reason -> trials left out; intervals where it begins with "intervals, "
    score: dict[str, Any]  # accuracy and balanced accuracy with limits; min, mean, max over folds
    duration_baseline: dict[str, Any]  # random forest on the length of the interval alone
    majority_baseline: dict[str, Any]  # without limits, as it is fixed by construction
    fold_accuracy: list[list[float]]  # [repeat][fold]
    confusion: list[list[int]]  # [true][predicted], summed over repeats
    chosen: dict[str, int]  # hyper-parameters as one line -> outer folds that chose them
    confounds: str  # sentences about this data; "" = none was found
    provenance: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings."""
        return asdict(self)


# Candidates by name, each the labels of one or several encoders (by name) whose features go side by side.
Grammars = Mapping[str, Mapping[str, LabelTracks] | TrackBatches]


def candidates(
    tracks: LabelTracks | Grammars,
    items: LabelledIntervals,
    features: FeatureSpec | Mapping[str, FeatureSpec],
    count: int | None = None,
) -> dict[str, tuple[Features, Weight]]:
    """Features of all labels by all specifications, in the order given, with the weights of their columns, by name."""
    grammars = {"": tracks} if isinstance(tracks, LabelTracks) else tracks
    specs = {"": features} if isinstance(features, FeatureSpec) else features
    expect("The choice of labels", grammars, Mapping)
    expect("The choice of features", specs, FeatureSpec, Mapping)
    if not grammars or not specs:
        raise InputError("There are no labels or no features to choose from; give at least one of each.")
    described: dict[str, tuple[Features, Weight]] = {}
    for grammar, labels in grammars.items():
        for name, spec in specs.items():
            part = extract_features(labels, items, spec, count)
            described[" ".join(filter(None, (grammar, name)))] = part, part.weights(spec)
    return described


def evaluate(
    recordings: Recordings,
    tracks: LabelTracks | Grammars,
    task: TaskSpec,
    features: FeatureSpec | Mapping[str, FeatureSpec],
    protocol: EvaluationProtocol,
    label_attrs: Mapping[str, Any] | None = None,
    progress: Callable[[int], Any] | None = None,
    splitter: Any = None,
    facts: WrenchFacts | None = None,
) -> EvaluationResult:
    """Score a nested SVM on the features of labels.

    A class that occurs in one trial (group) only cannot be cross-validated: it is left out, and counted, if two others
    remain.

    Args:
        recordings: the data set.
        tracks: its labels, arrays ``[recording, axis, slot]``, or candidates by name; inner folds choose one.
        task: what to classify.
        features: one specification, or several by name, of which the inner folds choose one; ties go to the earlier.
        protocol: how to measure.
        label_attrs: how the labels were made; stored in the result.
        splitter: scikit-learn splitter to use instead of the protocol's folds; it gets the groups of the protocol,
            usually the trials.
        progress: called with 1 after each fold of the SVM.
        facts: facts about the wrenches, if the recordings have no samples.

    Raises:
        InputError: unknown sessions or group, too few trials for the folds, fewer than two classes, a splitter that
            divides a trial, or labels of more or fewer recordings.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = rj.Recordings.example()  # four failures, four successes
        >>> tracks = rj.encode(recordings.wrench, rate=200)
        >>> protocol = EvaluationProtocol(folds=2, repeats=1, grid=Grid(("linear",), (1.0,), inner=2))
        >>> result = evaluate(recordings, tracks, rj.TaskSpec("outcome"), FeatureSpec(("histogram",)), protocol)
        >>> result.score["accuracy"]["mean"], result.majority_baseline["accuracy"]["mean"]
        (1.0, 0.5)
    """
    expect("The protocol", protocol, EvaluationProtocol)
    if protocol.train_on and splitter is not None:
        raise InputError("train_on and test_on divide the trials, and so does a splitter; give one or the other.")
    items = labelled_intervals(recordings, task)
    column = protocol.group
    groups = groups_by(column, recordings, items)
    if not protocol.train_on and splitter is None:
        items, kept = learnable(items, groups, column)
        groups = groups[kept]
    described = candidates(tracks, items, features, len(recordings))
    specs = {"": features} if isinstance(features, FeatureSpec) else features
    facts = facts or WrenchFacts.of(recordings)
    provenance = {
        "version": rcbht_jax.__version__,
        "labels": dict(label_attrs or {}),
        "features": {name: asdict(spec) for name, spec in specs.items()},
        "data_hash": facts.data_hash,
    }
    matrices = {name: part.values for name, (part, _) in described.items()}
    weights = {name: weight for name, (_, weight) in described.items()}
    with naming_left_out(items):
        return score(items, matrices, protocol, asdict(task), provenance, weights, progress, facts, splitter, groups)


def score(
    items: LabelledIntervals,
    matrices: Mapping[str, NDArray[Any]],
    protocol: EvaluationProtocol,
    task: dict[str, Any],
    provenance: dict[str, Any],
    weights: Mapping[str, Weight] | None = None,
    progress: Callable[[int], Any] | None = None,
    facts: WrenchFacts | None = None,
    splitter: Any = None,
    groups: NDArray[Any] | None = None,
) -> EvaluationResult:
    """Score feature matrices ``[item, feature]`` of any origin, and the two baselines, on the same splits.

    ``facts`` are used to find copies; ``groups`` ``[item]``, by default the trials, are never split by folds, nor by
    those in which hyper-parameters are chosen, unless a training part has too few; all other arguments are those of
    :func:`evaluate`.
    """
    groups = items.trial if groups is None else groups
    estimators = {
        "svm": validation.nested_svm(matrices, items.y, groups, protocol.grid, weights, progress, items.trial),
        "duration": validation.forest(items.seconds, items.y),
        "majority": validation.majority(items.y),
    }
    folds = _folds(items, protocol, groups, splitter)
    runs = {name: validation.cross_validate(one, items.y, folds, protocol.seed) for name, one in estimators.items()}
    svm, units = runs["svm"], items.trial if protocol.train_on else groups
    tested = len(np.unique(units[np.concatenate([test for _, test in folds[0]])]))  # a splitter need not test all
    if protocol.train_on:
        summaries = {name: validation.HoldoutScore.of(run, tested).summary() for name, run in runs.items()}
        used = items.take(np.concatenate(folds[0][0]))
    else:
        summaries, used = {name: run.summary(tested) for name, run in runs.items()}, items
    counts = Counter(used.classes[code] for code in used.y.tolist())
    return EvaluationResult(
        task=task,
        protocol=asdict(protocol) | _folds_used(protocol, folds, splitter),
        classes=items.classes,
        items={name: counts[name] for name in items.classes},
        trials=len(np.unique(used.trial)),
        untrained=_untrained(items, [split for repeat in folds for split in repeat]),
        tested=tested,
        dropped=items.dropped,
        score=summaries["svm"],
        duration_baseline=summaries["duration"],
        majority_baseline=validation.without_intervals(summaries["majority"]),
        fold_accuracy=svm.accuracy.tolist(),
        confusion=svm.confusion.tolist(),
        chosen=dict(Counter(_line(choice) for repeat in svm.chosen for choice in repeat).most_common()),
        confounds=" ".join(confounds(used, facts)),
        provenance=provenance,
    )


def _folds(
    items: LabelledIntervals, protocol: EvaluationProtocol, groups: NDArray[Any], splitter: Any
) -> list[list[Split]]:
    """Splits ``[repeat][fold]``: one between sessions, those of scikit-learn's splitter, or repeated folds."""
    if protocol.train_on:
        return [[_split(items, protocol)]]
    if splitter is not None:
        return [grouped_folds(items.y, groups, splitter, protocol.seed)]
    number = min(FOLDS, fewest_groups(items.y, groups)) if protocol.folds is None else protocol.folds
    return validation.repeated_folds(items.y, groups, number, protocol.repeats, protocol.seed, protocol.group)


def _folds_used(protocol: EvaluationProtocol, folds: list[list[Split]], splitter: Any) -> dict[str, Any]:
    """Folds and repeats for the result; None where sessions or a splitter take their place."""
    if not protocol.train_on and splitter is None:
        return {"folds": len(folds[0])}
    return {"folds": None, "repeats": None} | ({} if protocol.train_on else {"splitter": repr(splitter)})


def _untrained(items: LabelledIntervals, splits: Sequence[Split]) -> tuple[str, ...]:
    """Classes that some split tests and does not train."""
    missing = {k for train, test in splits for k in np.setdiff1d(items.y[test], items.y[train]).tolist()}
    return tuple(items.classes[k] for k in sorted(missing))


def _split(items: LabelledIntervals, protocol: EvaluationProtocol) -> Split:
    known = set(items.session.tolist())
    missing = (set(protocol.train_on) | set(protocol.test_on)) - known
    if missing:
        raise InputError(
            f"session {', '.join(sorted(missing))} has no interval in this task; there are {', '.join(sorted(known))}."
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
