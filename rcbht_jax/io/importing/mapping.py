"""The meaning of a file's columns as a small TOML file: channels, time, annotations, columns, frame."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping as AnyMapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.columns import SECONDS
from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import MAX_MAP_BYTES, read_bytes
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.conform import checked_rate


@dataclass(frozen=True)
class Channel:
    """One axis of the recordings: ``scale * column + offset``, in ``unit``."""

    column: str
    name: str = ""  # of the axis; "" = that of the column
    unit: str = ""  # after scaling; "" = unknown
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Track:
    """Where a track of annotations comes from: a column, a table of intervals, or lists of times and labels.

    In the name of a file, "{stem}" is the name of the recording's file without suffix, in the same folder, and
    "{folder}" the folder of that file.
    """

    track: str
    column: str = ""  # of the recording: an interval for every stretch of one value
    file: str = ""  # CSV with label, start and perhaps end, track, recording
    ends: str = ""  # text file of the ends of successive intervals, s
    ids: str = ""  # text file of their labels
    clock: str = "start"  # times count from the recording's first sample; "stamps" = they are on its clock
    words: AnyMapping[str, str] = field(default_factory=dict)  # label in the file -> label
    ignore: tuple[str, ...] = ()  # labels that mean that nothing was marked
    starts: str = ""  # text file of the starts of successive intervals, s; one more may end the last
    labels: tuple[str, ...] = ()  # of those intervals, in their order


@dataclass(frozen=True)
class Value:
    """Where a column of the data set comes from; exactly one of four."""

    column: str = ""  # of the recording, constant in it
    table: str = ""  # of the table of recordings
    value: str = ""  # the same for all
    folder: int = 0  # name of a folder of the file below the source: 1 = the outermost, -1 = the innermost
    words: AnyMapping[str, str] = field(default_factory=dict)  # text in the file -> text
    last: bool = False  # whether a column that changes counts with its last value

    def folder_of(self, file: str) -> str:
        """The name of the folder of a file, by its path relative to the source; "" = there is none at that depth.

        >>> Value(folder=1).folder_of("day1/trial7/ft.csv"), Value(folder=3).folder_of("day1/trial7/ft.csv")
        ('day1', '')
        """
        folders = PurePosixPath(file).parent.parts
        place = self.folder - (self.folder > 0)
        return folders[place] if -len(folders) <= place < len(folders) else ""


@dataclass(frozen=True)
class Mapping:
    """The meaning of a file's columns.

    Example:
        >>> mapping = Mapping((Channel("force_z", "Fz", "N"),), time="t_ms", time_unit="ms")
        >>> mapping.axes, mapping.units
        (('Fz',), ('N',))
    """

    channels: tuple[Channel, ...] = ()  # none = those that are guessed
    time: str = ""  # column; "" = none
    time_unit: str = ""  # s, ms, us, ns, min, h, d; "" = that of the column, else s
    nanoseconds: str = ""  # column to add to the seconds of time
    source_rate: float | None = None  # samples per second where there is no time
    topic: str = ""  # of a bag; "" = every topic of wrenches
    group: str = ""  # column whose values separate recordings in one table
    annotations: tuple[Track, ...] = ()
    columns: AnyMapping[str, Value] = field(default_factory=dict)  # outcome, session, arm, ... or any other name
    table: str = ""  # CSV, or JSON list, with a row per recording, relative to the source
    key: str = "file"  # its column with the name of the recording's file, relative to the source
    tare: float = 0.0  # s at the beginning whose mean is subtracted
    bias: tuple[float, ...] = ()  # per channel, subtracted
    rotation: tuple[tuple[float, ...], ...] = ()  # 3x3, applied to forces and moments; or one row x, y, z, w
    rate: float | None = None  # samples per second of the store
    files: tuple[str, ...] = ()  # patterns such as "*_ft.csv" of the files that are recordings; none = all
    arms: tuple[str, ...] = ()  # of a table with columns of several; "{arm}" is their place in the names of columns
    missing: tuple[float, ...] = ()  # numbers in channels that stand for missing values, such as -9999

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(channel.name or channel.column for channel in self.channels)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each axis."""
        return tuple(channel.unit for channel in self.channels)

    def matrix(self) -> Float[np.ndarray, "3 3"] | None:
        """The rotation as a matrix; None = none."""
        if not self.rotation:
            return None
        table = np.array(self.rotation, np.float64)
        return table if table.shape == (3, 3) else _from_quaternion(table[0])


def _from_quaternion(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix of a quaternion x, y, z, w of any length."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    >>> read_mapping(Path("examples/mappings/robot_execution_failures.toml")).group
    'instance'

    Raises:
        InputError: the file is missing, not TOML, or has an unknown key or a wrong value.
    """
    text = read_bytes(path, MAX_MAP_BYTES)
    try:
        content = tomllib.loads(text.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a mapping in TOML: {error}.") from None
    try:
        return check(_mapping(content))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_mapping(path: Path, mapping: Mapping) -> None:
    """Write a mapping file that :func:`read_mapping` reads back equal.

    >>> write_mapping(Path("mine.toml"), Mapping((Channel("Fz", unit="N"),), time="t"))
    >>> read_mapping(Path("mine.toml")).channels[0].unit
    'N'

    Raises:
        InputError: the folder of the file does not exist.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder; create it first.")
    with atomic_write(path) as draft:
        draft.write_text(to_toml(mapping), encoding="utf-8")


def to_toml(mapping: Mapping) -> str:
    """The mapping as text; what is as by default is left out.

    >>> print(to_toml(Mapping((Channel("fz", "Fz"),), time="t")).split("[")[0].strip())
    time = "t"
    """
    lines = _pairs(mapping, skip=("channels", "annotations", "columns"))
    for title, entries in (("channels", mapping.channels), ("annotations", mapping.annotations)):
        for entry in entries:
            lines += ["", f"[[{title}]]", *_pairs(entry)]
    for name, value in mapping.columns.items():
        lines += ["", f"[columns.{_toml(name)}]", *_pairs(value)]
    return "\n".join(lines) + "\n"


def _pairs(entry: Any, skip: tuple[str, ...] = ()) -> list[str]:
    default = {item.name: item.default for item in fields(entry)}
    values = {name: getattr(entry, name) for name in default if name not in skip}
    return [f"{name} = {_toml(value)}" for name, value in values.items() if value not in (default[name], None, {})]


def _toml(value: Any) -> str:
    if isinstance(value, AnyMapping):
        return "{" + ", ".join(f"{_toml(key)} = {_toml(text)}" for key, text in value.items()) + "}"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    # A string of JSON is one of TOML, but for the delete character.
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value if isinstance(value, int) else float(value))


def _mapping(content: dict[str, Any]) -> Mapping:
    parts = dict(content)
    for what, kind in (("channels", Channel), ("annotations", Track)):
        if not isinstance(rows := parts.pop(what, []), list):
            raise InputError(f"{what} is not a list; expected [[{what}]].")
        parts[what] = tuple(_entry(kind, row, what) for row in rows)
    table = parts.pop("columns", {})
    if not isinstance(table, dict):
        raise InputError("columns is not a table; expected [columns.NAME].")
    parts["columns"] = {name: _entry(Value, row, f"columns.{name}") for name, row in table.items()}
    whole: Mapping = _entry(Mapping, parts, "the mapping")
    return whole


def _entry(kind: Any, row: Any, where: str) -> Any:
    if not isinstance(row, dict):
        raise InputError(f"{where}: {row!r} is not a table.")
    known = {item.name: item for item in fields(kind)}
    for key in row:
        if key not in known:
            raise InputError(f"{where} has no key {key!r}; there are {', '.join(known)}.")
    try:
        values = {key: _typed(str(known[key].type), value) for key, value in row.items()}
        return kind(**values)
    except (AttributeError, TypeError, ValueError):
        raise InputError(f"{where} has a missing or wrong value among {', '.join(row) or 'none'}.") from None


def _typed(kind: str, value: Any) -> Any:
    """A value as the field of that type holds it."""
    expected = {"str": str, "bool": bool, "int": int}.get(kind)
    if expected and type(value) is not expected:  # a bool is no int
        raise TypeError
    if kind.startswith("float"):
        if type(value) not in (int, float) or not np.isfinite(value):
            raise TypeError
        return float(value)
    if kind.startswith("tuple["):
        if not isinstance(value, list | tuple):  # a text has letters
            raise TypeError
        return tuple(_typed(kind.removeprefix("tuple[").removesuffix(", ...]"), one) for one in value)
    if kind == "AnyMapping[str, str]":
        return {str(key): _typed("str", text) for key, text in value.items()}
    return value


def check(mapping: Mapping) -> Mapping:
    """The mapping, if it does not contradict itself.

    Raises:
        InputError: names repeat, a unit of time or a rate is impossible, a rotation is invalid, or an entry names
            several sources or none.
    """
    if len(set(mapping.axes)) < len(mapping.axes) or "" in mapping.axes:
        names = ", ".join(map(repr, mapping.axes))
        raise InputError(f"two channels have one name, or one has none: {names}; give each its own.")
    if mapping.time_unit not in ("", *SECONDS):
        raise InputError(f"the unit of time is {mapping.time_unit!r}; expected one of {', '.join(SECONDS)}.")
    for rate in (mapping.rate, mapping.source_rate):
        if rate is not None:
            checked_rate(rate)
    if not 0 <= mapping.tare < np.inf:
        raise InputError(f"the tare lasts {mapping.tare:g} s; expected zero or more seconds.")
    if mapping.key != Mapping.key and not mapping.table:
        raise InputError('key is a column of the table of recordings, and none is named; add table = "FILE.csv".')
    if mapping.nanoseconds and not mapping.time:
        raise InputError("nanoseconds are added to a time, and no column of it is named; add time.")
    if mapping.channels:
        check_bias(mapping, len(mapping.channels))
    _check_rotation(mapping)
    if "" in mapping.arms or len({arm.lower() for arm in mapping.arms}) < len(mapping.arms):
        raise InputError(f"two arms have one name, or one has none: {', '.join(map(repr, mapping.arms))}.")
    for track in mapping.annotations:
        sources = sum(map(bool, (track.column, track.file, track.ends, track.starts)))
        pairs = [(track.ends, track.ids), (track.starts, track.labels)]
        if sources != 1 or any(bool(times) != bool(labels) for times, labels in pairs):
            raise InputError(
                f"track {track.track} needs a column, a file, ends and ids, or starts and labels; one of them."
            )
        if track.clock not in ("start", "stamps"):
            raise InputError(f"the clock of track {track.track} is {track.clock!r}; expected start or stamps.")
    for name, value in mapping.columns.items():
        if sum(map(bool, (value.column, value.table, value.value, value.folder))) != 1:
            raise InputError(f"columns.{name} needs a column, a table, a value or a folder; one of them.")
        if value.table and not mapping.table:
            raise InputError(f'columns.{name} is in a table, and the mapping names none; add table = "FILE.csv".')
    return mapping


def check_bias(mapping: Mapping, channels: int) -> None:
    """InputError: a mapping has a bias, and not for so many channels."""
    if mapping.bias and len(mapping.bias) != channels:
        raise InputError(f"bias has {plural(len(mapping.bias), 'value')} for {plural(channels, 'channel')}.")


def _check_rotation(mapping: Mapping) -> None:
    shape = [len(row) for row in mapping.rotation]
    if shape not in ([], [4], [3, 3, 3]) or (shape == [4] and not np.linalg.norm(mapping.rotation[0])):
        raise InputError("the rotation is neither three rows of three numbers nor one row x, y, z, w.")
    matrix = mapping.matrix()
    if matrix is not None and not (np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3) and np.linalg.det(matrix) > 0):
        raise InputError("the rotation is not a rotation: its rows are not three unit vectors of a right-handed frame.")
