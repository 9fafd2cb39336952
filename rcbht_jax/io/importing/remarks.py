"""Remarks on tables as they were understood, and on what a mapping names and they do not have."""

from __future__ import annotations

import re
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import split_unit
from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import names
from rcbht_jax.io.importing.guess import FEWEST, some
from rcbht_jax.io.importing.mapping import Mapping, Value
from rcbht_jax.io.importing.record import no_column
from rcbht_jax.io.importing.rows import filled, without_stand_ins
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.timing import are_dates, is_clock
from rcbht_jax.io.importing.words import OUTCOMES, text, words_of_numbers

_USUAL = (999.0, 9999.0, 99999.0, 999999.0, 32768.0)  # of either sign
_HUGE = 1e15  # no sensor measures as much
_FAR = 5  # times the largest other value


def remarks_on(table: Table, mapping: Mapping, base: Mapping) -> list[str]:
    """Remarks on a table, of whose mapping ``base`` was stated and the rest guessed.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> table = Table("a.csv", {"c0": np.arange(4.0)}, lines=("mean",))
    >>> [remark[:40] for remark in remarks_on(table, Mapping((Channel("c0"),)), Mapping())]
    ['Columns have no names, so nothing says w', 'Lines that are no samples were left out:']
    """
    guessed = [] if base.channels else [find(table, mapping) for find in (_more_wrenches, _nameless, _as_pose)]
    lost = {
        "Arrays of another shape or kind were left out": table.others,
        "Lines that are no samples were left out": table.lines,
        "Words in columns of numbers were read as missing values": table.faults,
    }
    listed = [f"{what}: {some(those)}." for what, those in lost.items() if those]
    return [*filter(None, guessed), *listed, *([] if base.channels or base.annotations else _one_hot(table))]


def doubts_on(table: Table, mapping: Mapping) -> list[str]:
    """Warnings about a table: its rows may be of several sensors, or a number may stand for missing values.

    >>> from rcbht_jax.io.importing.mapping import Channel
    >>> columns = {"Fz": np.arange(8.0), "sensor": np.array(["left", "right"] * 4)}
    >>> doubts_on(Table("a.csv", columns), Mapping((Channel("Fz"),)))
    ['rows alternate between the values of sensor; if it names sensors, separate them with --group sensor.']
    """
    return [doubt for doubt in (_interleaved(table, mapping), _stand_ins(table, mapping)) if doubt]


def _more_wrenches(table: Table, mapping: Mapping) -> str:
    """A remark on wrenches that are not imported; "" = there are none, or the mapping is not of a wrench."""
    taken = {channel.column for channel in mapping.channels}
    found = names.wrenches(name for name, values in table.columns.items() if values.dtype.kind != "U")
    others = [wrench["Fx"] for wrench in found if not taken & set(wrench.values())]
    own = next((wrench for wrench in found if taken & set(wrench.values())), {})
    if not own or not others:
        return ""
    return (
        f"{len(found)} wrenches were found, and that of {own['Fx']} was taken; to import that of {some(others)}, name "
        "its channels with --map. If each is of an arm, list the words that differ there instead: arms = [..., ...]."
    )


def _nameless(table: Table, mapping: Mapping) -> str:
    """A remark on channels that have only the numbers of columns without names; "" = they have names."""
    columns = [channel.column for channel in mapping.channels]
    if not columns or not all(re.fullmatch(r"(?:c|values_)\d+", column) for column in columns):
        return ""
    return (
        "Columns have no names, so nothing says which are axes of a wrench: write the mapping with --write-map, give "
        "its channels the names Fx ... Mz and their units, and import again with --map."
    )


def _as_pose(table: Table, mapping: Mapping) -> str:
    """A remark on columns that may be torques after those of forces, and are read as a position; "" = none may."""
    columns = list(table.columns)
    forces = next((channel.column for channel in mapping.channels if channel.name == "Fz"), "")
    after = columns[columns.index(forces) + 1 :][:4] if forces and "Mx" not in mapping.axes else []
    bases = "".join(split_unit(name)[0].lower()[-2:] for name in after)
    if bases not in ("txtytzrx", "txtytzqx"):
        return ""
    how = f"if they are torques, say so in their names, such as {after[0]} [Nm], or in a map."
    return f"{after[0]} ... {after[2]} are read as a position, since {after[3]} follows; {how}"


def _one_hot(table: Table) -> list[str]:
    """A remark on each run of columns of 0 and 1 of which just one is 1 in every row: a label for each."""
    flags = {name for name, one in table.columns.items() if one.dtype.kind != "U" and ((one == 0) | (one == 1)).all()}
    found = []
    for are_flags, run in groupby(table.columns, flags.__contains__):
        listed = list(run)
        if are_flags and len(listed) > 1 and (np.sum([table.columns[name] for name in listed], 0) == 1).all():
            first = next((name for name in listed if 0 < table.columns[name].sum() < len(table.columns[name])), "")
            entry = f'track = "label", column = "{first}", words = {{"1" = "{first}"}}, ignore = ["0"]'
            how = f"a map reads each column by [[annotations]] with {entry}."
            found += [f"{some(listed)} look like labels, of which one is 1 in each row; {how}"] if first else []
    return found


def _interleaved(table: Table, mapping: Mapping) -> str:
    """A warning about a column of text that changes with nearly every sample, as names of sensors do; "" = none."""
    own = {mapping.time, mapping.group, mapping.columns.get("arm", Value()).column}
    samples = np.isfinite(np.stack([table.columns[channel.column] for channel in mapping.channels], 1)).any(1)
    for name, column in ((name, column[samples]) for name, column in table.columns.items() if name not in own):
        if column.dtype.kind != "U" or 2 * (column[1:] != column[:-1]).sum() <= len(column):
            continue
        several = 1 < len(np.unique(column[column != ""])) <= len(column) / FEWEST
        if several and not are_dates(column) and not is_clock(column):
            how = f"if it names sensors, separate them with --group {name}."
            return f"rows alternate between the values of {name}; {how}"
    return ""


def _stand_ins(table: Table, mapping: Mapping) -> str:
    """A warning about a number in the channels that may stand for missing values; "" = there is none."""
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


class Lacks:
    """Tables without a column of annotations, or one that describes recordings: these are imported without it."""

    def __init__(self, mapping: Mapping) -> None:
        """Take the mapping of all tables."""
        tracks = {track.column: f"annotations {track.track}" for track in mapping.annotations if track.column}
        facts = {value.column: f"column {name}" for name, value in mapping.columns.items() if value.column}
        self._roles, self._held, self._folded = tracks | facts, set[str](), set(facts)
        self._unread: dict[str, str] = {}  # column -> a table that has it and from which no recording was read
        self._folders = {name: value for name, value in mapping.columns.items() if value.folder}
        self._strange = {name: set(value.words) - set(OUTCOMES) for name, value in self._folders.items()}
        self._lacking: list[tuple[str, str, str, str]] = []  # table, what it lacks, sentence, warning
        words = {track.column: {*track.words, *track.ignore} for track in mapping.annotations if track.column}
        words |= {value.column: set(value.words) - set(OUTCOMES) for value in mapping.columns.values() if value.column}
        self._unmatched = {column: those for column, those in words.items() if those}
        self._arms = {arm.lower(): arm for arm in mapping.arms}  # that no table has

    def add(self, table: Table, read: bool = True) -> None:
        """Take a table, and whether recordings were read from it."""
        self._arms.pop(str(table.facts.get("arm", "")).lower(), None)
        for column, role in self._roles.items():
            if (column in table.columns or column in table.facts) and read:
                self._held.add(column)
            elif column in table.columns:
                self._unread.setdefault(column, table.name)
            elif read:
                warning = f"has no column {column!r}, so no {role}."
                self._lacking.append((table.name, column, no_column(table, column), warning))
        for name, value in self._folders.items():
            what = f"folder {value.folder}"
            if folder := value.folder_of(table.file):
                self._held.add(what)
                self._strange[name].difference_update((folder, folder.lower()))
            elif read:
                lies = f"lies in no {what} of the source, so no column {name}."
                self._lacking.append((table.name, what, f"{table.name} {lies}", lies))
        for column, words in self._unmatched.items():
            values = table.columns.get(column)
            there = [table.facts.get(column, "")] if values is None else set(values[filled(values)].tolist())
            seen = {text(value) for value in there}
            seen |= {value.lower() for value in seen if column in self._folded}  # labels are taken as they are written
            words -= {word for word in words if not seen.isdisjoint(words_of_numbers({word: word}))}

    def warnings(self) -> list[tuple[str, str]]:
        """A warning about each table that lacks a column, or lies in no folder that names one.

        Raises:
            InputError: no table has the column, or lies in such a folder.
        """
        alone = {column: name for column, name in self._unread.items() if column not in self._held}
        if wrong := next((sentence for _, what, sentence, _ in self._lacking if what not in {*self._held, *alone}), ""):
            raise InputError(wrong)
        how = "if its rows describe the recordings, add a column 'file' with their names."
        found = [
            (name, f"alone has a column {column!r} and is no recording, so no {self._roles[column]}; {how}")
            for column, name in alone.items()
        ]
        return found + [(name, warning) for name, what, _, warning in self._lacking if what not in alone]

    def remarks(self) -> list[str]:
        """Remarks on words and arms of the mapping that no table has."""
        wrong = {f"are no values of column {column!r}": words for column, words in self._unmatched.items()}
        wrong |= {f"for column {name} are no folders": words for name, words in self._strange.items()}
        pairs = ((what, ", ".join(map(repr, sorted(words)))) for what, words in wrong.items() if words)
        found = [f"These words of the map {what}: {several}." for what, several in pairs]
        arms = ", ".join(map(repr, self._arms.values()))
        return [*found, *([f"No column names these arms of the map: {arms}."] if arms else [])]
