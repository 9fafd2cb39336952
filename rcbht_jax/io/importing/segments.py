"""Intervals that a file of arrays states in numbered groups of a start, an end and a text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.io.importing.names import column_name

_FIELD = re.compile(r"^(.*[./]\d+)[./]([^./]+)$")
_LABELS = ("label", "text", "name", "description", "action", "skill")


def segments(
    arrays: Mapping[str, NDArray[Any]],
) -> tuple[list[tuple[str, str, float, float]], dict[str, NDArray[Any]]]:
    """The intervals of groups such as ``segments/0/start``, and the arrays that are left.

    An interval is its track, label, start and end (NaN = unknown). Tracks have the names of the groups, without
    numbers; whether a segment was a success is a track of its own. Times are as the file states them.

    >>> group = {"start": np.array(1.0), "end": np.array(2.0), "text": np.array("push")}
    >>> segments({f"segments/0/{key}": value for key, value in group.items()} | {"Fz": np.zeros(9)})[0]
    [('segments', 'push', 1.0, 2.0)]
    """
    groups: dict[str, dict[str, str]] = {}
    for key, array in arrays.items():
        if array.size == 1 and (match := _FIELD.match(key)):
            groups.setdefault(match[1], {})[match[2].lower()] = key
    found: list[tuple[str, str, float, float]] = []
    taken: set[str] = set()
    for group, keys in groups.items():
        fields: dict[str, Any] = {field: arrays[key].reshape(())[()] for field, key in keys.items()}
        label = next((fields[key] for key in _LABELS if isinstance(fields.get(key), str | bytes)), None)
        times = [fields.get("start"), fields.get("end", np.float64(np.nan))]
        if label is None or not all(isinstance(time, np.floating | np.integer) for time in times):
            continue
        track = column_name("_".join(part for part in re.split(r"[./]", group) if not part.isdecimal()))
        start, end = map(float, times)
        found.append((track, _text(label), start, end))
        if isinstance(fields.get("success"), np.bool_):
            found.append((f"{track}_success", "success" if fields["success"] else "failure", start, end))
        taken |= set(keys.values())
    return found, {key: array for key, array in arrays.items() if key not in taken}


def _text(label: str | bytes) -> str:
    return label.decode("utf-8", "replace") if isinstance(label, bytes) else str(label)
