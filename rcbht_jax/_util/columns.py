"""Columns: the unit that a name states, the names of a time, and the values of a column with one per recording."""

from __future__ import annotations

import math
import re
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}  # s per unit of time
UNITS = {
    "n": "N", "nm": "Nm", "mn": "mN", "mnm": "mNm", "kn": "kN", "nmm": "Nmm", "ncm": "Ncm", "knm": "kNm", "kgf": "kgf",
    "lbf": "lbf", "lbfin": "lbf in", "lbfft": "lbf ft", "newton": "N", "newtons": "N", "newtonmeter": "Nm",
    "newtonmeters": "Nm",
    "s": "s", "sec": "s", "second": "s", "seconds": "s", "秒": "s", "ms": "ms", "msec": "ms", "millisecond": "ms",
    "milliseconds": "ms", "毫秒": "ms", "ミリ秒": "ms", "us": "us", "usec": "us", "µs": "us", "μs": "us",
    "microseconds": "us",
    "ns": "ns", "nsec": "ns", "nanoseconds": "ns", "min": "min", "minutes": "min", "h": "h", "hr": "h", "hours": "h",
    "m": "m", "mm": "mm", "rad": "rad", "deg": "deg", "m/s": "m/s", "rad/s": "rad/s", "v": "V", "a": "A", "hz": "Hz",
}  # fmt: skip
TIMES = (
    "time", "t", "stamp", "timestamp", "times", "timestamps", "secs", "sec", "seconds", "elapsed", "%time", "clock",
    "header.stamp", "field.header.stamp", "time_stamp", "elapsed_time", "rosbagtimestamp", "receipt", "ts", "tout",
    "__time", "publish_time", "log_time",
)  # fmt: skip

_TAILS = ("N", "Nm", "mN", "mNm", "Nmm", "Ncm", "kN", "kNm", "kgf", "lbf")  # that end a name after "_"
_PRODUCT = re.compile(r"(?<=[a-z])[ .*·⋅・･∙•×-](?=[a-z])")  # N-m, N·mm, lbf in
_AFTER = re.compile(r"^(.*?[^\s,/])(?:\s*[,/]\s*|\s+in\s+)([a-zA-Zµ]+(?:[ .*·⋅-][a-zA-Z]+)?)$")  # Fx/N, Fx, N; Fx in N
_SINCE = re.compile(r"\s+since\s.*$")  # ms since 2026-05-01 00:00:00
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<（［【]\s*([^\])}>）］】]*?)\s*[\])}>）］】]$")


def split_unit(name: str) -> tuple[str, str]:
    """Name of a column without its unit, and the unit that it states, "" = none.

    >>> split_unit("Force_X [N]"), split_unit("Tx (N-mm)"), split_unit("t_ms"), split_unit("Fx")
    (('Force_X', 'N'), ('Tx', 'Nmm'), ('t', 'ms'), ('Fx', ''))
    >>> split_unit("Fx {N}"), split_unit("时间（毫秒）")
    (('Fx', 'N'), ('时间', 'ms'))
    >>> split_unit("Fx/N"), split_unit("Moment x in Ncm"), split_unit("time, s"), split_unit("imu/a")
    (('Fx', 'N'), ('Moment x', 'Ncm'), ('time', 's'), ('imu/a', ''))
    """
    match = _BRACKETS.match(name.strip())
    if match and match[1] and (unit := UNITS.get(_PRODUCT.sub("", _SINCE.sub("", match[2].lower().strip())))):
        return match[1], unit
    after = _AFTER.match(name.strip())
    unit = UNITS.get(_PRODUCT.sub("", after[2].lower())) if after else None
    # A path may end in a single letter: only forces, moments and the unit of a time are known by their place.
    if after and unit and ("N" in after[2] or unit[:3] in ("kgf", "lbf") or after[1].lower() in TIMES):
        return after[1], unit
    head, _, tail = name.strip().rpartition("_")
    if head and (tail in _TAILS or tail.lower() in ("ms", "us", "ns", "sec", "s")):
        return head, UNITS[tail.lower()]
    return name.strip(), ""


def base_and_unit(name: str) -> tuple[str, str]:
    """As :func:`split_unit`, the name in lower case.

    >>> base_and_unit("Fx [N]")
    ('fx', 'N')
    """
    base, unit = split_unit(name)
    return base.lower(), unit


def unit_of_time(name: str) -> float:
    """Seconds per unit of a column that is a time by its name; 0 = it is none.

    >>> unit_of_time("Time [ms]"), unit_of_time("stamp"), unit_of_time("T [Nm]")
    (0.001, 1.0, 0.0)
    """
    base, unit = base_and_unit(name)
    return SECONDS.get(unit or "s", 0.0) if base in TIMES else 0.0


def column_values(name: str, values: Any, count: int, standard: NDArray[np.str_] | None = None) -> NDArray[Any]:
    """A column ``[recording]`` of texts or numbers as stores hold them, also from objects, as of a table of pandas.

    Args:
        name: of the column, for the error.
        values: one for all recordings, or one for each; dates and other kinds stay as they are.
        count: of recordings.
        standard: what a column of texts holds where nothing is given; numbers in it become texts. None = any column,
            where a missing text is "" and a missing number NaN.

    Raises:
        InputError: another number of values, or objects that are neither all texts nor all numbers.

    Example:
        >>> column_values("speed", [1, None], 2).tolist(), column_values("day", ["a", None], 2).tolist()
        ([1.0, nan], ['a', ''])
        >>> column_values("trial", [7, 8], 2, np.array(["trial-0", "trial-1"])).tolist()
        ['7', '8']
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"Column {name} has rows of different lengths; expected a value for each recording.") from None
    try:
        array = np.broadcast_to(array, (count,)).copy()
    except ValueError:
        raise InputError(f"Column {name} has {array.size} values for {count} recordings.") from None
    if array.dtype.kind not in "OTbiuf" or (array.dtype.kind in "biuf" and standard is None):
        return array.astype(array.dtype.newbyteorder("="))
    items = array.tolist()
    there = [not (value is None or type(value).__name__ == "NAType" or _is_nan(value)) for value in items]
    found = [value for value, given in zip(items, there, strict=True) if given]
    if standard is None and found and all(isinstance(value, Real) for value in found):
        return np.array([value if given else np.nan for value, given in zip(items, there, strict=True)], np.float64)
    if not all(isinstance(value, str if standard is None else str | Real) for value in found):
        kinds = sorted({type(value).__name__ for value in found})
        raise InputError(f"Column {name} holds objects of the kinds {', '.join(kinds)}; expected texts, or numbers.")
    other = [""] * count if standard is None else standard.tolist()
    return np.array([str(value) if given else text for value, given, text in zip(items, there, other, strict=True)])


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)
