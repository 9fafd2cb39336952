"""Arrays of one file that belong to several recordings, as their names number them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import TIMES, base_and_unit
from rcbht_jax.io.importing.names import GROUPS, group_base

_NUMBERED = re.compile(r"^(.*?)(\d+)(?:[./](.+))?$")
_BEFORE = re.compile(r"^((?:.*[\W_])?([^\W\d_]+)[_.\- ]?)(\d+)[_\- ](.+)$")  # run0_time
Arrays = Mapping[str, NDArray[Any]]


def families(arrays: Arrays) -> dict[str, dict[str, NDArray[Any]]]:
    """The arrays of each recording, by its number; none if the numbers separate columns, not recordings.

    Numbers of recordings are those of ``trial_0``, ``trial_1``, of ``trial0_time``, ``trial1_time``, of ``log.0.time``,
    ``log.1.time``, any where arrays of one name differ in length, or that of ``cut.0.force``, ``cut.0.depth``, ... if
    each has single values, too, and the file holds no other signals. What has no number is shared, but for arrays
    ``[recording]``.

    >>> arrays = {"trial_0": np.zeros((9, 2)), "trial_1": np.zeros((7, 2)), "class": np.array(["a", "b"])}
    >>> {part: {name: array.shape for name, array in own.items()} for part, own in families(arrays).items()}
    {'0': {'class': (), 'values': (9, 2)}, '1': {'class': (), 'values': (7, 2)}}
    """
    heads: dict[str, dict[str, dict[str, NDArray[Any]]]] = {}
    for key, array in arrays.items():
        if (before := _BEFORE.match(key)) and numbered(before[2]) in GROUPS:
            heads.setdefault(before[1], {}).setdefault(before[3], {})[before[4]] = array
        elif match := _NUMBERED.match(key):
            heads.setdefault(match[1], {}).setdefault(match[2], {})[match[3] or ""] = array
    several = {head: parts for head, parts in heads.items() if len(parts) > 1}
    chosen = {head: parts for head, parts in several.items() if _recordings(head, parts)} or _described(several, arrays)
    if not chosen:
        return {}
    count = max(map(len, chosen.values()))
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
    lengths = [{len(own[name]) for own in parts.values() if name in own and own[name].size > 1} for name in names]
    signals = any(length and max(length) > 1 for length in lengths)
    timed = any(base_and_unit(name)[0] in TIMES for name in names)
    return signals and (numbered(head) in GROUPS or timed or any(len(length) > 1 for length in lengths))


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
