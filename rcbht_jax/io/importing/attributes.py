"""What attributes state about the values of an array: their units, and how they are packed in whole numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax.labels import AXES

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
        given = np.asarray(named.get(key, "")).ravel().tolist()
        texts = [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in given]
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
