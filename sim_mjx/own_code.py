"""Errors in what users write for their assemblies and robots, as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from rcbht_jax.errors import InputError


@contextmanager
def own_code(what: str) -> Iterator[None]:
    """Say in one sentence what a user's function raised.

    Args:
        what: the function, as a sentence begins.

    Raises:
        InputError: anything was raised.

    >>> with own_code("draw of key"):
    ...     1 / 0
    Traceback (most recent call last):
    rcbht_jax.errors.InputError: draw of key ends in ZeroDivisionError: division by zero.
    """
    try:
        yield
    except InputError:  # its message already says what is wrong
        raise
    except Exception as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        raise InputError(f"{what} ends in {type(error).__name__}: {reason}.") from error


def finite(values: Any, *shape: int) -> bool:
    """Whether values that a user gave are finite real numbers of a shape.

    Args:
        values: anything.
        shape: () = one number, -1 = any length.

    >>> finite(0.5), finite((0.5, 0.0, 0.1), 3), finite((0.5, "0"), 2), finite(None), finite([1, 2], -1)
    (True, True, False, False, True)
    """
    try:
        array = np.asarray(values)
    except ValueError:  # rows of unequal lengths
        return False
    fits = len(array.shape) == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    return fits and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())


def whole(value: Any, least: int) -> bool:
    """Whether a value that a user gave is a whole number, no truth value, and large enough.

    Args:
        value: anything. least: the smallest number that is large enough.

    >>> whole(5, 1), whole(np.int64(5), 1), whole(0, 1), whole(5.0, 1), whole(True, 1)
    (True, True, False, False, False)
    """
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= least)


def two_numbers(name: str, value: Any) -> tuple[float, float]:
    """The two numbers of a range that a user gave.

    Args:
        name: of the range.
        value: anything.

    Raises:
        InputError: it is no pair of numbers.

    >>> two_numbers("friction", [0.1, 0.2])
    (0.1, 0.2)
    """
    if not finite(value, 2):
        raise InputError(f"The range of {name} is {value}; expected two numbers, the lowest and the highest.")
    return float(value[0]), float(value[1])


def with_tuples(thing: Any) -> None:
    """Make the lists and arrays of a frozen dataclass tuples, so that it can be hashed; for its ``__post_init__``."""
    for name, value in vars(thing).items():
        plain = value.tolist() if isinstance(value, np.ndarray) else value
        object.__setattr__(thing, name, tuple(plain) if isinstance(plain, list) else plain)
