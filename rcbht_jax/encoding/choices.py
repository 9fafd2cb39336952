"""Choices as plain values, and ranges of those that every encoder has: counts must fit in 32 bits, also in sums."""

from __future__ import annotations

import math
import types
import typing
from dataclasses import fields
from functools import cache
from typing import Any, Literal

from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import fits
from rcbht_jax.errors import InputError

MAX_WINDOW = 2**20  # samples
MAX_SAMPLES = 2**28  # of any duration


def check_choices(window: int, dt: float, **seconds: float | None) -> None:
    """Refuse a window, a sampling period or a duration that no encoder can count.

    Args:
        window: samples per straight-line fit.
        dt: seconds between samples.
        seconds: durations by name; None = without limit.

    Raises:
        InputError: one of them is out of range.

    Example:
        >>> check_choices(5, 0.005, latency_cap=-1.0)
        Traceback (most recent call last):
        rcbht_jax.errors.InputError: The latency cap is -1.0 s; expected a positive number or none.
    """
    if not 2 <= window <= MAX_WINDOW:
        count = plural(window, "sample")
        raise InputError(f"The window is {count}; a line needs at least 2, and at most {MAX_WINDOW}.")
    if not 0 < dt < math.inf:
        raise InputError(f"The sampling period is {dt} s; expected a positive, finite number.")
    cap = seconds.get("latency_cap")
    if cap is not None and not 0 < cap < math.inf:
        raise InputError(f"The latency cap is {cap} s; expected a positive number or none.")
    for name, value in seconds.items():
        if value is not None and not 0 <= value <= MAX_SAMPLES * dt:
            raise InputError(
                f"{name} is {value} s; expected zero or more, and at most {MAX_SAMPLES} samples of {dt} s."
            )


def make_plain(choices: Any) -> None:
    """Make the fields of a new frozen dataclass values that can be hashed, compared and written as JSON.

    Lists and arrays become tuples, and numbers of NumPy and JAX those of Python.

    Raises:
        InputError: a value is not of the type that the class states for its field.

    Example:
        >>> import numpy as np, rcbht_jax as rj
        >>> rj.EncoderConfig(dt=np.float64(0.25)).dt  # which calls this
        0.25
    """
    hints = _hints(choices.__class__)
    for field in fields(choices):
        value = plain(getattr(choices, field.name))
        if not fits(value, hints[field.name]):
            kind = type(choices).__name__
            raise InputError(f"{field.name} of {kind} is {value!r}; expected {_in_words(hints[field.name])}.")
        object.__setattr__(choices, field.name, value)


_hints = cache(typing.get_type_hints)
_WORDS = {float: "a finite number", int: "a whole number", bool: "True or False", str: "a text", type(None): "None"}


def _in_words(hint: Any) -> str:
    origin, within = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(map(_in_words, within))
    if origin is Literal:
        return " or ".join(map(repr, within))
    if origin is tuple:
        count = "any number" if Ellipsis in within else str(len(within))
        return f"a tuple of {count}, each {_in_words(within[0])}"
    return _WORDS.get(hint) or f"a {hint.__name__}"


def plain(value: Any) -> Any:
    """A value as :func:`make_plain` keeps it.

    >>> import numpy as np
    >>> plain([np.int64(2), np.array([0.5])])
    (2, (0.5,))
    """
    if isinstance(value, list | tuple):
        return tuple(map(plain, value))
    return plain(value.tolist()) if hasattr(value, "tolist") else value
