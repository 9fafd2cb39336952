"""One function that exports: checks, writes into a draft beside the target, renames it when complete."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError
from rcbht_jax.events import SubtaskStarted
from rcbht_jax.io.export import tables
from rcbht_jax.io.export.card import write_card
from rcbht_jax.io.export.dataset import DataSet, codes_at_samples
from rcbht_jax.io.export.lerobot import write_lerobot
from rcbht_jax.io.export.tables import Table
from rcbht_jax.io.rosbags import McapWriter

Progress = Callable[[int], None]  # called with the number of recordings done since the last call

_TABLES = """* `trials.{0}`: one row per recording: names, outcome, further columns;
* `annotations.{0}`: one row per annotated interval, where there are some;
* {1};
* `labels.{0}`: one row per label, where labels are included;
* `simulation.{0}`: parameters and ground truth of the simulation, where the trials were simulated;
* `dataset.json`: sampling period, columns with units, alphabets, provenance."""


def export(data: DataSet, out: Path, kind: str, progress: Progress = lambda _: None) -> None:
    """Write a data set as a new folder, atomically.

    >>> data = load(Path("hiro.zarr"), window=5)  # doctest: +SKIP
    >>> export(data, Path("hiro-parquet"), "parquet")  # doctest: +SKIP

    Args:
        data: made by :func:`rcbht_jax.io.export.load`.
        out: folder to create; nothing is ever replaced.
        kind: one of ``FORMATS``: "parquet", "lerobot", "mcap" or "csv".
        progress: called with the number of recordings done since the last call.

    Raises:
        InputError: ``out`` exists or has no parent, the format is unknown or cannot hold the data, a package is
            missing, or a name cannot be written as UTF-8.
    """
    if kind not in FORMATS:
        raise InputError(f"{kind!r} is not a format; expected one of {', '.join(FORMATS)}.")
    check_target(out)
    _check_names(data)
    with atomic_folder(out) as draft:
        draft.mkdir()
        FORMATS[kind](data, draft, progress)


def check_target(out: Path) -> None:
    """Check that a folder can be created at ``out``.

    Raises:
        InputError: ``out`` exists, or its parent does not.
    """
    if not out.name or not out.parent.is_dir():
        raise InputError(f'"{out}" cannot be created: {out.parent} is not a folder, or there is no name.')
    if os.path.lexists(out):
        raise InputError(f"{out} exists already; choose another name, or move it away.")


def _check_names(data: DataSet) -> None:
    for field in (*tables.TEXTS, *data.recordings.columns):
        for row, text in enumerate(data.recordings.column(field).tolist()):
            try:
                str(text).encode()
            except UnicodeEncodeError:
                raise InputError(f"The {field} of recording {row} is {text!r}, which is not valid Unicode.") from None


def _parquet(data: DataSet, folder: Path, progress: Progress) -> None:
    pa, pq = require("pyarrow", "export"), require("pyarrow.parquet", "export")
    period = {"dt_seconds": repr(data.recordings.dt)}

    pq.write_table(pa.table(tables.trials(data.recordings)), folder / "trials.parquet")
    for title, rows in _optional(data):
        pq.write_table(pa.table(rows), folder / f"{title}.parquet")
    schema = pa.table(tables.wrench(data.recordings, 0)).schema.with_metadata(period)
    with pq.ParquetWriter(folder / "wrench.parquet", schema) as writer:
        for row in range(len(data.recordings)):
            writer.write_table(pa.table(tables.wrench(data.recordings, row), schema=schema))
            progress(1)
    writer = None
    try:
        for part in tables.labels(data):
            table = pa.table(part)
            writer = writer or pq.ParquetWriter(folder / "labels.parquet", table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()
    layout = "`wrench.parquet`: one row per sample, one row group per recording"
    write_card(data, folder, _TABLES.format("parquet", layout))


def _optional(data: DataSet) -> list[tuple[str, Table]]:
    """Tables that not every data set has, with their names."""
    both = (("annotations", tables.intervals(data.recordings)), ("simulation", tables.simulation(data)))
    return [(title, table) for title, table in both if table]


def _write_csv(path: Path, table: Table, *, header: bool = True) -> None:
    """Append a table; numbers are the shortest text that reads back equal, NaN is empty."""
    columns = [
        ["" if text == "nan" else text for text in values.astype(str).tolist()]
        if values.dtype.kind == "f"
        else values.tolist()
        for values in table.values()
    ]
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if header:
            writer.writerow(table)
        writer.writerows(zip(*columns, strict=True))


def _csv(data: DataSet, folder: Path, progress: Progress) -> None:
    _write_csv(folder / "trials.csv", tables.trials(data.recordings))
    for title, rows in _optional(data):
        _write_csv(folder / f"{title}.csv", rows)
    for number, table in enumerate(tables.labels(data)):
        _write_csv(folder / "labels.csv", table, header=number == 0)
    (folder / "wrench").mkdir()
    for row in range(len(data.recordings)):
        _write_csv(folder / "wrench" / f"{row:06d}.csv", tables.wrench(data.recordings, row))
        progress(1)
    write_card(data, folder, _TABLES.format("csv", "`wrench/NNNNNN.csv`: one row per sample of recording N"))


def _mcap(data: DataSet, folder: Path, progress: Progress) -> None:
    _write_csv(folder / "trials.csv", tables.trials(data.recordings))
    for title, rows in _optional(data):
        _write_csv(folder / f"{title}.csv", rows)
    for row in range(len(data.recordings)):
        _mcap_recording(data, row, folder / f"{row:06d}.mcap")
        progress(1)
    layout = (
        "* `NNNNNN.mcap`: recording N, from time 0: `/wrench` (geometry_msgs/WrenchStamped), `/labels` (whenever one "
        "changes; online labels appear when they were published), `/events` (starts of annotated intervals);\n"
        "* `trials.csv`: one row per recording: names, outcome, further columns;\n"
        "* `annotations.csv`: one row per annotated interval, where there are some;\n"
        "* `dataset.json`: sampling period, columns with units, alphabets, provenance."
    )
    write_card(data, folder, layout)


def _mcap_recording(data: DataSet, row: int, path: Path) -> None:
    recordings, samples = data.recordings, int(data.recordings.length[row])
    codes = None if data.tracks is None else codes_at_samples(data.tracks, row, samples)
    begins = set(np.rint(recordings.annotations.begins(row) / recordings.dt).astype(int).tolist())
    with McapWriter(path, recordings.axes) as mcap:
        for sample, values in enumerate(recordings.wrench[row, :samples].astype(float).tolist()):
            time = sample * recordings.dt
            if sample in begins:
                mcap.event(SubtaskStarted(sample, time, sample, False))
            mcap.wrench(time, tuple(values))
            if codes is not None and (sample == 0 or (codes[sample] != codes[sample - 1]).any()):
                mcap.labels(time, codes[sample])


FORMATS: dict[str, Callable[[DataSet, Path, Progress], None]] = {
    "parquet": _parquet,
    "lerobot": write_lerobot,
    "mcap": _mcap,
    "csv": _csv,
}
