"""Groups, such as trials, in which the classes occur: folds that keep groups together need two of every class."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.learning.task_items import trial_names
from rcbht_jax.learning.tasks import LabelledIntervals
from rcbht_jax.types import Recordings


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
