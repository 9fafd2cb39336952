"""Times written as text: ISO 8601, a time of day with or without a date before it, or minutes and seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

DAY, NOON = 86400.0, 12
_ISO = re.compile(r"\d{4}-\d{2}(-\d{2}([T ].*)?)?$")
_ZONE = re.compile(r"\s*(?:Z|([+-])(\d{2})(?::?(\d{2}))?)$")
_CLOCK = re.compile(
    r"(?:^|[ T])(\d{1,2}):([0-5]?\d):([0-5]?\d(?:[.,]\d+|:\d{3}|:\d{6})?)(?:\s*([AP])\.?M\.?)?$", re.IGNORECASE
)
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
    if all(map(_ISO.match, filled)):
        pairs = [_local(text) if ":" in text else (text, 0) for text in filled]
        dates = np.array([local for local, _ in pairs], "datetime64[ns]")
        offsets = np.array([offset for _, offset in pairs])
        out[known] = (dates - dates[0]).astype(np.float64) * 1e-9 - (offsets - offsets[0])
        return out
    of_day = np.array(list(map(_of_day, filled)))
    steps = np.diff(of_day, prepend=of_day[0])
    days = (steps < -DAY / 2).cumsum() - (steps > DAY / 2).cumsum()
    out[known] = of_day - of_day[0] + DAY * days
    return out


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
