"""Checks of numbers and objects that are data or parameters; what does not pass one is an InputError."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

SINGLE = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)  # sizes with all digits in float32
LARGEST = 1e30  # of a sample in any unit: sums over hours stay far from the largest single precision number


def usable(samples: NDArray[np.floating]) -> bool:
    """Whether all samples are finite numbers, and none is beyond ``LARGEST``.

    >>> usable(np.array([0.0, -5.0])), usable(np.array([0.0, np.nan])), usable(np.array([3e38]))
    (True, False, False)
    """
    return bool((np.abs(samples) <= LARGEST).all())  # NaN compares as false


def check_usable(wrench: NDArray[np.floating], length: NDArray[np.integer]) -> None:
    """Raise an error for recordings ``[recording, time, axis]`` that are shorter than their lengths, or not usable.

    >>> check_usable(np.array([[[1.0], [np.nan]]]), np.array([1]))
    """
    if wrong := [samples for samples in length.tolist() if not 0 <= samples <= wrench.shape[1]]:
        raise InputError(f"A length is {wrong[0]}; expected 0 to {wrench.shape[1]} samples.")
    for index, samples in enumerate(length):
        if not usable(wrench[index, :samples]):
            raise InputError(
                f"Recording {index} holds values that are not finite numbers, or beyond {LARGEST:g}; remove or "
                "interpolate them."
            )


def positive(values: NDArray[np.floating]) -> bool:
    """Whether all values are positive numbers that single precision holds with all its digits.

    >>> positive(np.array([0.1, 70.0])), positive(np.array([0.0])), positive(np.array([1e300]))
    (True, False, False)
    """
    return bool(((values >= SINGLE[0]) & (values <= SINGLE[1])).all())  # NaN compares as false


def number(what: str, value: Any) -> float:
    """A number as a float; text is none, even if it could be read as one.

    >>> number("The rate", np.float32(0.5))
    0.5
    """
    try:
        if not isinstance(value, str | bytes):
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{what} is {str(value)[:40]!r}; expected a number.")


def finite(what: str, value: Any) -> float:
    """A number as a float, neither infinite nor NaN.

    >>> finite("The time", 1)
    1.0
    """
    if not math.isfinite(found := number(what, value)):
        raise InputError(f"{what} is {found}; expected a finite number.")
    return found


def expect(what: str, value: Any, *kinds: type) -> None:
    """Raise an error for an object that is of none of these classes.

    >>> expect("The threshold", 3, int, float)
    """
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{what} is {str(value)[:40]!r}, {type(value).__name__}; expected {names}.")


def same(a: Any, b: Any) -> bool:
    """Equality of two dataclasses: of one class, and equal in every field, arrays in all their elements.

    What is missing in both, NaN, is equal.

    >>> same(np.array([1, np.nan]), np.array([1, np.nan])), same({"a": np.ones(2)}, {"a": np.zeros(2)})
    (True, False)
    """
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return bool(np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == np.asarray(b).dtype.kind == "f"))


class ByValue:
    """Base of dataclasses with arrays, which are equal by :func:`same`; Python's own comparison fails for arrays."""

    def __eq__(self, other: object) -> bool:
        return same(self, other)


class Copyable:
    """Base of streams: ``copy.copy`` and ``copy.deepcopy`` give one that goes on from here without the original."""

    _fixed: ClassVar[tuple[str, ...]] = ()  # attributes whose values never change; copies share them

    def __copy__(self) -> Any:
        return copy.deepcopy(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        own = memo[id(self)] = object.__new__(type(self))
        fixed = (getattr(self, name) for name in self._fixed)
        memo.update((id(value), value) for value in fixed)
        own.__dict__.update((name, copy.deepcopy(value, memo)) for name, value in vars(self).items())
        return own
