"""Values of files as words: how a number is written, which words are one, and which mean an outcome."""

from __future__ import annotations

import re
from collections.abc import Iterable
from collections.abc import Mapping as AnyMapping
from dataclasses import replace
from typing import Any

import numpy as np

from rcbht_jax.io.importing.mapping import Track

OUTCOMES = dict.fromkeys(("success", "1", "true", "ok", "pass", "passed", "io", "i.o."), "success") | dict.fromkeys(
    ("failure", "0", "false", "nok", "ng", "fail", "failed", "nio", "n.i.o."), "failure"
)


def text(value: Any) -> str:
    """A value as text: whole numbers without a point, NaN as ""."""
    if isinstance(value, str):
        return str(value)
    number = float(value)
    if np.isnan(number):
        return ""
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)


def of_numbers(track: Track) -> Track:
    """A track whose words and labels to ignore are also as :func:`text` writes their numbers: 1 for 1.0 and 01.

    >>> of_numbers(Track("phase", "p", words={"1.0": "reach"}, ignore=("02", "none"))).ignore
    ('02', 'none', '2', 'none')
    """
    ignore = (*track.ignore, *map(_number, track.ignore))
    return replace(track, words=words_of_numbers(track.words), ignore=ignore)


def words_of_numbers(words: AnyMapping[str, str]) -> dict[str, str]:
    """Words with their meanings, those that are numbers also as :func:`text` writes them.

    >>> words_of_numbers({"1.0": "reach", "idle": "free"})
    {'1': 'reach', 'idle': 'free', '1.0': 'reach'}
    """
    return {_number(word): meaning for word, meaning in words.items()} | dict(words)


def _number(word: str) -> str:
    """A finite number as :func:`text` writes it; any other word as it is."""
    try:
        return text(float(word)) if np.isfinite(float(word)) else word
    except ValueError:
        return word


def is_outcome(name: str, values: Iterable[Any]) -> bool:
    """Whether a column of that name and with these values states the outcome.

    >>> is_outcome("success", [1.0, 0.0]), is_outcome("success", ["partly"])
    (True, False)
    """
    return name in ("success", "outcome") and {text(value).lower() for value in values} <= set(OUTCOMES)


def in_order(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names by the numbers in them.

    >>> sorted(["run10", "run2"], key=in_order)
    ['run2', 'run10']
    """
    parts = re.findall(r"\d+|\D|\Z", name, re.ASCII)
    return [(0, int(part[:18]), part) if part.isascii() and part.isdecimal() else (1, 0, part) for part in parts]
