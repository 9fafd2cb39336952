"""Classes that occur in one trial only: no fold can both train on them and test them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import INTERVALS, left_out
from rcbht_jax.learning.class_groups import TooFewTrials, groups_of_classes
from rcbht_jax.learning.task_items import leave_out
from rcbht_jax.learning.tasks import LabelledIntervals


def learnable(
    items: LabelledIntervals, groups: NDArray[Any] | None = None, group: str = "trial"
) -> tuple[LabelledIntervals, NDArray[np.bool_]]:
    """The items of classes that occur in two groups or more, as folds need them, and which these are.

    Trials without any other class are counted as left out, elsewhere the intervals. If fewer than two classes remain,
    all items do.

    Args:
        items: of a task.
        groups: ``[item]`` that folds do not split; None = the trials.
        group: what a group is called.

    Example:
        >>> from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
        >>> from rcbht_jax.types import Recordings
        >>> names = ["peg", "peg", "clip", "clip", "plug"]
        >>> recordings = Recordings.from_arrays(np.zeros((5, 400, 6)), part=names)
        >>> items, kept = learnable(labelled_intervals(recordings, TaskSpec("part")))
        >>> items.classes, items.y.tolist(), items.dropped
        (('clip', 'peg'), [1, 1, 0, 0], {'class in one trial only: plug': 1})
    """
    groups = items.trial if groups is None else groups
    counts = groups_of_classes(items.y, groups, range(len(items.classes)))
    if (counts > 1).all() or (counts > 1).sum() < 2:
        return items, np.ones(len(items.y), bool)
    kept = (counts > 1)[items.y]
    few = [items.classes[code] for code in np.flatnonzero(counts < 2)]
    reason = f"class in one {group} only: {', '.join(few[:5])}" + (", ..." if len(few) > 5 else "")
    gone, dropped = ~np.isin(items.trial, items.trial[kept]), Counter(items.dropped)
    leave_out(dropped, reason, len(np.unique(items.trial[gone])))
    leave_out(dropped, INTERVALS + reason, int((~kept & ~gone).sum()))
    return replace(items.take(kept), dropped=dict(dropped)), kept


@contextmanager
def naming_left_out(items: LabelledIntervals) -> Iterator[None]:
    """Add what a task left out to the error that too few trials are there: these may be the ones that are missing."""
    try:
        yield
    except TooFewTrials as error:
        raise TooFewTrials(f"{error}{left_out(items.dropped)}") from None
