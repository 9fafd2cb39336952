"""Arms of a data set, which any names may have: their order, the one that is meant where none is named, titles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

BOTH = "both"  # all arms, side by side
UNNAMED = "R"  # the arm of recordings that name none
_TITLES = {"R": "right arm", "L": "left arm", "right": "right arm", "left": "left arm"}


def arms_in(names: Iterable[str]) -> tuple[str, ...]:
    """The arms of recordings, the last name first, so that right is before left.

    >>> arms_in(["L", "R", "L"]), arms_in(["left", "right"]), arms_in([""])
    (('R', 'L'), ('right', 'left'), ('',))
    """
    return tuple(sorted(map(str, set(names)), reverse=True))


def chosen_arms(names: Iterable[str], wanted: str) -> tuple[str, ...]:
    """The arms that a task is about: one as of :func:`chosen_arm`, or all if both are wanted.

    >>> chosen_arms(["left", "right"], ""), chosen_arms(["left", "right"], "both")
    (('right',), ('right', 'left'))
    """
    arms = arms_in(names)
    return arms if wanted == BOTH or not arms else (chosen_arm(arms, wanted),)


def chosen_arm(names: Iterable[str], wanted: str) -> str:
    """The arm whose wrench is meant.

    Args:
        names: of the arms of recordings, at least one.
        wanted: one of them; "" = the first of :func:`arms_in`. An arm alone that has no name is meant by any.

    Example:
        >>> chosen_arm(["left", "right"], "left"), chosen_arm(["left", "right"], ""), chosen_arm([""], "R")
        ('left', 'right', '')
    """
    arms = arms_in(names)
    if wanted and wanted not in arms and any(arms):
        raise InputError(f"The recordings have no arm {wanted!r}, only {', '.join(arms)}; choose one of these (--arm).")
    return wanted if wanted in arms else arms[0]


def common_arm(names: Iterable[str], learned: Iterable[str]) -> str:
    """The arm that all readers of one stream learned, "" = the usual one; other arguments as of :func:`chosen_arm`.

    Args:
        names: of the arms of recordings; those that name none have the arm that any reader learned.
        learned: the arm of each reader, as it was named.

    Raises:
        InputError: they learned different arms, or one that is not there.

    Example:
        >>> common_arm(["left", "right"], ["left"]), common_arm(["left", "right"], ["", "right"])
        ('left', 'right')
        >>> common_arm([UNNAMED], ["left"])
        ''
    """
    named, there = tuple(learned), set(map(str, names))
    unnamed = there == {UNNAMED}
    arms = arms_in(filter(None, named)) if unnamed else arms_in(chosen_arm(there, arm) for arm in named)
    if len(arms) > 1 and any(named):
        raise InputError(
            f"Model, segmenter and monitor read different arms, {' and '.join(arms)}; use those of one arm, or name "
            "one with --arm."
        )
    return "" if unnamed or not any(named) else arms[0]


def learned_arm(learned: str, names: Iterable[str]) -> str:
    """The arm that a file says was learned; "" where all recordings have that of those that name none.

    >>> learned_arm("L", ["L"]), learned_arm("R", ["R", "L"]), learned_arm("R", ["R", "R"])
    ('L', 'R', '')
    """
    return "" if set(map(str, names)) == {UNNAMED} else learned


def rows_of_arm(names: NDArray[np.str_], wanted: str) -> tuple[NDArray[np.int64], list[str]]:
    """The recordings of the arm of :func:`chosen_arm`, and a remark that names it where there are others.

    >>> rows, remarks = rows_of_arm(np.array(["left", "right"]), "")
    >>> rows.tolist(), remarks
    ([1], ['Only the right arm is used.'])
    """
    arms = arms_in(names.tolist())
    arm = chosen_arm(arms, wanted) if arms else ""
    return np.flatnonzero(names == arm), [f"Only the {title_of(arm)} is used."] * (len(arms) > 1)


def title_of(arm: str) -> str:
    """How an arm is called; "" = nothing, since there is one without a name.

    >>> title_of("R"), title_of("ur5"), title_of("")
    ('right arm', 'arm ur5', '')
    """
    return _TITLES.get(arm, f"arm {arm}" if arm else "")


def title_among(arm: str, names: Iterable[str]) -> str:
    """The same in a data set; "" where all recordings have the arm of those that name none: it may be any arm.

    >>> title_among("R", ["R", "R"]), title_among("R", ["R", "L"]), title_among("left", ["left"])
    ('', 'right arm', 'left arm')
    """
    return title_of(learned_arm(arm, names))
