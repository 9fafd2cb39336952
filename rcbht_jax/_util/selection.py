"""Axes and recordings that are chosen by number, by name or by a mask, and groups by any values."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.signals import numbers_of
from rcbht_jax.errors import InputError


def number_of(what: str, wanted: Any, names: Sequence[Any]) -> int:
    """The number of an axis or a recording that is chosen by number or by name.

    >>> number_of("axis", "Fz", ["Fx", "Fy", "Fz"])
    2
    """
    if isinstance(wanted, str) and wanted not in names:
        raise InputError(f"There is no {what} {wanted!r}; there are {', '.join(map(str, names))}.")
    if isinstance(wanted, str) and (count := list(names).count(wanted)) > 1:
        raise InputError(f"{count} of them have the name {wanted}; choose the {what} by its number.")
    if isinstance(wanted, bool) or not isinstance(wanted, str | Integral):
        raise InputError(f"The {what} is {wanted!r}; expected a number or a name.")
    return names.index(wanted) if isinstance(wanted, str) else int(wanted)


def rows_of(rows: ArrayLike, count: int) -> NDArray[np.int64]:
    """Numbers of some of ``count`` recordings, which are given as such or as a mask.

    >>> rows_of([True, False, True], 3).tolist(), rows_of(-1, 3).tolist()
    ([0, 2], [2])
    """
    given = np.atleast_1d(numbers_of(rows, "A list of rows"))
    given = given if given.size else given.astype(np.int64)
    if given.dtype.kind == "b" and given.shape == (count,):
        return np.flatnonzero(given)
    if given.dtype.kind not in "iu" or given.ndim != 1 or not ((-count <= given) & (given < count)).all():
        raise InputError(f"There are {count} recordings; expected numbers of some of them, or a mask of all.")
    return np.arange(count)[given]


def group_numbers(groups: ArrayLike) -> NDArray[np.int64]:
    """The number of each one's group, from 0 in the order of the groups.

    >>> group_numbers(["b", "a", "b"]).tolist()
    [1, 0, 1]
    """
    try:
        return np.unique(np.asarray(groups), return_inverse=True)[1]
    except TypeError:
        raise InputError("Some groups are missing or of another kind; expected numbers, or texts, for all.") from None
