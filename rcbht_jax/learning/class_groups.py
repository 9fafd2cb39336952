"""Groups, such as trials, in which the classes occur: folds that keep groups together need two of every class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import INTERVALS, left_out
from rcbht_jax._util.selection import group_numbers
from rcbht_jax.errors import InputError
from rcbht_jax.learning.task_items import leave_out, trial_names
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.types import Recordings

LARGEST = 5000  # items on which hyper-parameters are chosen: each fit takes their square in memory, and more in time
SEEDS = 2**32  # that scikit-learn takes
_FOLDED = 5  # groups of every class that are among them, for the folds
_DIVISIONS = 200  # that are tried: where any trains all classes, one of the first dozen did
Split = tuple[NDArray[np.int64], NDArray[np.int64]]  # rows to train on, rows to test on


class TooFewTrials(InputError):
    """A class is in too few trials, or other groups, to be trained on and tested."""


def check_seed(seed: Any) -> None:
    """Refuse a number that scikit-learn takes for no seed.

    >>> check_seed(0)

    Raises:
        InputError: it is negative, or has more than 32 bits.
    """
    if isinstance(seed, int | np.integer) and not 0 <= seed < SEEDS:
        raise InputError(f"The seed is {seed}; expected 0 to {SEEDS - 1}.")


def groups_of_classes(y: NDArray[Any], groups: NDArray[Any], classes: Iterable[Any]) -> NDArray[np.int64]:
    """How many groups ``[class]`` have items of each of ``classes``, from the class and the group of every ``[item]``.

    >>> groups_of_classes(np.array([0, 0, 2]), np.array(["a", "b", "b"]), range(3)).tolist()
    [2, 0, 1]
    """
    return np.array([len(np.unique(groups[y == one])) for one in classes], np.int64)


def groups_by(column: str, recordings: Recordings, items: LabelledIntervals) -> NDArray[Any]:
    """Group ``[item]`` of labelled intervals by a column of their recordings, or by their trial.

    Raises:
        InputError: there is no such column.
    """
    return items.trial if column == "trial" else recordings.column(column)[items.intervals[0].recording]


def column_groups(column: str, recordings: Recordings) -> NDArray[Any]:
    """Group ``[recording]`` by a column; trials have their source before them where two sources use one name.

    >>> two = Recordings.from_arrays(np.zeros((2, 9, 6)), trial=["one", "one"], source=["a", "b"])
    >>> column_groups("trial", two).tolist(), column_groups("session", two).tolist()
    (['a/one', 'b/one'], ['1', '1'])

    Raises:
        InputError: there is no such column.
    """
    return trial_names(recordings, np.arange(len(recordings))) if column == "trial" else recordings.column(column)


def inner_groups(y: NDArray[Any], groups: NDArray[Any], trials: NDArray[Any]) -> NDArray[Any]:
    """What the folds of a selection keep together: the groups, or trials where fewer than two classes have two groups.

    >>> y, trials = np.array([0, 0, 1, 1]), np.arange(4)
    >>> [inner_groups(y, np.array(groups), trials).tolist() for groups in (list("abab"), list("abcc"))]
    [['a', 'b', 'a', 'b'], [0, 1, 2, 3]]
    """
    return groups if (groups_of_classes(y, groups, np.unique(y)) > 1).sum() >= 2 else trials


def fewest_groups(y: NDArray[Any], groups: NDArray[Any]) -> int:
    """Number of groups of the class that has the fewest."""
    return int(groups_of_classes(y, groups, np.unique(y)).min())


def some_items(
    y: NDArray[Any],
    groups: NDArray[Any],
    trials: NDArray[Any],
    seed: int,
    most: int = LARGEST,
    size: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Rows of whole trials in a seeded order, as many as come to at most so many items; all rows if these are no more.

    The first five groups of every class are among them, with one trial each. Where these have more items, an equal
    share of every class in every trial is taken, evenly spaced and one item at least.

    Args:
        y: class ``[item]``.
        groups: of each ``[item]``, which consist of trials.
        trials: of each ``[item]``.
        seed: of the order.
        most: number of items.
        size: for how many items each counts ``[item]``; None = one.

    Example:
        >>> y, trials = np.tile([0, 1], 500), np.repeat(np.arange(500), 2)
        >>> rows = some_items(y, trials, trials, seed=0, most=100)
        >>> len(rows), np.bincount(y[rows]).tolist(), len(np.unique(trials[rows]))
        (100, [50, 50], 50)
    """
    check_seed(seed)
    size = np.ones(len(y), np.int64) if size is None else size
    if size.sum() <= most:
        return np.arange(len(y))
    number, rng = group_numbers(trials), np.random.default_rng(seed)
    place = rng.permutation(number.max() + 1)[number]  # of the item's trial in the order
    for one in np.unique(y):
        rows = np.flatnonzero(y == one)[np.argsort(place[y == one], kind="stable")]
        _, first = np.unique(group_numbers(groups[rows]), return_index=True)
        place[np.isin(number, number[rows[np.sort(first)[:_FOLDED]]])] = -1
    total = np.bincount(place + 1, size)  # those of place -1, then each trial's
    rows = np.flatnonzero((np.cumsum(total) <= most)[place + 1] | (place < 0))
    whole = int(size[rows].sum())
    cell = group_numbers(np.unique(y[rows], return_inverse=True)[1] * len(y) + number[rows])
    order, count = np.argsort(cell, kind="stable"), np.bincount(cell)
    kept, before = -(-count * min(most, whole) // whole), np.cumsum(count) - count  # of each cell
    step = np.arange(len(rows)) - before[cell[order]]  # from 0 within its cell
    kept, count = kept[cell[order]], count[cell[order]]
    return np.sort(rows[order[(step + 1) * kept // count > step * kept // count]])


def training_all(splits: list[Split], y: NDArray[Any], groups: NDArray[Any], seed: int) -> list[Split]:
    """Folds all of which train every class: these, or else as many of the groups in a seeded order, if there are such.

    Stratified folds have similar numbers of items, for which all groups of a class may come into one of them.

    Args:
        splits: folds.
        y: class ``[item]``.
        groups: of each ``[item]``.
        seed: of the order.

    Example:
        >>> y, trials = np.array([0, 1, 0, 1, 0, 0]), np.array([0, 0, 1, 1, 2, 3])
        >>> both = np.isin(trials, [0, 1])  # the trials with class 1
        >>> splits = [(np.flatnonzero(~both), np.flatnonzero(both)), (np.flatnonzero(both), np.flatnonzero(~both))]
        >>> [np.unique(y[train]).tolist() for train, _ in training_all(splits, y, trials, seed=0)]
        [[0, 1], [0, 1]]
    """
    classes, code = np.unique(y, return_inverse=True)
    if all(len(np.unique(code[train])) == len(classes) for train, _ in splits):
        return splits
    number, folds = group_numbers(groups), range(len(splits))
    has = np.zeros((number.max() + 1, len(classes)), bool)  # [group, class]
    has[number, code] = True
    rng = np.random.default_rng(seed)
    for tried in range(_DIVISIONS):  # first into equal numbers of groups
        equal = tried < _DIVISIONS // 2
        fold = rng.permutation(len(has)) % len(splits) if equal else rng.integers(len(splits), size=len(has))
        if all((fold == held).any() and has[fold != held].any(0).all() for held in folds):
            return [(np.flatnonzero(fold[number] != held), np.flatnonzero(fold[number] == held)) for held in folds]
    return splits


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
