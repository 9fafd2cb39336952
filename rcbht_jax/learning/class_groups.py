"""Groups, such as trials, in which the classes occur: folds that keep groups together need two of every class."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray


def groups_of_classes(y: NDArray[Any], groups: NDArray[Any], classes: Iterable[Any]) -> NDArray[np.int64]:
    """How many groups ``[class]`` have items of each of ``classes``, from the class and the group of every ``[item]``.

    >>> groups_of_classes(np.array([0, 0, 2]), np.array(["a", "b", "b"]), range(3)).tolist()
    [2, 0, 1]
    """
    return np.array([len(np.unique(groups[y == one])) for one in classes], np.int64)


def fewest_groups(y: NDArray[Any], groups: NDArray[Any]) -> int:
    """Number of groups of the class that has the fewest."""
    return int(groups_of_classes(y, groups, np.unique(y)).min())
