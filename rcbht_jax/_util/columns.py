"""Names of columns: the unit that a name states, and the names of a time."""

from __future__ import annotations

import re

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
