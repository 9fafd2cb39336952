"""Numbers that stand for missing values, such as -9999 or 1e30: those that a mapping names, and those that look so."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import text

_USUAL = (999.0, 9999.0, 99999.0, 999999.0, 32768.0)  # of either sign
_HUGE = 1e15  # no sensor measures as much
_FAR = 5  # times the largest other value


def without_stand_ins(values: NDArray[Any], mapping: Mapping) -> NDArray[Any]:
    """The values, NaN for those that a mapping calls missing.

    >>> without_stand_ins(np.array([1.5, -9999.0]), Mapping(missing=(-9999.0,))).tolist()
    [1.5, nan]
    """
    if not mapping.missing:
        return values
    missing = np.isclose(values[..., None], mapping.missing, rtol=1e-6, atol=0.0).any(-1)  # a float32 is near
    return np.where(missing, np.nan, values)


def stand_ins(table: Table, mapping: Mapping) -> str:
    """A warning about a number in the channels that may stand for missing values; "" = there is none.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> table = Table("a.csv", {"Fz": np.array([1.5, -9999.0, 2.5])})
    >>> stand_ins(table, Mapping((Channel("Fz"),)))
    'Fz is -9999 in 1 sample, far from all others; if this means that values are missing, map it: missing = [-9999].'
    """
    for channel in mapping.channels:
        values = without_stand_ins(table.columns[channel.column], mapping)
        if number := _stand_in(values[np.isfinite(values)]):
            samples = plural(int((values == number).sum()), "sample")
            why = f"far from all others; if this means that values are missing, map it: missing = [{text(number)}]."
            return f"{channel.column} is {text(number)} in {samples}, {why}"
    return ""


def _stand_in(values: NDArray[Any]) -> float:
    """The number among finite values that may stand for missing ones; 0 = there is none."""
    if not len(values):
        return 0.0
    number = float(values[np.abs(values).argmax()])
    others = np.abs(values[values != number]).max(initial=0.0)
    named = abs(number) in _USUAL or abs(number) >= _HUGE
    return number if named and 0 < _FAR * others < abs(number) else 0.0
