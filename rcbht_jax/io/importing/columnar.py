"""Parquet and Arrow tables, and LeRobot data sets of versions 2 and 3."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import require
from rcbht_jax._util.untrusted import (
    MAX_COLUMNS,
    MAX_JSON_BYTES,
    check_declared,
    check_file,
    parse_json,
    read_bytes,
    read_object,
)
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.arrays import reading
from rcbht_jax.io.importing.isolated import apart
from rcbht_jax.io.importing.table import Table

EPISODE = "episode_index"
ARROW = (".feather", ".arrow")  # of tables in Arrow's own formats, files and streams
LIBRARIES = ("pyarrow.parquet", "pandas")  # of those that read Parquet; pyarrow imports pandas with its first column
_OWN = ("index", "frame_index", EPISODE, "task_index", "next.done", "timestamp")
_BOOKKEEPING = ("dataset_from_index", "dataset_to_index", "length")  # of an episode; names of others have a "/"


@apart(*LIBRARIES)
def read_parquet(path: Path, name: str) -> Iterator[Table]:
    """The table of a Parquet or Arrow file.

    Lists of a fixed number of elements are columns ``name_0``, ``name_1``, ..., fields of structures ``name.field``.

    >>> [table.columns["Fz"].shape for table in read_parquet(Path("run.parquet"), "run.parquet")]
    [(400,)]

    Raises:
        InputError: not a regular file, damaged, declares a table too large for it, or pyarrow is missing.
    """
    columns: dict[str, NDArray[Any]] = {}
    others = list[str]()  # of lists of several lengths
    with reading(path, "Parquet or Arrow"):
        pa, table = require("pyarrow", "import"), _table(path)
        step = float((table.schema.metadata or {}).get(b"dt_seconds") or 0)
        while any(pa.types.is_struct(field.type) for field in table.schema):
            table = table.flatten()
        kinds = {field.name: kind for field in table.schema if (kind := _kind(pa, field.type))}
        for key, kind in kinds.items():
            column = table.column(key).combine_chunks()
            if kind != "list":
                columns[key] = _array(pa, column, kind)
            elif (wide := _wide(column)) is not None and len(columns) + wide.shape[1] <= MAX_COLUMNS:
                columns |= {f"{key}_{number}": wide[:, number] for number in range(wide.shape[1])}
            else:
                others.append(key)
        if not columns or not len(next(iter(columns.values()))):
            raise InputError(f"{path} has no rows of numbers or text.")
        rate = 1 / step if step > 0 else None
    units = {key: "s" for key, kind in kinds.items() if kind == "time"}
    yield Table(name, columns, rate, units, others=tuple(others))


def _table(path: Path) -> Any:
    """The columns that can be imported, of Parquet, or of Arrow's own formats (Feather)."""
    size = check_file(path)
    pa, pq = require("pyarrow", "import"), require("pyarrow.parquet", "import")
    limits = {"thrift_string_size_limit": 2**24, "thrift_container_size_limit": 2**20}
    with path.open("rb") as raw:  # pyarrow accepts only names in UTF-8
        if path.suffix.lower() in ARROW:
            magic = raw.read(6)
            raw.seek(0)
            options = pa.ipc.IpcReadOptions(use_threads=False)
            opened = pa.ipc.open_file if magic == b"ARROW1" else pa.ipc.open_stream
            with opened(raw, options=options) as file:
                _check_width(path, len(file.schema))
                table = file.read_all()
                check_declared(path, table.nbytes, size)
                return table.select(_usable(pa, file.schema))
        with pq.ParquetFile(raw, **limits) as file:
            meta = file.metadata
            _check_width(path, meta.num_columns)
            groups = [meta.row_group(number) for number in range(meta.num_row_groups)]
            unpacked = sum(group.total_byte_size for group in groups)
            cells = sum(group.column(n).num_values for group in groups for n in range(group.num_columns))
            check_declared(path, max(unpacked, 8 * cells, 8 * meta.num_rows), size)
            # Each thread's stack counts as memory of the child, however many cores there are.
            return file.read(columns=_usable(pa, file.schema_arrow), use_threads=False)


def _check_width(path: Path, columns: int) -> None:
    if columns > MAX_COLUMNS:
        raise InputError(f"{path} has {columns} columns; expected at most {MAX_COLUMNS}.")


def _usable(pa: Any, schema: Any) -> list[str]:
    return [field.name for field in schema if _kind(pa, field.type)]


def _kind(pa: Any, kind: Any) -> str:
    """ "number", "text", "time", "list" or "fields"; "" = nothing that can be imported."""
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return "number"
    if pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_boolean(kind):
        return "text"
    if pa.types.is_time(kind) or pa.types.is_date(kind):  # parts of a time
        return "text"
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return "time"
    if pa.types.is_struct(kind):
        return "fields" if any(_kind(pa, field.type) for field in kind.fields) else ""
    lists = pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind)
    return "list" if lists and _kind(pa, kind.value_type) == "number" else ""


def _array(pa: Any, column: Any, kind: str) -> NDArray[Any]:
    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if pa.types.is_time(column.type) or pa.types.is_date(column.type):
        column = column.cast(pa.string())
    if kind == "text":
        return np.array(["" if value is None else str(value) for value in column.to_pylist()], np.str_)
    if kind == "time":
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[column.type.unit]
        return np.asarray(column.cast(pa.int64()).to_numpy(zero_copy_only=False), np.float64) * scale
    column = column.cast(pa.float64()) if pa.types.is_decimal(column.type) else column
    return np.asarray(column.to_numpy(zero_copy_only=False)).astype(np.float64)


def _wide(column: Any) -> NDArray[np.float64] | None:
    """Lists of one length ``[row, element]``, NaN where a list is missing or empty; None if their lengths differ."""
    lengths = np.nan_to_num(column.value_lengths().to_numpy(zero_copy_only=False)).astype(np.int64)
    width = int(lengths.max(initial=0))
    if not width or not np.isin(lengths, (0, width)).all():
        return None
    wide = np.full((len(lengths), width), np.nan)
    wide[lengths > 0] = column.flatten().to_numpy(zero_copy_only=False).astype(np.float64).reshape(-1, width)
    return wide


def read_lerobot(folder: Path, name: str) -> Iterator[Table]:
    """A table per episode of a LeRobot data set of version 2 or 3: its frames; names and tasks as facts.

    Elements of a feature carry their names where ``meta/info.json`` lists them.

    Raises:
        InputError: not such a data set, another version, or a file of it is damaged.
    """
    info = read_object(folder / "meta" / "info.json")
    version, fps = str(info.get("codebase_version")), info.get("fps")
    if not version.startswith(("v2", "v3")):
        raise InputError(
            f"{folder} is a LeRobot data set of version {version}; expected v2.0 to v3.0. Convert it with LeRobot."
        )
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e6:
        raise InputError(f"{folder}/meta/info.json: fps is {fps!r}; expected frames per second.")
    episodes = _episodes(folder)
    names = _element_names(info)
    files = sorted((folder / "data").glob("*/*.parquet"))
    if not files:
        raise InputError(f"{folder} has no data/*/*.parquet.")
    for path in files:
        [table] = read_parquet(path, "")
        columns = {names.get(key, key): values for key, values in table.columns.items()}
        if EPISODE not in columns:
            raise InputError(f"{path} has no column {EPISODE}.")
        for episode in np.unique(columns[EPISODE]):
            rows = columns[EPISODE] == episode
            part = {key: values[rows] for key, values in columns.items() if key not in _OWN}
            number = f"{int(episode):06d}"
            facts, place = episodes.get(int(episode), {}), number if name else ""
            yield Table(f"{name}#{number}" if name else number, part, float(fps), facts=facts, part=place)


def _element_names(info: Mapping[str, Any]) -> dict[str, str]:
    """Column of an element -> FEATURE.NAME."""
    features = info.get("features")
    found: dict[str, str] = {}
    for feature, entry in features.items() if isinstance(features, dict) else ():
        listed = entry.get("names") if isinstance(entry, dict) else None
        if isinstance(listed, dict):
            listed = next(iter(listed.values()), None)
        if isinstance(listed, list) and all(isinstance(one, str) for one in listed):
            found |= {f"{feature}_{number}": f"{feature}.{one}" for number, one in enumerate(listed)}
    return found


def _episodes(folder: Path) -> dict[int, dict[str, str | float]]:
    """Facts of each episode; version 2 keeps them as JSON lines."""
    lines = folder / "meta" / "episodes.jsonl"
    if lines.is_file():
        return dict(map(_episode, _rows(lines)))
    files = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    return {int(table.name): dict(table.facts) for path in files for table in _episode_tables(path, "")}


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """The objects of JSON lines, each of an episode."""
    for number, line in enumerate(read_bytes(path, MAX_JSON_BYTES).splitlines(), 1):
        try:
            row = parse_json(line, finite=False) if line.strip() else {EPISODE: -1}
        except ValueError as error:
            raise InputError(f"{path}, line {number} is not JSON: {error}.") from None
        if not isinstance(row, dict) or not isinstance(row.get(EPISODE), int):
            raise InputError(f"{path}, line {number} is not an object with a number {EPISODE!r}.")
        yield row


@apart(*LIBRARIES)
def _episode_tables(path: Path, _: str) -> Iterator[Table]:
    """Facts of the episodes that a Parquet file of a LeRobot data set describes: tables without columns."""
    size = check_file(path)
    with reading(path, "Parquet"), path.open("rb") as raw:
        file = require("pyarrow.parquet", "import").ParquetFile(raw)
        check_declared(path, file.metadata.num_rows * 8, size)
        wanted = [key for key in file.schema_arrow.names if key not in _BOOKKEEPING and "/" not in key]
        for row in file.read(columns=wanted, use_threads=False).to_pylist():
            number, facts = _episode(row)
            yield Table(str(number), {}, facts=facts)


def _episode(row: Mapping[str, Any]) -> tuple[int, dict[str, str | float]]:
    """The number of an episode, and the numbers and texts that describe it, with its tasks."""
    plain = {key: value for key, value in row.items() if isinstance(value, str | int | float)}
    number = int(plain.pop(EPISODE))
    if isinstance(row.get("tasks"), list):
        plain["task"] = "; ".join(map(str, row["tasks"]))
    kept = {key: value for key, value in plain.items() if key not in _BOOKKEEPING}
    return number, {key: value if isinstance(value, str) else float(value) for key, value in kept.items()}
