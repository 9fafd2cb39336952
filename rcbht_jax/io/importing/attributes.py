"""What attributes state about the values of an array: their units, and how they are packed in whole numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import decoded, snake, split_unit, unit_of_time
from rcbht_jax.labels import AXES

UNITS = ("unit", "units")
_OF_UNITS = re.compile(r"(?:^|[./]|(?<![^./])([^./]+)_)units?$")
FILL = ("_FillValue", "missing_value")


def scaled(array: NDArray[Any], attributes: Mapping[str, Any]) -> NDArray[Any]:
    """The values that packed numbers stand for, by the attributes of the CF conventions of netCDF and xarray.

    Values are ``scale_factor * number + add_offset``; numbers equal to ``_FillValue`` are missing.

    >>> scaled(np.array([5, -1]), {"scale_factor": 0.5, "add_offset": 1.0, "_FillValue": -1}).tolist()
    [3.5, nan]
    >>> scaled(np.array([5, -1]), {}).tolist()
    [5, -1]
    """
    factor, offset = _number(attributes, "scale_factor"), _number(attributes, "add_offset")
    fills = [fill for key in FILL if (fill := _number(attributes, key)) is not None]
    if factor is None and offset is None and not fills:
        return array
    missing = np.isin(array, fills)
    values = array.astype(np.float64)
    if factor is not None or offset is not None:
        values = values * (1.0 if factor is None else factor) + (offset or 0.0)
    values[missing] = np.nan
    return values


def _number(attributes: Mapping[str, Any], key: str) -> float | None:
    """A single number that an attribute states; None = it states none."""
    value = np.asarray(attributes.get(key, ""))
    return float(value.reshape(())) if value.size == 1 and value.dtype.kind in "fiu" else None


def stated_units(attributes: Mapping[str, Any]) -> list[str]:
    """The units in the attribute ``units`` or ``unit`` of an array, one or one per element; unknown ones are "".

    >>> stated_units({"units": "N,N,N,Nm,Nm,N mm"}), stated_units({})
    (['N', 'N', 'N', 'Nm', 'Nm', 'Nmm'], [])
    """
    named = {key.lower(): value for key, value in attributes.items()}
    for key in ("units", "unit"):
        texts = [str(decoded(text)) for text in np.asarray(named.get(key, "")).ravel().tolist()]
        units = [split_unit(f"x [{text.strip()}]")[1] for text in (texts[0].split(",") if len(texts) == 1 else texts)]
        if any(units):
            return units
    return []


def units_of(columns: Iterable[str], stated: Mapping[str, list[str]]) -> dict[str, str]:
    """The unit of each column of data sets with stated units; two of a whole wrench are of its forces and moments.

    >>> units_of(["t", "F_0", "F_1"], {"t": ["ms"], "F": ["N", "Nm"]})
    {'t': 'ms', 'F_0': 'N', 'F_1': 'Nm'}
    >>> list(units_of([f"ft_{number}" for number in range(6)], {"ft": ["N", "Nm"]}).values())
    ['N', 'N', 'N', 'Nm', 'Nm', 'Nm']
    """
    columns = list(columns)
    heads = Counter(column.rpartition("_")[0] for column in columns)
    whole = (head for head, own in stated.items() if heads[head] == len(AXES) and len(own) == 2)
    stated = {**stated, **{head: [unit for unit in stated[head] for _ in "xyz"] for head in whole}}
    units = {}
    for column in columns:
        head, _, number = column.rpartition("_")
        own = stated.get(head, []) if number.isdecimal() else []
        if column in stated:
            own = stated[column][:1]
        elif len(own) > 1:
            own = own[int(number) : int(number) + 1] if len(own) == heads[head] else []
        if own and own[0]:
            units[column] = own[0]
    return units


def lists_of_units(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The lists of texts with a name such as units or wrench_units that are not one for each row or recording.

    >>> list(lists_of_units({"wrench_units": np.array(["N", "Nm"]), "t": np.zeros(9), "unit": np.array(["N"] * 9)}))
    ['wrench_units']
    """
    lists = {key: one for key, one in arrays.items() if one.dtype.kind in "US" and 1 < one.size == max(one.shape)}
    lists = {key: one for key, one in lists.items() if _OF_UNITS.search(snake(key))}
    if not lists:
        return {}
    timed = (one.ndim == 3 or (one.ndim and unit_of_time(re.split("[./]", key)[-1])) for key, one in arrays.items())
    counts = {len(one) for one, of_rows in zip(arrays.values(), timed, strict=True) if of_rows}
    return {key: one for key, one in lists.items() if one.size not in counts}


def units_in(facts: Mapping[str, str | float], columns: Iterable[str]) -> tuple[dict[str, str | float], dict[str, str]]:
    """The facts without those that state units, and the units of columns that these state.

    They are those of an object ``units`` for the names of columns, of ``wrench_units``, or a list ``units`` as long
    as one array has elements, or as there are columns.

    >>> units_in({"run.units": "kN,kN,N", "part": "A"}, [f"run.F_{number}" for number in range(3)])
    ({'part': 'A'}, {'run.F_0': 'kN', 'run.F_1': 'kN', 'run.F_2': 'N'})
    """
    short = {column: re.split("[./]", column)[-1] for column in columns}
    names, parts = set(short.values()), (name.rpartition("_") for name in short.values())
    heads = Counter(head for head, _, number in parts if head and number.isdecimal())
    wide: dict[int, list[str]] = {}
    for head, count in heads.items():
        wide.setdefault(count, []).append(head)
    stated: dict[str, list[str]] = {}
    taken = dict[str, str]()  # fact -> name of its columns; "" = none
    for key, fact in facts.items():
        if "unit" not in key.lower():  # quick: many recordings may share many facts
            continue
        texts, words = stated_units({"units": fact}), re.split("[./]", key)
        if len(words) > 1 and words[-2].lower() in UNITS:
            taken[key] = words[-1]
        elif texts and (found := _OF_UNITS.search(snake(key))):
            as_long = wide.get(len(texts), []) if len(texts) > 1 else []
            if found[1] in heads or found[1] in names:
                taken[key] = found[1]
            elif len(as_long) == 1:
                taken[key] = as_long[0]
            elif len(texts) == len(short):  # beside as many names
                taken[key] = ""
                stated |= {column: [unit] for column, unit in zip(short.values(), texts, strict=True)}
        if texts and taken.get(key):
            stated[taken[key]] = texts
    known = units_of(short.values(), stated)
    units = {column: known[name] for column, name in short.items() if name in known}
    return {key: fact for key, fact in facts.items() if key not in taken}, units
