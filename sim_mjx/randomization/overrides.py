"""Physical parameters by name, so that a search, a file or a user can set them: "parts.friction", "sensor.delay".

A name is a field of the parts or of the sensor, with an element or a range of it in brackets where it has several:
``parts.tab_stiffness`` all four tabs, ``parts.hook_overlap[0:2]`` the front ones, ``parts.mount_stiffness[2]`` the
mount's vertical. Values are in SI units, those of ``PartParams`` and ``SensorParams``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.untrusted import checked_number, load_json
from rcbht_jax._util.values import LARGEST
from rcbht_jax.errors import InputError
from sim_mjx.assembly.hooked_parts import HookedParams
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.sensor import SensorParams, required

Group = TypeVar("Group", PartParams, SensorParams)
Physical = tuple[tuple[str, float], ...]  # name, value; hashable
GROUPS: dict[str, type] = {"parts": HookedParams, "sensor": SensorParams}
NAME = re.compile(r"(parts|sensor)\.(\w+)(?:\[(\d+)(?::(\d+))?\])?")
FORMAT = "rcbht-physical"


def check(physical: Physical) -> None:
    """Check names and values of physical parameters.

    Raises:
        InputError: an unknown name, a value that is not finite or too large, or noise, a delay or a step of
            quantisation that the sensor cannot have.
    """
    for name, value in physical:
        match = NAME.fullmatch(name)
        if match is None or match[2] not in {field.name for field in fields(GROUPS[match[1]])}:
            known = ", ".join(f"{group}.{f.name}" for group, kind in GROUPS.items() for f in fields(kind))
            raise InputError(f"There is no physical parameter {name!r}; expected one of {known}.")
        if not abs(value) <= LARGEST:  # NaN compares as false; what is drawn around it must fit in single precision
            raise InputError(f"The physical parameter {name} is {value:g}; expected a finite number up to {LARGEST:g}.")
        if wanted := required(match[2], value):
            raise InputError(f"The physical parameter {name} is {value:g}; expected {wanted}.")


def apply_overrides(group: Group, prefix: str, physical: Physical) -> Group:
    """Parameters of one trial with the named ones replaced; whole-numbered ones are rounded.

    Args:
        group: one trial's parts or sensor.
        prefix: "parts" or "sensor"; other names are ignored.
        physical: names and values, later ones over earlier ones.

    Raises:
        InputError: an unknown name, or an element that the parameter does not have.
    """
    check(physical)
    for name, value in physical:
        if name.startswith(f"{prefix}."):
            attribute, array, where = element(group, name)
            array[where] = round(value) if array.dtype.kind in "iu" else value
            group = replace(group, **{attribute: array})
    return group


def value(parts: PartParams, sensor: SensorParams, name: str) -> float:
    """Value of a parameter in one trial; the mean where the name covers several elements.

    Raises:
        InputError: unknown name.
    """
    check(((name, 1.0),))
    _, array, where = element(parts if name.startswith("parts.") else sensor, name)
    return float(np.mean(array[where]))


def element(group: PartParams | SensorParams, name: str) -> tuple[str, np.ndarray, Any]:
    """Field of a checked name, a copy of its values in one trial, and the index of what the name covers.

    Raises:
        InputError: these parts, or this sensor, have no such parameter or element.
    """
    match = NAME.fullmatch(name)
    assert match is not None
    owner, attribute, first, end = match.groups()
    if (present := getattr(group, attribute, None)) is None:
        which = "parts of this preset have" if owner == "parts" else "sensor of this preset has"
        those = "those with hooks do" if owner == "parts" else "that of rigid-openhrp does"
        raise InputError(f"The {which} no {attribute}: only {those}.")
    array = np.array(present)
    if first is None:
        return attribute, array, ...
    where = slice(int(first), int(end or int(first) + 1))
    if array.ndim != 1 or not where.start < where.stop <= len(array):
        raise InputError(f"The physical parameter {name} does not exist; there are {array.size} elements.")
    return attribute, array, where


def write(path: Path, values: Mapping[str, float], about: Mapping[str, Any]) -> None:
    """Write parameters as a JSON file, atomically, with what is known about them."""
    check(tuple(values.items()))
    text = json.dumps({"format": FORMAT, "values": dict(values), **about}, indent=1, allow_nan=False) + "\n"
    with atomic_write(path) as draft:
        draft.write_text(text)


def read(path: Path) -> Physical:
    """Parameters from a JSON file.

    Raises:
        InputError: not such a file, or an unknown parameter in it.
    """
    try:
        content = load_json(path)
        if content["format"] != FORMAT:
            raise KeyError("format")
        physical = tuple((name, checked_number(name, value)) for name, value in content["values"].items())
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f'{path} holds no physical parameters; expected a file of "rcbht fidelity fit".') from error
    check(physical)
    return physical
