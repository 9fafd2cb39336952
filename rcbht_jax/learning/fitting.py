"""The final classifier of a task: fitted on all its intervals, with hyper-parameters that folds of these select."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from rcbht_jax._util.values import expect
from rcbht_jax.features import FeatureSpec
from rcbht_jax.learning.class_groups import groups_by, inner_groups, learnable, naming_left_out, some_items
from rcbht_jax.learning.evaluation import Grammars, candidates
from rcbht_jax.learning.model_io import TrainedModel
from rcbht_jax.learning.svm import Grid, fit, select
from rcbht_jax.learning.tasks import TaskSpec, TrackBatches, labelled_intervals, track_of
from rcbht_jax.learning.wrench_facts import WrenchFacts
from rcbht_jax.types import LabelTracks, Recordings


def train(
    recordings: Recordings,
    tracks: LabelTracks | Grammars,
    task: TaskSpec,
    features: FeatureSpec,
    grid: Grid | None = None,
    encoder: Mapping[str, Any] | None = None,
    seed: int = 0,
    progress: Callable[[int], Any] | None = None,
    facts: WrenchFacts | None = None,
    group: str = "trial",
) -> TrainedModel:
    """Fit on all intervals of a task, with hyper-parameters selected by grouped cross-validation on these intervals.

    Of more than 5000 intervals the selection takes whole trials with about as many (``extra["chosen_on"]``), since its
    time and memory grow with their square. A class that occurs in one trial only is left out, and counted, if two
    others remain.

    Args:
        recordings: the data set.
        tracks: its labels, or candidates by name, of which one is selected as well.
        task: what to classify.
        features: which features.
        grid: what to select from; None = everything.
        encoder: how the labels were made, including thresholds (JSON values), by the names of the labels if candidates
            are given; stored in the model, by name only if the selected candidate has several encoders.
        seed: seed of the folds.
        progress: called with 1 after each inner fold of the choice of hyper-parameters.
        facts: facts about the wrenches, if the recordings have no samples.
        group: column whose groups the folds of the selection keep together, such as an operator; by trials where too
            few classes occur in two groups.

    Raises:
        InputError: fewer than two classes in two trials or more, labels of more or fewer recordings, a seed that is
            negative or has more than 32 bits, or an unknown group.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = rj.Recordings.example()  # four failures, four successes
        >>> tracks = rj.encode(recordings.wrench, rate=200)
        >>> grid = Grid(("linear",), (1.0,), inner=2)
        >>> train(recordings, tracks, rj.TaskSpec("outcome"), FeatureSpec(("histogram",)), grid).svm.classes
        ('failure', 'success')
    """
    items, _ = learnable(labelled_intervals(recordings, task))
    facts = facts or WrenchFacts.of(recordings)
    described = candidates(tracks, items, features, len(recordings))
    matrices = {name: part.values for name, (part, _) in described.items()}
    weights = {name: weight for name, (_, weight) in described.items()}
    grid = Grid() if grid is None else grid
    expect("The grid", grid, Grid)
    apart = inner_groups(items.y, groups_by(group, recordings, items), items.trial)
    rows = some_items(items.y, apart, items.trial, seed)
    with naming_left_out(items):
        some = {name: x[rows] for name, x in matrices.items()}
        chosen = select(some, items.y[rows], apart[rows], grid, seed, weights, progress)
    best, weight = described[chosen.features]
    svm = fit(best.values, items.y, items.classes, chosen, weight)
    how = dict(encoder or {})
    if not isinstance(tracks, LabelTracks):
        grammar = tracks[chosen.features]
        names = grammar.names if isinstance(grammar, TrackBatches) else grammar
        used = {name: how.get(name, {}) for name in names}
        how = used if len(used) > 1 else next(iter(used.values()))
    return TrainedModel(
        svm=svm,
        feature_spec=features,
        feature_names=best.names,
        task={**asdict(task), "whole": not track_of(recordings, task)},  # new data need not have the column
        encoder=how,
        data_hash=facts.data_hash,
        extra={
            "items": len(items.y), "trials": len(np.unique(items.trial)), "dropped": items.dropped, "seed": seed,
            "group": group,
            **({"chosen_on": len(rows)} if len(rows) < len(items.y) else {}),
        },
        digests=facts.digests[np.unique(np.concatenate([part.recording for part in items.intervals]))],
        axes=recordings.axes,
        units=recordings.units,
    )  # fmt: skip
