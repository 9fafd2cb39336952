"""Values of files as words: how a number is written, which words are one, state the rate, or mean an outcome."""

from __future__ import annotations

import re
from collections.abc import Iterable
from collections.abc import Mapping as AnyMapping
from dataclasses import replace
from typing import Any

import numpy as np

from rcbht_jax._util.columns import snake
from rcbht_jax.io.importing.conform import LONGEST, SHORTEST
from rcbht_jax.io.importing.mapping import Track

_RATES = (
    "sample rate", "sampling rate", "samplerate", "sample frequency", "sampling frequency", "abtastrate",
    "abtastfrequenz", "messrate",
)  # fmt: skip
_RATE = ("rate", "fs", "fps", "sr", "frequency")
_PERIOD = (
    "dt", "ts", "period", "sample time", "sampling time", "sampling period", "sample period", "sample interval",
    "abtastzeit",
)  # fmt: skip
_IN = {"hz": 1.0, "khz": 1e3, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_UNIT = re.compile(r"[ \[(]+(k?hz|[muµ]?s)[\])]?$")
_AMOUNT = re.compile(r"\s*(\d+(?:[.,]\d+)?(?:e[+-]?\d+)?)\s*(k?hz|[muµ]?s)?\s*$", re.IGNORECASE)
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


def rate_of(key: str, value: str | float, longer: bool = False) -> float | None:
    """Samples per second, if a name and its value state them, or the time between samples; else None.

    With ``longer``, other words may stand before the name.

    >>> rate_of("samplingRate_Hz", 500.0), rate_of("RDT Sample Rate (kHz)", "0,5", longer=True), rate_of("dt", "2 ms")
    (500.0, 500.0, 500.0)
    >>> rate_of("rate", "fast"), rate_of("speed", 2.0), rate_of("ts", 1.7e9)
    (None, None, None)
    """
    word = snake(key).replace("_", " ").replace("k hz", "khz").strip(" :=")
    unit, amount = _UNIT.search(word), _AMOUNT.match(str(value))
    word = word[: unit.start()] if unit else word
    if not amount or not (word in (*_RATES, *_RATE, *_PERIOD) or (longer and word.endswith(_RATES))):
        return None
    said = (amount[2] or (unit[1] if unit else "")).lower()
    number = float(amount[1].replace(",", ".")) * _IN.get(said, 1.0)
    if said and said.endswith("s") != (word in _PERIOD):  # a rate in s, a period in Hz
        return None
    rate = 1 / number if number and word in _PERIOD else number
    return rate if 1 / LONGEST <= rate <= 1 / SHORTEST else None


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


def plain_number(word: str) -> str:
    """A whole number without zeros before it, as a group of a column of numbers is called; any other word as it is.

    >>> plain_number("007"), plain_number("0"), plain_number("run_007")
    ('7', '0', 'run_007')
    """
    return str(int(word)) if word.isascii() and word.isdecimal() and len(word) < 16 else word
