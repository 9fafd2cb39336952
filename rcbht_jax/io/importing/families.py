"""Arrays that their names number: those of several recordings, and groups of a start, an end and a text."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import TIMES, base_and_unit, decoded
from rcbht_jax.io.importing.names import GROUPS, column_name, group_base, has_forces

_NUMBERED = re.compile(r"^(.*?)(\d+)(?:[./](.+))?$")
_BEFORE = re.compile(r"^((?:.*[\W_])?([^\W\d_]+)[_.\- ]?)(\d+)[_\- ](.+)$")  # run0_time
_FIELD = re.compile(r"^(.*[./]\d+)[./]([^./]+)$")
_LABELS = ("label", "text", "name", "description", "action", "skill")
Arrays = Mapping[str, NDArray[Any]]


def families(arrays: Arrays, shared: Container[str] = ()) -> dict[str, dict[str, NDArray[Any]]]:
    """The arrays of each recording, by its number; none if the numbers separate columns, not recordings.

    Numbers of recordings are those of ``trial_0``, ``trial_1``, of ``trial0_time``, ``trial1_time``, of ``log.0.time``,
    ``log.1.time``, any where arrays of one name differ in length, or that of ``cut.0.force``, ``cut.0.depth``, ... if
    each has single values, too, and the file holds no other signals; numbers of arrays in ``shared`` separate none.
    What has no number is of all, but for arrays ``[recording]``.

    >>> arrays = {"trial_0": np.zeros((9, 2)), "trial_1": np.zeros((7, 2)), "class": np.array(["a", "b"])}
    >>> {part: {name: array.shape for name, array in own.items()} for part, own in families(arrays).items()}
    {'0': {'class': (), 'values': (9, 2)}, '1': {'class': (), 'values': (7, 2)}}
    """
    heads: dict[str, dict[str, dict[str, NDArray[Any]]]] = {}
    for key, array in ((key, array) for key, array in arrays.items() if key not in shared):
        if (before := _BEFORE.match(key)) and numbered(before[2]) in GROUPS:
            heads.setdefault(before[1], {}).setdefault(before[3], {})[before[4]] = array
        elif match := _NUMBERED.match(key):
            heads.setdefault(match[1], {}).setdefault(match[2], {})[match[3] or ""] = array
    several = {head: parts for head, parts in heads.items() if len(parts) > 1}
    chosen = {head: parts for head, parts in several.items() if _recordings(head, parts)} or _described(several, arrays)
    if not chosen:
        return {}
    count = len(max(chosen.items(), key=_worth)[1])
    chosen = {head: parts for head, parts in chosen.items() if len(parts) == count}
    numbers = sorted({number for parts in chosen.values() for number in parts}, key=int)
    taken = {id(array) for parts in chosen.values() for own in parts.values() for array in own.values()}
    rest = {key: array for key, array in arrays.items() if id(array) not in taken}
    found: dict[str, dict[str, NDArray[Any]]] = {}
    for place, number in enumerate(numbers):
        own = {key: np.asarray(one[place]) if one.shape == (len(numbers),) else one for key, one in rest.items()}
        for head, parts in chosen.items():
            stem = "values" if numbered(head) in ("", *GROUPS) else head.strip("_./ ")
            for name, array in parts.get(number, {}).items():
                own[name if name and len(chosen) == 1 else "/".join(filter(None, (stem, name)))] = array
        found[number] = own
    return found


def _recordings(head: str, parts: Mapping[str, Arrays]) -> bool:
    """Whether numbers after a head separate recordings: by its name, or because each has its own time or length."""
    names = {name for own in parts.values() for name in own}
    arrays = [{name: one for name, one in own.items() if one.dtype.kind not in "US"} for own in parts.values()]
    lengths = [{len(own[name]) for own in arrays if name in own and own[name].size > 1} for name in names]
    signals = any(length and max(length) > 1 for length in lengths)
    timed = any(base_and_unit(name)[0] in TIMES for name in names)
    return signals and (numbered(head) in GROUPS or timed or any(len(length) > 1 for length in lengths))


def _worth(family: tuple[str, Mapping[str, Arrays]]) -> tuple[bool, bool, int]:
    """Whether a head is called like recordings, whether forces have its numbers, and how many there are."""
    head, parts = family
    names = {name for own in parts.values() for name in own}
    return numbered(head) in GROUPS, any(map(has_forces, (head, *names))), len(parts)


def _described(heads: Mapping[str, Mapping[str, Arrays]], arrays: Arrays) -> dict[str, Mapping[str, Arrays]]:
    """The one head whose numbers all have signals and single values, if there are no signals elsewhere."""
    if len(heads) != 1:
        return {}
    [parts] = heads.values()
    sizes = [{array.size > 1 for array in own.values()} for own in parts.values()]
    count = sum(array.size > 1 for own in parts.values() for array in own.values())
    alone = count == sum(array.size > 1 for array in arrays.values())
    return dict(heads) if alone and all(size == {True, False} for size in sizes) else {}


def numbered(head: str) -> str:
    """The last word of what stands before a number, in the singular.

    >>> numbered("data/Trials_")
    'trial'
    """
    return group_base(re.split(r"[./]", head.strip("_./ "))[-1]).removesuffix("s")


def segments(arrays: Arrays) -> tuple[list[tuple[str, str, float, float]], dict[str, NDArray[Any]]]:
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
        found.append((track, str(decoded(label)), start, end))
        if isinstance(fields.get("success"), np.bool_):
            found.append((f"{track}_success", "success" if fields["success"] else "failure", start, end))
        taken |= set(keys.values())
    return found, {key: array for key, array in arrays.items() if key not in taken}
