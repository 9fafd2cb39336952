"""JSON lines: an object per sample, as ``rcbht stream -`` reads them, or with any other fields."""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.untrusted import MAX_COLUMNS, MAX_TABLE_LINE, parse_json
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.cells import texts
from rcbht_jax.io.importing.rows import MAX_GROUPS
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.text import LETTERS, cut_off
from rcbht_jax.io.importing.unpacked import opened

PHASE = "phase"  # column of the numbers of sub-tasks, where lines state their beginnings
# Units of the readings of a stream, and of a ROS wrench.
UNITS = {f"wrench_{axis}": "N" if axis < 3 else "Nm" for axis in range(6)} | {
    f"wrench.{part}.{axis}": unit for part, unit in (("force", "N"), ("torque", "Nm")) for axis in "xyz"
}


def read_json_lines(path: Path, name: str) -> Iterator[Table]:
    """The tables of a file of JSON lines: a row per object.

    Fields of objects within objects are columns ``name.field``, elements of lists of numbers ``name_0``, ``name_1``,
    ...; null and a field that is not there are missing values. As in a stream (:mod:`rcbht_jax.io.messages`),
    ``{"reset": true}`` begins a table of its own, and ``{"begin": true}`` a sub-task: their numbers are the column
    ``phase``. A last line that was cut off while the log was written is left out.

    >>> text = '{"time": 0, "wrench": [0.5, 2]}\\n{"begin": true}\\n{"time": 0.1, "wrench": [null, 3]}\\n'
    >>> _ = Path("run.jsonl").write_text(text)
    >>> [table] = read_json_lines(Path("run.jsonl"), "run.jsonl")
    >>> {key: values.tolist() for key, values in table.columns.items()}
    {'time': [0.0, 0.1], 'wrench_0': [0.5, nan], 'wrench_1': [2.0, 3.0], 'phase': ['', '1']}

    Raises:
        InputError: not a regular file, too large, a line that is no object of JSON, events that ``rcbht stream`` wrote,
            text in a column of numbers, or too many columns; the sentence names the line.
    """
    parts, lines = [Rows()], tuple[str, ...]()
    with opened(path) as file:
        for number, line in enumerate(iter(lambda: file.readline(MAX_TABLE_LINE), b""), 1):
            try:
                if line.strip():
                    _add(parts, _object(line))
            except (ValueError, OverflowError) as error:  # a whole number may be too large for a float
                if not (parts[-1].count and _is_cut(line, error)):
                    raise InputError(f"{path}, line {number}: {error}.") from None
                lines = (cut_off(line[:LETTERS].decode("utf-8", "ignore")),)
    parts = [rows for rows in parts if rows.count]
    if not parts:
        raise InputError(f"{path} has no line with a number or a text.")
    for place, rows in enumerate(parts):
        part = str(place) if len(parts) > 1 else ""
        units = UNITS if "wrench_6" not in rows.values else {}
        of = f"{name}#{part}" if part else name
        left, others = lines if rows is parts[-1] else (), tuple(sorted(rows.others))
        notes = ("lines:1",) if left else ()
        yield Table(of, rows.columns(path), units=units, others=others, part=part, lines=left, notes=notes)


@dataclass
class Rows:
    """Rows of one table so far; a number takes 8 bytes.

    >>> rows = Rows()
    >>> rows.add_object({"t": 0, "force": {"x": 1.5}})
    >>> {key: values.tolist() for key, values in rows.columns(Path("a.json")).items()}
    {'t': [0.0], 'force.x': [1.5]}
    """

    count: int = 0
    values: dict[str, array[float] | list[str]] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)  # fields that cannot be columns
    begun: int = 0  # sub-tasks

    def add_object(self, value: Mapping[str, Any]) -> None:
        """Add the columns of an object, and the number of the sub-task if one has begun.

        Raises:
            ValueError: text in a column of numbers, or the reverse, or too many columns.
        """
        row: dict[str, float | str] = {}
        for key, one in value.items():
            _flatten(key, one, row, self.others)
        if row:
            self.add(row | ({PHASE: str(self.begun)} if self.begun and PHASE not in row else {}))

    def add(self, row: Mapping[str, float | str]) -> None:
        """Add values by their columns; the other columns miss one."""
        for key, value in row.items():
            if key not in self.values:
                self.values[key] = [""] * self.count if isinstance(value, str) else array("d", [np.nan]) * self.count
            column = self.values[key]
            if isinstance(column, list) != isinstance(value, str):
                kinds = ("a text", "a number") if isinstance(value, str) else ("a number", "a text")
                raise ValueError(f"{key} is {kinds[0]}; before, it was {kinds[1]}")
            column.append(value)  # type: ignore[arg-type]  # its kind was compared above
        self.count += 1
        for column in self.values.values():
            if len(column) < self.count:
                column.append(np.nan) if isinstance(column, array) else column.append("")
        if len(self.values) > MAX_COLUMNS:
            raise ValueError(f"there are more than {MAX_COLUMNS} columns")

    def columns(self, path: Path) -> dict[str, NDArray[Any]]:
        """Columns ``[row]`` of numbers, or texts; ``path`` is named where a text is too long."""
        return {
            key: np.array(values) if isinstance(values, array) else texts(values, f"{path}, column {key}")
            for key, values in self.values.items()
        }


def _object(line: bytes) -> dict[str, Any]:
    if len(line) == MAX_TABLE_LINE and not line.endswith(b"\n"):
        raise ValueError(f"it has more than {MAX_TABLE_LINE} bytes")
    value = parse_json(line.removeprefix(b"\xef\xbb\xbf"), finite=False)
    if not isinstance(value, dict):
        raise ValueError("it is no object; expected {...}")
    if isinstance(value.get("event"), str) and "wrench" not in value:
        raise ValueError("it is an event that rcbht stream wrote; the readings are in the file that it read")
    return value


def _is_cut(line: bytes, error: Exception) -> bool:
    """Whether a line that is no JSON has no end, as the last one of a log that was cut off while it was written."""
    return not line.endswith(b"\n") and isinstance(error, json.JSONDecodeError | UnicodeDecodeError)


def _add(parts: list[Rows], value: dict[str, Any]) -> None:
    """Add a line to the last table, or begin one."""
    flags = [key for key in ("reset", "begin") if isinstance(value.get(key), bool)]
    if value.get("reset") is True and parts[-1].count:
        if len(parts) == MAX_GROUPS:
            raise ValueError(f"there are more than {MAX_GROUPS} recordings; split the file")
        parts.append(Rows())
    now = parts[-1]
    now.begun += value.get("begin") is True
    now.add_object({key: one for key, one in value.items() if key not in flags})


def _flatten(name: str, value: Any, row: dict[str, float | str], others: set[str]) -> None:
    """Add the columns of a field to those of its row."""
    if isinstance(value, dict):
        for key, one in value.items():
            _flatten(f"{name}.{key}", one, row, others)
    elif isinstance(value, list) and all(map(_is_number, value)):
        row.update({f"{name}_{place}": one for place, one in enumerate(value) if one is not None})
    elif isinstance(value, list):
        others.add(name)
    elif isinstance(value, bool):
        row[name] = str(value).lower()
    elif value is not None:
        row[name] = value
    if len(row) > MAX_COLUMNS:
        raise ValueError(f"there are more than {MAX_COLUMNS} columns")


def _is_number(value: Any) -> bool:
    """Whether it is a number or null."""
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
