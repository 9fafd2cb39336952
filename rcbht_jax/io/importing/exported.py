"""Reader of the folders of ``rcbht export``: CSV, Parquet, MCAP and LeRobot, with a ``dataset.json``."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.cells import text_of
from rcbht_jax._util.optional import require
from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import MAX_TEXT_BYTES, check_declared, check_file, read_object
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io.checks import validate
from rcbht_jax.io.importing import columnar
from rcbht_jax.io.importing.arrays import reading
from rcbht_jax.io.importing.isolated import apart
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.text import read_csv
from rcbht_jax.io.joining import KEPT, importer_of
from rcbht_jax.io.simulation import origin_of
from rcbht_jax.types import STANDARD_COLUMNS, Recordings

_OURS = ("recording", "samples", "seconds")
_TEXTS = ("trial", *STANDARD_COLUMNS)
_NUMBERS = {"recording": "int64", "samples": "int64", "seconds": "float64", "start": "float64", "end": "float64"}
_KINDS = {"text", "str", "bool"} | {str(np.dtype(code)) for code in "bhilqBHILQefd"}  # of columns, as exports name them
Columns = dict[str, NDArray[Any]]


def read_export(folder: Path) -> Recordings:
    """The recordings of an export, equal to those of the exported store.

    Text and numbers of further columns are distinguished by ``column_types`` of ``dataset.json``; others are text.
    The table of trials may have been sorted: its numbers of recordings say which signals a row is about.

    >>> from rcbht_jax.io.export import export, load
    >>> export(load(Path("trials.zarr"), window=5), Path("exported"), "csv")
    >>> len(read_export(Path("exported")))
    4

    Raises:
        InputError: a file is missing or damaged, or the files contradict each other.
    """
    about = read_object(folder / "dataset.json")
    dt, axes, units = _period(folder, about), *_axes(folder, about)
    if (folder / "meta" / "info.json").is_file():
        values, table = _lerobot(folder, axes), _in_order(folder, _episodes(folder, about))
    else:
        table = _in_order(folder, _table(folder, "trials", about))
        count = len(table.get("trial", ()))
        if (folder / "wrench.parquet").is_file():
            values = list(_parquet(folder / "wrench.parquet", axes, count))
        elif (folder / "wrench").is_dir():
            files = _files(folder / "wrench", "csv", count)
            values = [_csv(path, axes, number) for number, path in enumerate(files)]
        else:
            values = [_mcap(path, axes, units) for path in _files(folder, "mcap", count)]
    if not values or any(len(column) != len(values) for column in table.values()):
        raise InputError(f"{folder} has {plural(len(values), 'recording')}; its table of trials has another number.")
    types = _types(about)
    if "samples" not in types:  # computed ones, not a column of the store
        _check_lengths(folder, table, [len(one) for one in values])
    columns = {name: column for name, column in table.items() if name not in _OURS or name in types}
    texts: dict[str, Any] = {name: columns.pop(name).astype(np.str_) for name in _TEXTS if name in columns}
    marks = _annotations(folder, about, len(values))
    recordings = Recordings.from_arrays(values, axes=axes, units=units, annotations=marks, **texts)
    recordings = replace(recordings, dt=dt, columns=columns)  # exact: the reciprocal of a rate need not be
    try:
        validate(recordings)
    except InputError as error:  # changed values of files without checksums
        raise InputError(f"{folder} is damaged: {error}") from None
    return recordings


def not_read(folder: Path) -> list[str]:
    """What an export holds that :func:`read_export` leaves out."""
    simulated = any((folder / f"simulation.{suffix}").is_file() for suffix in ("csv", "parquet"))
    return ["labels", *(["the table of the simulation"] if simulated else [])]


def attrs_of_export(folder: Path) -> dict[str, str]:
    """What an export states of the origin of its trials, as attributes of a store.

    They are whether the trials were recorded or simulated (:func:`rcbht_jax.io.simulation.origin_of`), what had
    imported them, which the thresholds of "rcbht encode" depend on, and the frames of their axes.
    """
    about = read_object(folder / "dataset.json").get("store")
    if not isinstance(about, dict):
        return {"origin": ""}
    stated = {**about, "origin": origin_of(about), "importer": importer_of(about)}
    texts = {name: stated.get(name) for name in ("origin", *KEPT)}
    return {name: value for name, value in texts.items() if isinstance(value, str) and (value or name == "origin")}


def _period(folder: Path, about: Mapping[str, Any]) -> float:
    dt = about.get("dt")
    if isinstance(dt, bool) or not isinstance(dt, int | float) or not 0 < dt < 1e4:
        raise InputError(f"{folder}/dataset.json: dt is {dt!r}; expected seconds.")
    return float(dt)


def _axes(folder: Path, about: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    axes = about.get("axes")
    if not isinstance(axes, dict) or not axes:
        raise InputError(f"{folder}/dataset.json names no axes with units; expected an export of rcbht 0.2 or later.")
    return tuple(map(str, axes)), tuple(map(str, axes.values()))


def _table(folder: Path, name: str, about: Mapping[str, Any]) -> Columns:
    """A table with a row per recording or interval, from CSV or Parquet; empty if there is none."""
    if (path := folder / f"{name}.parquet").is_file():
        [table] = _parquet_tables(path, name)
        return dict(table.columns)
    if not (path := folder / f"{name}.csv").is_file():
        return {}
    check_file(path, MAX_TEXT_BYTES)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets write a mark of the byte order
            rows = [[text_of(cell) for cell in row] for row in csv.reader(file)]
    except (csv.Error, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}.") from None
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise InputError(f"{path} has lines of different lengths.")
    content = zip(*rows[1:], strict=True) if len(rows) > 1 else [()] * len(rows[0])
    known, pairs = {**_NUMBERS, **_types(about)}, zip(rows[0], content, strict=True)
    return {key: _typed(path, key, cells, known.get(key, "text")) for key, cells in pairs}


def _in_order(folder: Path, table: Columns) -> Columns:
    """The table of trials in the order of its recordings, in which another program need not have left it."""
    if not table:
        return table
    if "recording" not in table:
        raise InputError(
            f"{folder}: the table of trials has no column recording; expected the columns as they were written, "
            "separated by commas."
        )
    numbers = table["recording"]
    order = np.argsort(numbers, kind="stable")
    if not np.array_equal(numbers[order], np.arange(len(numbers))):
        raise InputError(
            f"{folder}: the table of trials does not number its recordings from 0 on, each once, so that signals would "
            "be taken for those of another recording. Export again, and leave its rows complete."
        )
    return {key: values[order] for key, values in table.items()}


def _files(folder: Path, suffix: str, count: int) -> list[Path]:
    """The files of the signals of so many recordings; InputError: there is one more."""
    paths = [folder / f"{number:06d}.{suffix}" for number in range(count + 1)]
    if paths[-1].exists():
        raise InputError(f"{paths[-1]} has no row in the table of trials. Export again, and leave its rows complete.")
    return paths[:-1]


def _check_lengths(folder: Path, table: Columns, lengths: list[int]) -> None:
    for row, (stated, length) in enumerate(zip(table.get("samples", lengths), lengths, strict=True)):
        if stated != length:
            raise InputError(
                f"{folder}: recording {row} has {plural(length, 'sample')}; the table of trials states {stated}. "
                "A file was cut or changed: export again."
            )


def _types(about: Mapping[str, Any]) -> dict[str, str]:
    """Of each column: "text", or the type of its numbers; of an older export, only of those that are always texts."""
    types = about.get("column_types")
    found = {name: str(kind) for name, kind in types.items()} if isinstance(types, dict) else {}
    for name, kind in found.items():
        if kind not in _KINDS:
            raise InputError(f"dataset.json: column {name} is of the type {kind[:40]!r}; expected text or numbers.")
    return dict.fromkeys(_TEXTS, "text") | found


@apart(*columnar.LIBRARIES)
def _parquet_tables(path: Path, name: str) -> Iterator[Table]:
    """A Parquet table of an export, its columns of the types that they were written with."""
    check_declared(path, 0, check_file(path))
    with reading(path, "Parquet"), path.open("rb") as raw:
        file = require("pyarrow.parquet", "import").ParquetFile(raw)
        names = [field.name for field in file.schema_arrow if not field.type.num_fields]  # no lists
        table = file.read(names, use_threads=False)
        columns = {key: table.column(key).to_numpy() for key in table.column_names}
    plain = {key: values.astype(np.str_) if values.dtype.kind == "O" else values for key, values in columns.items()}
    yield Table(name, plain)


def _typed(path: Path, key: str, cells: tuple[str, ...], kind: str) -> NDArray[Any]:
    """Cells of the type of a column; numbers that are empty are NaN."""
    try:
        if kind == "bool":
            return np.array([cell == "True" for cell in cells])
        if kind in ("text", "str") or np.dtype(kind).kind in "iu":
            return np.array(cells, np.str_).astype("U" if kind == "text" else kind)
        return np.array([cell or "nan" for cell in cells], np.float64).astype(kind)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{path}: column {key} does not hold {kind}.") from None


def _csv(path: Path, axes: tuple[str, ...], number: int) -> NDArray[np.float32]:
    [table] = read_csv(path, path.name)
    columns = {text_of(name): values for name, values in table.columns.items()}
    wrench = _wrench(path, columns, axes)
    _check_places(path, columns, np.array([0, len(wrench)]), number)
    return wrench


def _check_places(path: Path, columns: Mapping[str, Any], bounds: NDArray[np.intp], first: int = 0) -> None:
    """Compare the numbers of recordings and samples, which a file of signals states, with those of its rows.

    ``bounds`` are the first row of each recording, from the one with the number ``first``, and the end of the last.
    """
    lengths = np.diff(bounds)
    recording = first + np.repeat(np.arange(len(lengths)), lengths)
    sample = np.arange(bounds[0], bounds[-1]) - np.repeat(bounds[:-1], lengths)
    for name, expected in (("recording", recording), ("sample", sample)):
        if not np.array_equal(columns.get(name), expected):  # type: ignore[arg-type]
            raise InputError(
                f"{path}: the column {name} is not that of an export; rows are missing, doubled or in another order. "
                "Export again."
            )


def _wrench(path: Path, columns: Mapping[str, NDArray[Any]], axes: tuple[str, ...]) -> NDArray[np.float32]:
    if missing := [axis for axis in axes if axis not in columns or columns[axis].dtype.kind == "U"]:
        raise InputError(f"{path} has no numbers for {', '.join(missing)}.")
    return np.stack([columns[axis] for axis in axes], 1).astype(np.float32)


def _parquet(path: Path, axes: tuple[str, ...], count: int) -> Iterator[NDArray[np.float32]]:
    [table] = columnar.read_parquet(path, "")
    columns = table.columns
    if "recording" not in columns:
        raise InputError(f"{path} has no column recording.")
    wrench = _wrench(path, columns, axes)
    bounds = np.searchsorted(columns["recording"], np.arange(count + 1))
    _check_places(path, columns, bounds)
    for first, last in pairwise(bounds.tolist()):
        yield wrench[first:last]


def _mcap(path: Path, axes: tuple[str, ...], units: tuple[str, ...]) -> NDArray[np.float32]:
    from rcbht_jax.io.importing.bags import read_bag_tables  # rosbags is an extra of its own
    from rcbht_jax.io.rosbags import is_wrench

    topic = "/wrench" if is_wrench(axes, units) else "/signal"  # as McapWriter has it
    [table] = read_bag_tables(path, path.name, topic)
    values = [column for key, column in table.columns.items() if key != "stamp"]
    if len(values) != len(axes):
        raise InputError(
            f"{path} has {plural(len(values), 'number')} in a message for {plural(len(axes), 'axis', 'axes')}."
        )
    return np.stack(values, 1).astype(np.float32)


def _lerobot(folder: Path, axes: tuple[str, ...]) -> list[NDArray[np.float32]]:
    """Wrenches of the episodes, in their order."""
    values: list[NDArray[np.float32]] = []
    for episode in columnar.read_lerobot(folder, ""):
        named = {key.removeprefix("observation.wrench."): column for key, column in episode.columns.items()}
        values.append(_wrench(folder, named, axes))
    return values


def _episodes(folder: Path, about: Mapping[str, Any]) -> Columns:
    """The table of trials that is among LeRobot's of the episodes, which keeps numbers as 64 bits."""
    types, table = _types(about), _table(folder / "meta" / "episodes" / "chunk-000", "file-000", about)
    known = {
        key: values if types[key] == "text" else values.astype(types[key])
        for key, values in table.items()
        if key in types
    }
    places = {"recording": "episode_index", "samples": "length"}  # as the tables of the other formats call them
    return {ours: table[theirs] for ours, theirs in places.items() if theirs in table} | known


def _annotations(folder: Path, about: Mapping[str, Any], count: int) -> Annotations:
    labels = about.get("annotations", {})
    lists = list(labels.values()) if isinstance(labels, dict) else [None]
    if not all(isinstance(names, list) and all(isinstance(name, str) for name in names) for names in lists):
        raise InputError(f"{folder}/dataset.json: the labels of the annotations are no table of lists of texts.")
    table = _table(folder, "annotations", {})
    if not table:
        return Annotations(labels={track: tuple(names) for track, names in labels.items()})
    if missing := {"recording", "track", "label", "start", "end"} - set(table):
        raise InputError(f"{folder}: the annotations have no column {', '.join(sorted(missing))}.")
    numbers = table["recording"].astype(np.int32)
    if len(numbers) and not (numbers.min() >= 0 and numbers.max() < count):
        raise InputError(f"{folder}: an annotation is about recording {numbers.max()}; there are {count}.")
    typed: Columns = {"recording": numbers, **{key: table[key].astype(np.float64) for key in ("start", "end")}}
    return Annotations.from_table({**table, **typed}, labels)
