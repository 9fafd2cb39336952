"""One function that exports: checks, writes into a draft beside the target, renames it when complete."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.cells import cell
from rcbht_jax.annotations import nearest_samples
from rcbht_jax.errors import InputError
from rcbht_jax.io.checks import check_text
from rcbht_jax.io.export import tables
from rcbht_jax.io.export.card import write_card
from rcbht_jax.io.export.dataset import Block, DataSet, codes_at_samples
from rcbht_jax.io.export.lerobot import EPISODE, write_lerobot
from rcbht_jax.io.export.parquet import ParquetFiles
from rcbht_jax.io.export.tables import Table
from rcbht_jax.types import Recordings

Progress = Callable[[int], None]  # called with the number of recordings done since the last call
ROWS = 2**16  # of a table whose texts are in memory at the same time

_TABLES = """* `trials.{0}`: one row per recording: names, outcome, further columns;
* `annotations.{0}`: one row per annotated interval, where there are some;
* {1};
* `labels.{0}`: one row per label, where labels are included;
* `simulation.{0}`: parameters and ground truth of the simulation, where the trials were simulated;
* `dataset.json`: sampling period, columns with units, alphabets, provenance."""


def export(data: DataSet, out: Path, kind: str, progress: Progress = lambda _: None) -> None:
    """Write a data set as a new folder, atomically.

    >>> from rcbht_jax.io.export import load
    >>> export(load(Path("trials.zarr"), window=5), Path("trials-csv"), "csv")

    Args:
        data: made by :func:`rcbht_jax.io.export.load`.
        out: folder to create; nothing is ever replaced.
        kind: one of ``FORMATS``: "parquet", "lerobot", "mcap" or "csv".
        progress: called with the number of recordings done since the last call.

    Raises:
        InputError: ``out`` exists or has no parent, the format is unknown or cannot hold the data, a package is
            missing, a name cannot be written as UTF-8, or a column has the name of the number of recordings.
    """
    if kind not in FORMATS:
        raise InputError(f"{kind!r} is not a format; expected one of {', '.join(FORMATS)}.")
    check_target(out)
    _check_names(data, kind)
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


def _check_names(data: DataSet, kind: str) -> None:
    numbers = {"recording"} | (set(EPISODE) if kind == "lerobot" else set())
    if taken := sorted(numbers & set(data.recordings.columns)):
        raise InputError(f"The column {taken[0]} would take the place of one that {kind} files have; rename it first.")
    beside = set(tables.SAMPLE) if kind in ("csv", "parquet") else set()
    if taken := sorted(beside & set(data.recordings.axes)):
        raise InputError(f"The axis {taken[0]} would take the place of a column of {kind} files; rename it first.")
    for field in (*tables.TEXTS, *data.recordings.columns):
        if (texts := data.recordings.column(field)).dtype.kind == "U":
            check_text(f"The {field}", texts.tolist())
    try:
        json.dumps([dict(data.attrs), dict(data.tracks_attrs)], ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise InputError("The store's attributes of its origin are not valid Unicode; correct them.") from None


def _parquet(data: DataSet, folder: Path, progress: Progress) -> None:
    with ParquetFiles(folder, {"wrench": {"dt_seconds": repr(data.recordings.dt)}}) as files:
        files.add("trials", tables.trials(data.recordings))
        for title, rows in tables.optional(data):
            files.add(title, rows)
        for block in data.blocks():
            for row in range(len(block.recordings)):
                files.add("wrench", tables.wrench(block, row))
                progress(1)
            for rows in tables.labels(block):
                files.add("labels", rows)
        files.flush()
    layout = "`wrench.parquet`: one row per sample, recordings one after the other, none in two row groups"
    write_card(data, folder, _TABLES.format("parquet", layout))


def _write_csv(path: Path, table: Table) -> None:
    """Append a table; a new file begins with its header.

    Numbers are the shortest text that reads back equal, NaN is empty; formulas are text (:mod:`rcbht_jax._util.cells`).
    """
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if file.tell() == 0:
            writer.writerow(map(cell, table))
        for part in _slices(len(next(iter(table.values())))):
            writer.writerows(zip(*(_texts(values[part]) for values in table.values()), strict=True))


def _texts(values: NDArray[Any]) -> list[Any]:
    if values.dtype.kind == "f":
        return ["" if text == "nan" else text for text in values.astype(str).tolist()]
    return [cell(value) for value in values.tolist()]


def _slices(rows: int) -> Iterator[slice]:
    return (slice(first, first + ROWS) for first in range(0, rows, ROWS))


def _write_about(data: DataSet, folder: Path) -> None:
    """The tables about recordings."""
    _write_csv(folder / "trials.csv", tables.trials(data.recordings))
    for title, rows in tables.optional(data):
        _write_csv(folder / f"{title}.csv", rows)


def _csv(data: DataSet, folder: Path, progress: Progress) -> None:
    _write_about(data, folder)
    (folder / "wrench").mkdir()
    for block in data.blocks():
        for table in tables.labels(block):
            _write_csv(folder / "labels.csv", table)
        for row in range(len(block.recordings)):
            _write_csv(folder / "wrench" / f"{block.first + row:06d}.csv", tables.wrench(block, row))
            progress(1)
    write_card(data, folder, _TABLES.format("csv", "`wrench/NNNNNN.csv`: one row per sample of recording N"))


def _mcap(data: DataSet, folder: Path, progress: Progress) -> None:
    _write_about(data, folder)
    for block in data.blocks():
        for row in range(len(block.recordings)):
            _mcap_recording(block, row, folder / f"{block.first + row:06d}.mcap")
            progress(1)
    layout = (
        "* `NNNNNN.mcap`: recording N, from time 0: `/wrench` (geometry_msgs/WrenchStamped; `/signal` where axes or "
        "units are not those of one), `/labels` (whenever one changes; online labels appear when they were published), "
        "`/events` (a JSON text where an annotated interval begins: label, track, start and end in s);\n"
        "* `trials.csv`: one row per recording: names, outcome, further columns;\n"
        "* `annotations.csv`: one row per annotated interval, where there are some;\n"
        "* `simulation.csv`: parameters and ground truth of the simulation, where the trials were simulated;\n"
        "* `dataset.json`: sampling period, columns with units, alphabets, provenance."
    )
    write_card(data, folder, layout)


def _mcap_recording(block: Block, row: int, path: Path) -> None:
    from rcbht_jax.io.rosbags import McapWriter  # of the extra stream, which no other format needs

    recordings, samples = block.recordings, int(block.recordings.length[row])
    codes = None if block.tracks is None else codes_at_samples(block.tracks, row, samples)
    begins = _intervals_at(recordings, row)
    with McapWriter(path, recordings.axes, recordings.units) as mcap:
        wrench = recordings.wrench[row, :samples]
        for sample, values in enumerate(
            one for part in _slices(samples) for one in wrench[part].astype(float).tolist()
        ):
            time = sample * recordings.dt
            for interval in begins.get(sample, ()):
                mcap.interval(time, **interval)
            mcap.wrench(time, tuple(values))
            if codes is not None and (sample == 0 or (codes[sample] != codes[sample - 1]).any()):
                mcap.labels(time, codes[sample])


def _intervals_at(recordings: Recordings, row: int) -> dict[int, list[dict[str, Any]]]:
    """Every annotated interval of a recording, by the sample at which it begins; those outside by the first or last."""
    marks, samples = recordings.annotations.of_recording(row), int(recordings.length[row])
    at = nearest_samples(marks.start, samples, recordings.dt).clip(0, samples - 1).astype(int)
    found: dict[int, list[dict[str, Any]]] = {}
    ends = (None if np.isnan(end) else end for end in marks.end.tolist())
    tracks = (marks.tracks[track] for track in marks.track.tolist())
    for sample, *interval in zip(at.tolist(), marks.names().tolist(), tracks, marks.start.tolist(), ends, strict=True):
        found.setdefault(sample, []).append(dict(zip(("label", "track", "start", "end"), interval, strict=True)))
    return found


FORMATS: dict[str, Callable[[DataSet, Path, Progress], None]] = {
    "parquet": _parquet,
    "lerobot": write_lerobot,
    "mcap": _mcap,
    "csv": _csv,
}
