"""Several arms side by side in one table, such as ``left_fx ... right_tz``: a table for each."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from collections.abc import Mapping as AnyMapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.names import SIDES, mark_of, preference, wrenches
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.words import in_order

MOST_ARMS = 16
PLACE = "{arm}"  # of the arm's name in that of a column
_LETTER = re.compile(r"(?<![A-Za-z])([LR])(?=[FMT][xyz])")  # LFx, RFx
_NUMBERED = re.compile(r"(?<![A-Za-z])(?i:(?:robot|arm|hand|panda|ur|yumi|iiwa)_?\d+)(?!\d)")


def arms_of(names: Iterable[str]) -> tuple[str, ...]:
    """The arms that columns name, each of which has a wrench with the same columns; () = there are not several.

    >>> arms_of([f"{side}_f{axis}" for side in ("left", "right") for axis in "xyz"])
    ('left', 'right')
    >>> arms_of([f"robot{number}/force_{axis}" for number in (0, 1) for axis in "xyz"])
    ('robot0', 'robot1')
    >>> arms_of(["Fx", "Fy", "Fz", "raw_fx", "raw_fy", "raw_fz"])
    ()
    """
    names = list(names)
    bases = [split_unit(name)[0] for name in names]
    left, right = ({_LETTER.sub("", one) for one in bases if side in _LETTER.findall(one)} for side in "LR")
    if left == right and wrenches(left):
        return SIDES[1]
    found = wrenches(names)
    best = max((preference(wrench["Fx"]) for wrench in found), default=0)
    firsts = [split_unit(wrench["Fx"])[0] for wrench in found if preference(wrench["Fx"]) == best]
    for sides in SIDES:
        if set.intersection(*(_without(side, firsts) for side in sides)):
            return sides
    shared: defaultdict[str, set[str]] = defaultdict(set)
    for first in firsts:
        for arm in _NUMBERED.findall(first):
            shared[mark_of(arm).sub(PLACE, first)].add(arm)
    arms = {arm for several in shared.values() if len(several) > 1 for arm in several}
    return tuple(sorted(arms, key=in_order)) if len(arms) <= MOST_ARMS else ()


def tables_of_arms(table: Table, mapping: Mapping) -> Iterator[Table]:
    """The table of each arm: its own columns, with "{arm}" for its name, and those that name no arm.

    A mapping names the arms as the columns have them, in any case of letters; else they are found. A table of one arm,
    or one whose mapping states channels and no arms, is left as it is.

    >>> table = Table("a.csv", {"t": np.arange(2.0), "left_fx": np.ones(2), "right_fx": np.zeros(2)})
    >>> left, right = tables_of_arms(table, Mapping(arms=("left", "right")))
    >>> right.name, list(right.columns), right.facts
    ('a.csv#right', ['t', '{arm}_fx'], {'arm': 'right'})
    """
    arms = mapping.arms
    if not (arms or mapping.channels or "arm" in mapping.columns or "arm" in table.facts):
        arms = arms_of(name for name, values in table.columns.items() if values.dtype.kind != "U")
    marks = {arm: mark_of(arm) for arm in arms}
    owners = {name: next((arm for arm, mark in marks.items() if mark.search(name)), "") for name in table.columns}
    there = [arm for arm in arms if arm in owners.values()]
    if not there:
        yield table
    for arm in there:
        own = {name: marks[arm].sub(PLACE, name) for name, owner in owners.items() if owner in ("", arm)}
        columns = {title: table.columns[name] for name, title in own.items()}
        units = {title: table.units[name] for name, title in own.items() if name in table.units}
        part = f"{table.part}#{arm}" if table.part else arm
        facts = {**table.facts, "arm": arm}
        yield replace(table, name=f"{table.name}#{arm}", columns=columns, units=units, facts=facts, part=part)


def column_of_arms(table: Table, mapping: Mapping, groups: AnyMapping[str, NDArray[Any]]) -> str:
    """The column of text that names several arms in a group of rows; "" = none.

    >>> from rcbht_jax.io.importing.mapping import Value
    >>> table = Table("a.csv", {"trial": np.array([1.0, 1.0]), "arm": np.array(["left", "right"])})
    >>> column_of_arms(table, Mapping(group="trial", columns={"arm": Value("arm")}), {"1": np.arange(2)})
    'arm'
    """
    name = mapping.columns["arm"].column if "arm" in mapping.columns else ""
    column = table.columns.get(name, np.empty(0))
    several = column.dtype.kind == "U" and any(len(set(column[rows].tolist()) - {""}) > 1 for rows in groups.values())
    return name if several and name != mapping.group else ""


def _without(arm: str, names: Iterable[str]) -> set[str]:
    """The names that hold an arm, with its place for it."""
    mark = mark_of(arm)
    return {mark.sub(PLACE, name) for name in names if mark.search(name)}
