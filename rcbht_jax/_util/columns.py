"""Columns: the unit and the quantity that a name states, the names of a time, values with one per recording."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}  # s per unit of time
_KGF, _LBF, _INCH = 9.80665, 4.4482216152605, 0.0254  # N, N, m
FORCES = {  # N per unit
    "N": 1.0, "mN": 1e-3, "cN": 1e-2, "daN": 10.0, "kN": 1e3,
    "gf": 1e-3 * _KGF, "kgf": _KGF, "ozf": _LBF / 16, "lbf": _LBF,
}  # fmt: skip
MOMENTS = {  # Nm per unit
    "Nm": 1.0, "mNm": 1e-3, "cNm": 1e-2, "Nmm": 1e-3, "Ncm": 1e-2, "kNm": 1e3,
    "gf cm": 1e-5 * _KGF, "kgf m": _KGF, "kgf cm": 1e-2 * _KGF, "kgf mm": 1e-3 * _KGF,
    "ozf in": _LBF / 16 * _INCH, "lbf in": _LBF * _INCH, "lbf ft": _LBF * 12 * _INCH,
}  # fmt: skip
UNITS = {
    **{unit.lower().replace(" ", ""): unit for unit in (*FORCES, *MOMENTS)},
    "lb": "lbf", "lbs": "lbf", "inlbf": "lbf in", "lbin": "lbf in", "inlb": "lbf in", "inlbs": "lbf in",
    "ftlbf": "lbf ft", "lbft": "lbf ft", "ftlb": "lbf ft", "ftlbs": "lbf ft", "ozin": "ozf in", "kgcm": "kgf cm",
    "newton": "N", "newtons": "N", "newtonmeter": "Nm", "newtonmeters": "Nm", "newtonmetre": "Nm",
    "newtonmetres": "Nm", "牛": "N", "牛米": "Nm",
    "н": "N", "мн": "mN", "кн": "kN", "нм": "Nm", "мнм": "mNm", "нмм": "Nmm", "нсм": "Ncm", "кнм": "kNm",
    "кгс": "kgf", "кгсм": "kgf m", "кгссм": "kgf cm",
    "s": "s", "sec": "s", "second": "s", "seconds": "s", "秒": "s", "ms": "ms", "msec": "ms", "millisecond": "ms",
    "milliseconds": "ms", "毫秒": "ms", "ミリ秒": "ms", "us": "us", "usec": "us", "µs": "us", "μs": "us",
    "microseconds": "us", "microsecond": "us", "micros": "us", "millis": "ms",
    "ns": "ns", "nsec": "ns", "nanoseconds": "ns", "min": "min", "minutes": "min", "h": "h", "hr": "h", "hours": "h",
    "с": "s", "сек": "s", "мс": "ms", "мсек": "ms", "мкс": "us", "нс": "ns", "мин": "min", "ч": "h", "초": "s",
    "m": "m", "mm": "mm", "rad": "rad", "deg": "deg", "m/s": "m/s", "rad/s": "rad/s", "rpm": "rpm", "v": "V", "a": "A",
    "hz": "Hz",
    "м": "m", "мм": "mm", "рад": "rad", "град": "deg",
}  # fmt: skip
TIMES = (
    "time", "t", "stamp", "timestamp", "times", "timestamps", "secs", "sec", "seconds", "elapsed", "%time", "clock",
    "header.stamp", "field.header.stamp", "time_stamp", "elapsed_time", "rosbagtimestamp", "receipt", "ts", "tout",
    "__time", "publish_time", "log_time", "x_value",
)  # fmt: skip
TIMES_ABROAD = (  # of a column that grows: "temps" may be temperatures
    "zeit", "zeitstempel", "temps", "tiempo", "tempo", "czas", "tijd", "время", "时间", "時間", "시간",
)  # fmt: skip

_LONG_TIMES = ("time", "elapsed", "elapsed_time")  # that minutes or hours may follow: t_min may be the smallest

_KINDS = {"U": "text", "M": "dates", "m": "durations"}  # of columns, but for numbers
_EMPTY = {"text": "", "dates": np.datetime64("NaT"), "durations": np.timedelta64("NaT", "s")}

_QUANTITIES = r"(?:[FMT]|(?:force|torque|moment|tau)[ _]?)"
_WRENCH = re.compile(rf"(?:^[FMT][ _]|(?:^|[\W_]){_QUANTITIES})[xyz](?![a-z])", re.I)  # of a wrench, without a unit
_NAMED = tuple(  # how a name states a force or a moment, the clearest first; the last of those in a name
    re.compile(rf"(?:.*[\W\d_])?{part}(?![a-z])")
    for part in (
        r"(f|m|t|tau|forces?|moments?|torques?)\d*(?:_?ext)?[\W_]*[xyz]",
        r"(forces?|moments?|torques?|tau)",
        r"(f|m)[\W_]*\d+",
    )
)
_CAMEL, _ACRONYM = re.compile(r"(?<=[a-z])(?=[A-Z])"), re.compile(r"(?<=[A-Z])(?=[A-Z][a-z])")  # tcp|Fz, TCP|Fz
_TAILS = ("N", "Nm", "mN", "mNm", "Nmm", "Ncm", "kN", "kNm", "kgf", "lbf")  # that end a name after "_"
_AXIS = re.compile(r"(?:^|[\W_])(?:f|m|t|force|torque|moment|tau)[ _]?[xyz]$", re.IGNORECASE)  # before n, or nm
_PRODUCT = re.compile(r"(?<=[^\W\d_])[ .*·⋅・･∙•×-](?=[^\W\d_])")  # N-m, N·mm, lbf in
_AFTER = re.compile(r"^(.*?[^\s,/])(?:\s*[,/]\s*|\s+in\s+)([^\W\d_]+(?:[ .*·⋅-][^\W\d_]+)?)$")  # Fx/N, Fx, N; Fx in N
_TIMED = re.compile(r"^(.*[^\W_])(?:[\s_-]+|(?<=[a-z])(?=[A-Z]))([^\W\d_]+)$")  # time_msec, time-ms, timeMs
_SINCE = re.compile(r"\s+since\s.*$")  # ms since 2026-05-01 00:00:00
_QUANTITY = re.compile(r"[NН]|кгс|kgf|lbf")  # in the unit of a force or a moment, after a comma or a slash
_MEGA = re.compile(r"[MМ][NН]")  # no milli
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<（［【]\s*([^\])}>）］】]*?)\s*[\])}>）］】]$")


def split_unit(name: str) -> tuple[str, str]:
    """Name of a column without its unit, and the unit that it states, "" = none.

    >>> split_unit("Force_X [N]"), split_unit("Tx (N-mm)"), split_unit("t_ms"), split_unit("Fx")
    (('Force_X', 'N'), ('Tx', 'Nmm'), ('t', 'ms'), ('Fx', ''))
    >>> split_unit("force_x_n"), split_unit("tz_nm"), split_unit("gap_nm")
    (('force_x', 'N'), ('tz', 'Nm'), ('gap_nm', ''))
    >>> split_unit("Fx {N}"), split_unit("时间（毫秒）")
    (('Fx', 'N'), ('时间', 'ms'))
    >>> split_unit("Fx/N"), split_unit("Moment x in Ncm"), split_unit("time, s"), split_unit("imu/a")
    (('Fx', 'N'), ('Moment x', 'Ncm'), ('time', 's'), ('imu/a', ''))
    >>> split_unit("time_msec"), split_unit("timeMs"), split_unit("Time minutes"), split_unit("t_min")
    (('time', 'ms'), ('time', 'ms'), ('Time', 'min'), ('t_min', ''))
    >>> split_unit("Время, мс"), split_unit("Mx [Н·м]"), split_unit("Tx (in-lb)"), split_unit("Fz [MN]")
    (('Время', 'ms'), ('Mx', 'Nm'), ('Tx', 'lbf in'), ('Fz [MN]', ''))
    """
    match = _BRACKETS.match(name.strip())
    if match and match[1] and (unit := _unit(_SINCE.sub("", match[2].strip()))):
        return match[1].rstrip(" _/:,.-") or match[1], unit  # Fx_[N], Fx/[N]
    after = _AFTER.match(name.strip())
    # A path may end in a single letter: only forces, moments and the unit of a time are known by their place.
    placed = after and (_QUANTITY.search(after[2]) or after[1].lower() in (*TIMES, *TIMES_ABROAD))
    if after and placed and (unit := _unit(after[2])):
        return after[1], unit
    timed = _TIMED.match(name.strip())
    if timed and timed[1].lower() in (*TIMES, *TIMES_ABROAD):  # "_nsec" may be a part of a time
        unit = UNITS.get(timed[2].lower(), "")
        if unit in ("s", "ms", "us") or (unit in ("min", "h") and timed[1].lower() in _LONG_TIMES):
            return timed[1], unit
    head, _, tail = name.strip().rpartition("_")
    of_axis = tail in ("n", "nm") and _AXIS.search(head)
    if head and (tail in _TAILS or of_axis or tail.lower() in ("ms", "us", "ns", "sec", "s")):
        return head, UNITS[tail.lower()]
    return name.strip(), ""


def _unit(text: str) -> str:
    """The unit that a text names; "" = none that is known."""
    return "" if _MEGA.match(text) else UNITS.get(_PRODUCT.sub("", text.lower()), "")


def unit_factor(unit: str, other: str) -> float:
    """How many of the other unit one unit is; 1 = they are the same, or one is not stated; 0 = no factor is known.

    >>> unit_factor("Nm", "Nmm"), unit_factor("kgf", "N"), unit_factor("N·m", "Nm"), unit_factor("N", "Nm")
    (1000.0, 9.80665, 1.0, 0.0)
    >>> unit_factor("A", "A"), unit_factor("A", "mA"), unit_factor("", "Nm")
    (1.0, 0.0, 1.0)
    """
    here, there = _unit(unit) or unit, _unit(other) or other
    if not (here and there) or here == there:
        return 1.0
    return next(
        (kind[here] / kind[there] for kind in (FORCES, MOMENTS, SECONDS) if here in kind and there in kind), 0.0
    )


def is_moment(name: str, unit: str = "") -> bool:
    """Whether an axis is a moment rather than a force: by its unit, else by its name.

    The last force or moment in the name decides; without one, names that begin with M or T are moments.

    >>> is_moment("Tx"), is_moment("TCP_Fz"), is_moment("MeasuredFz"), is_moment("force_torque.torque.z")
    (True, False, False, True)
    >>> is_moment("M"), is_moment("grip"), is_moment("grip", "N·mm"), is_moment("Tx", "N")
    (True, False, True, False)
    """
    if unit and (unit_factor(unit, "N") or unit_factor(unit, "Nm")):
        return unit_factor(unit, "Nm") > 0
    spelled = snake(_ACRONYM.sub("_", name))
    stated = next((match[1] for form in _NAMED if (match := form.match(spelled))), "")
    return not stated.startswith("f") if stated else name.startswith(("M", "T"))


def snake(name: str) -> str:
    """A name in lower case, with a "_" between words that only a capital separates.

    >>> snake("ZeitInSec"), snake("tcpForce.X")
    ('zeit_in_sec', 'tcp_force.x')
    """
    return _CAMEL.sub("_", name).lower()


def base_and_unit(name: str) -> tuple[str, str]:
    """As :func:`split_unit`, the name in lower case.

    >>> base_and_unit("Fx [N]")
    ('fx', 'N')
    """
    base, unit = split_unit(name)
    return base.lower(), unit


def unit_of_time(name: str, grows: bool = False) -> float:
    """Seconds per unit of a column that is a time by its name; 0 = it is none.

    Args:
        name: of the column.
        grows: its values do: then a unit of time is enough, or a name in another language, which may be a temperature.

    >>> unit_of_time("Time [ms]"), unit_of_time("stamp"), unit_of_time("T [Nm]"), unit_of_time("Zeit [s]")
    (0.001, 1.0, 0.0, 1.0)
    >>> unit_of_time("Zeit"), unit_of_time("Zeit", grows=True), unit_of_time("x [ms]", grows=True)
    (0.0, 1.0, 0.001)
    """
    base, unit = base_and_unit(name)
    known = base in TIMES or (base in TIMES_ABROAD and (grows or unit != "")) or (grows and unit != "")
    return SECONDS.get(unit or "s", 0.0) if known else 0.0


def column_values(name: str, values: Any, count: int, standard: NDArray[np.str_] | None = None) -> NDArray[Any]:
    """A column ``[recording]`` of texts or numbers as stores hold them, also from objects, as of a table of pandas.

    Args:
        name: of the column, for the error.
        values: one for all recordings, or one for each; bytes become texts; dates and other kinds stay as they are.
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
    if array.dtype.kind not in "OSTbiuf" or (array.dtype.kind in "biuf" and standard is None):
        return array.astype(array.dtype.newbyteorder("="))
    items = [decoded(value) for value in array.tolist()]
    there = [not is_missing(value) for value in items]
    found = [value for value, given in zip(items, there, strict=True) if given]
    if standard is None and found and all(isinstance(value, Real) for value in found):
        return np.array([value if given else np.nan for value, given in zip(items, there, strict=True)], np.float64)
    if not all(isinstance(value, str if standard is None else str | Real) for value in found):
        kinds = sorted({type(value).__name__ for value in found})
        raise InputError(f"Column {name} holds objects of the kinds {', '.join(kinds)}; expected texts, or numbers.")
    other = [""] * count if standard is None else standard.tolist()
    return np.array([str(value) if given else text for value, given, text in zip(items, there, other, strict=True)])


def is_missing(value: Any) -> bool:
    """Whether a value is none: None, NaN, or NA of pandas.

    >>> is_missing(None), is_missing(np.float32("nan")), is_missing("")
    (True, True, False)
    """
    if isinstance(value, float | np.floating):
        return math.isnan(value)
    return value is None or type(value).__name__ == "NAType"


def decoded(value: Any) -> Any:
    """Bytes as text, as HDF5 holds texts; any other value as it is.

    >>> decoded(b"Fx"), decoded(7)
    ('Fx', 7)
    """
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def kind_of(column: NDArray[Any]) -> str:
    """What a column holds: "text", "dates", "durations" or "numbers".

    >>> kind_of(np.array(["mon"])), kind_of(np.array([True]))
    ('text', 'numbers')
    """
    return _KINDS.get(column.dtype.kind, "numbers")


def joined_columns(parts: Sequence[Mapping[str, NDArray[Any]]], counts: Sequence[int]) -> dict[str, NDArray[Any]]:
    """The columns ``[recording]`` of several data sets, one after the other.

    One that a set lacks is empty there: "", NaN or, of dates and durations, NaT.

    Args:
        parts: the columns of each set by name.
        counts: of recordings in each set.

    Raises:
        InputError: a column holds values of several kinds, or whole numbers that a float beside them would round.

    Example:
        >>> joined_columns([{"mass": np.array([1, 2])}, {"day": np.array(["mon"])}], [2, 1])
        {'mass': array([ 1.,  2., nan]), 'day': array(['', '', 'mon'], dtype='<U3')}
    """
    found = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        there = [part[name] for part in parts if name in part]
        kinds = sorted(set(map(kind_of, there)), reverse=True)
        if len(kinds) > 1:
            raise InputError(f"data sets to be joined have {' and '.join(kinds)} in the column {name}.")
        empty = _EMPTY.get(kinds[0], np.nan)
        pairs = zip(parts, counts, strict=True)
        found[name] = np.concatenate([part[name] if name in part else np.full(count, empty) for part, count in pairs])
        if found[name].dtype.kind == "f" and any(map(_is_too_large, there)):
            raise InputError(f"the column {name} has whole numbers too large for a float beside others; make it text.")
    return found


def _is_too_large(column: NDArray[Any]) -> bool:
    """Whether a column has whole numbers that floats cannot hold."""
    return column.dtype.kind in "iu" and any(int(float(value)) != value for value in column.tolist())


def measured(axes: Sequence[str], units: Sequence[str]) -> str:
    """What axes measure together: "wrench", or "signal" where not all of them are forces and moments.

    >>> measured(["grip", "Fz"], ["N", ""]), measured(["current", "Fz"], ["A", "N"]), measured(["speed"], [""])
    ('wrench', 'signal', 'signal')
    >>> {measured([axis], [""]) for axis in ("Fx_left", "Fz2", "Fx wrist", "wrist_fz", "Mz_tool", "force_x", "F_x")}
    {'wrench'}
    >>> {measured([axis], [""]) for axis in ("offset", "pos_m_x", "buffy", "fxy")}
    {'signal'}
    """
    pairs = zip(axes, units, strict=True)
    named = (unit in (*FORCES, *MOMENTS) if unit else _WRENCH.search(axis) for axis, unit in pairs)
    return "wrench" if all(named) else "signal"


def with_units(axes: Mapping[str, str]) -> str:
    """Axes and their units as a list for people.

    >>> with_units({"Fz": "N", "grip": ""}), with_units({"Fx": "", "Fy": ""})
    ('Fz (N), grip (unit not stated)', 'Fx, Fy (units not stated)')
    """
    if not any(axes.values()) and len(axes) > 1:
        return f"{', '.join(axes)} (units not stated)"
    return ", ".join(f"{axis} ({unit or 'unit not stated'})" for axis, unit in axes.items())
