"""Times written as text: ISO 8601, a time of day with or without a date before it, minutes and seconds, or 0.5 sec."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.columns import SECONDS, UNITS

DAY, NOON = 86400.0, 12
_ISO = re.compile(r"\d{4}-\d{2}(-\d{2}([T ][\d:.,]+\s*(Z|UTC|GMT|[+-][\d:]+)?(\[[\w/+-]+\])?)?)?$")
_ZONE = re.compile(r"\s*(?:Z|UTC|GMT|([+-])(\d{2})(?::?(\d{2}))?)(?:\[[\w/+-]+\])?$")  # and as Java names it
_CLOCK = re.compile(
    r"(?:^|[ T])(\d{1,2}):([0-5]?\d):([0-5]?\d(?:[.,]\d+|:\d{3}|:\d{6})?)(?:\s*([AP])\.?M\.?)?$", re.IGNORECASE
)
# 20240501T120000.5, 2024-05-01_12-00-00.5, 2024/05/01/12:00:00.5, as names of files and some tools have them
_DATED = re.compile(
    r"(\d{4})([-/.]?)([01]\d)\2([0-3]\d)[ T_/-]([0-2]\d)([-:]?)([0-5]\d)\6([0-5]\d)((?:[.,]\d+)?)"
    r"\s?(Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)?$"
)
_AMOUNT = re.compile(r"([+-]?\d+(?:[.,]\d+)?)\s*([a-zµμ]+)$", re.IGNORECASE)  # 0.5 sec, as MATLAB writes durations
_MINUTES = re.compile(r"(\d+):([0-5]\d[.,]\d+)$")


def seconds_of(texts: Sequence[str]) -> Float[np.ndarray, " row"]:
    """Seconds since the first of these times; NaN where a text is empty.

    Dates are read where they are ISO 8601 (the order of day and month is known), with their offsets from UTC. Of other
    dates only the time of day counts: where it steps back by more than half a day, a day has passed.

    >>> seconds_of(["2024-05-01T23:59:59.5", "2024-05-02T00:00:01"]).tolist()
    [0.0, 1.5]
    >>> seconds_of(["5/1/2024 11:59:59.5 PM", "5/2/2024 12:00:01 AM"]).tolist()
    [0.0, 1.5]

    Raises:
        ValueError: a text that is no such time.
    """
    stripped = np.array([text.strip() for text in texts], np.str_)
    out, known = np.full(len(stripped), np.nan), stripped != ""
    filled = stripped[known].tolist()
    if not filled:
        return out
    if (amounts := _amounts(filled)) is not None:
        out[known] = amounts - amounts[0]
        return out
    if (dated := _dated(filled)) is not None:
        dates, offsets = dated
        out[known] = (dates - dates[0]).astype(np.float64) * 1e-9 - (offsets - offsets[0])
        return out
    of_day = np.array(list(map(_of_day, filled)))
    steps = np.diff(of_day, prepend=of_day[0])
    days = (steps < -DAY / 2).cumsum() - (steps > DAY / 2).cumsum()
    out[known] = of_day - of_day[0] + DAY * days
    return out


def since_epoch(texts: Sequence[str]) -> Float[np.ndarray, " row"]:
    """Seconds of times by themselves: since 1970 where they have dates as ISO 8601, else since midnight; NaN: empty.

    >>> since_epoch(["1970-01-02T00:00:00.5", ""]).tolist(), since_epoch(["00:01:00.5", "2 min"]).tolist()
    ([86400.5, nan], [60.5, 120.0])

    Raises:
        ValueError: a text that is no such time.
    """
    return np.array([_alone(text.strip()) if text.strip() else np.nan for text in texts], np.float64)


def first_second(texts: Sequence[str]) -> float:
    """The time from which :func:`seconds_of` counts, as :func:`since_epoch` has it; 0 = there is none.

    >>> first_second(["", "00:01:00.5"]), first_second([])
    (60.5, 0.0)
    """
    first = next((text for text in texts if text.strip()), "")
    return float(since_epoch([first])[0]) if first else 0.0


def no_time(texts: Sequence[str]) -> str:
    """The end of a sentence about the first text that is no time, else about the first.

    >>> no_time(["10:00:00", "noon"])
    "'noon', which is not a time; write 2026-05-01T12:00:00.5 or numbers, or give --source-rate, which replaces them."
    """
    wrong = next((text for text in texts if not is_time(text)), texts[0])
    how = "write 2026-05-01T12:00:00.5 or numbers, or give --source-rate, which replaces them."
    return f"{wrong!r}, which is not a time; {how}"


def is_time(text: str) -> bool:
    """Whether :func:`seconds_of` reads a text."""
    try:
        seconds_of([text])
    except ValueError:
        return False
    return True


def _alone(text: str) -> float:
    if (dated := _dated([text])) is not None:
        return float(dated[0][0].astype(np.int64)) * 1e-9 - float(dated[1][0])
    amounts = _amounts([text])
    return float(amounts[0]) if amounts is not None else _of_day(text)


def _amounts(texts: Sequence[str]) -> NDArray[np.float64] | None:
    """Seconds of numbers with units of time; None = they are others."""
    if not _AMOUNT.match(texts[0]):
        return None
    found = [match.groups() for match in map(_AMOUNT.match, texts) if match]
    units = [SECONDS.get(UNITS.get(unit.lower(), ""), 0.0) for _, unit in found]
    if len(found) < len(texts) or 0.0 in units:
        return None
    return np.array([float(number.replace(",", ".")) for number, _ in found]) * units


def _dated(texts: Sequence[str]) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """Local times with dates as ISO 8601 has them, or nearly so, and their offsets from UTC, s; None = they are others.

    Raises:
        ValueError: a date that does not exist.
    """
    if not all(map(_ISO.match, texts)):
        found = [match.groups("") for match in map(_DATED.match, texts) if match]
        if len(found) < len(texts):
            return None
        texts = [f"{year}-{month}-{day}T{hour}:{minute}:{second}{rest}{zone}"
                 for year, _, month, day, hour, _, minute, second, rest, zone in found]  # fmt: skip
    times, offsets = zip(*(_local(text) if ":" in text else (text, 0) for text in texts), strict=True)
    return np.array(times, "datetime64[ns]"), np.array(offsets, np.int64)


def _local(text: str) -> tuple[str, int]:
    """A time without its zone, as NumPy reads it, and the offset of the zone from UTC, s."""
    zone = _ZONE.search(text)
    offset = 3600 * int(zone[2]) + 60 * int(zone[3] or 0) if zone and zone[1] else 0
    return _ZONE.sub("", text).replace(",", "."), -offset if zone and zone[1] == "-" else offset


def _of_day(text: str) -> float:
    if minutes := _MINUTES.match(text):
        return int(minutes[1]) * 60 + float(minutes[2].replace(",", "."))
    found = _CLOCK.search(text)
    if not found:
        raise ValueError(f"{text!r} is not a time")
    hour, half = int(found[1]), (found[4] or "").upper()
    if hour >= 24 or (half and not 1 <= hour <= NOON):
        raise ValueError(f"{text!r} is not a time")
    if half:
        hour = hour % NOON + NOON * (half == "P")
    return hour * 3600 + int(found[2]) * 60 + float(re.sub("[,:]", ".", found[3]))
