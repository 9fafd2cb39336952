"""Errors in functions that users write for their assemblies and robots, as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

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
