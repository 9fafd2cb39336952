"""One function that exports: checks, writes into a draft beside the target, renames it when complete."""

from __future__ import annotations

import csv
import importlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax.errors import InputError
from rcbht_jax.events import SubtaskStarted
from rcbht_jax.io.export import card, tables
from rcbht_jax.io.export.dataset import DataSet, codes_at_samples
from rcbht_jax.io.export.tables import Table
from rcbht_jax.io.rosbags import McapWriter

Progress = Callable[[int], None]  # called with the recordings done since the last call

_TABLES = """* `trials.{0}`: one row per recording: names, outcome, starts of states;
* {1};
* `labels.{0}`: one row per label, where labels are included;
* `simulation.{0}`: what the simulation drew and knew, where the trials were simulated;
* `dataset.json`: sampling period, columns with units, alphabets, provenance."""


def export(data: DataSet, out: Path, kind: str, progress: Progress = lambda _: None) -> None:
    """Write a data set as a new folder, atomically: it is complete or not there.

    Args:
        data: see :func:`rcbht_jax.io.export.load`.
        out: folder to create; nothing is ever replaced.
        kind: one of ``FORMATS``.
        progress: called with the number of recordings done since the last call.

    Raises:
        InputError: ``out`` is taken or has no parent, the format is unknown, a library is missing, a name cannot be
            written as UTF-8, or the format cannot hold the data.
    """
    if kind not in FORMATS:
        raise InputError(f"{kind!r} is not a format; expected one of {', '.join(FORMATS)}.")
    check_target(out)
    _check_names(data)
    with atomic_folder(out) as draft:
        draft.mkdir()
        FORMATS[kind](data, draft, progress)
        if os.path.lexists(out):
            raise InputError(f"{out} was made by someone else meanwhile; choose another name.")


def check_target(out: Path) -> None:
    """Check that a folder may be made at ``out``.

    Raises:
        InputError: it may not.
    """
    if not out.name or not out.parent.is_dir():
        raise InputError(f'"{out}" cannot be made: {out.parent} is not a folder, or there is no name.')
    if os.path.lexists(out):
        raise InputError(f"{out} exists already; choose another name, or move it away.")


def require(module: str) -> ModuleType:
    """Import a library of the extra ``export``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise InputError(f"This format needs {name}; install the extra: pip install 'rcbht-jax[export]'.") from error


def _check_names(data: DataSet) -> None:
    for field in tables.TEXTS:
        for row, text in enumerate(getattr(data.recordings, field).tolist()):
            try:
                text.encode()
            except UnicodeEncodeError:
                raise InputError(f"The {field} of recording {row} is {text!r}, which is not valid Unicode.") from None


def _finish(data: DataSet, folder: Path, layout: str) -> None:
    (folder / "README.md").write_text(card.card(data, layout), encoding="utf-8")
    text = json.dumps(card.description(data), indent=1, ensure_ascii=False)
    (folder / "dataset.json").write_text(text + "\n", encoding="utf-8")


def _parquet(data: DataSet, folder: Path, progress: Progress) -> None:
    pa, pq = require("pyarrow"), require("pyarrow.parquet")
    period = {"dt_seconds": repr(data.recordings.dt)}

    pq.write_table(pa.table(tables.trials(data.recordings)), folder / "trials.parquet")
    if simulation := tables.simulation(data):
        pq.write_table(pa.table(simulation), folder / "simulation.parquet")
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
    _finish(
        data, folder, _TABLES.format("parquet", "`wrench.parquet`: one row per sample, one row group per recording")
    )


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
    if simulation := tables.simulation(data):
        _write_csv(folder / "simulation.csv", simulation)
    for number, part in enumerate(tables.labels(data)):
        _write_csv(folder / "labels.csv", part, header=number == 0)
    (folder / "wrench").mkdir()
    for row in range(len(data.recordings)):
        _write_csv(folder / "wrench" / f"{row:06d}.csv", tables.wrench(data.recordings, row))
        progress(1)
    _finish(data, folder, _TABLES.format("csv", "`wrench/NNNNNN.csv`: one row per sample of recording N"))


def _mcap(data: DataSet, folder: Path, progress: Progress) -> None:
    _write_csv(folder / "trials.csv", tables.trials(data.recordings))
    for row in range(len(data.recordings)):
        _mcap_recording(data, row, folder / f"{row:06d}.mcap")
        progress(1)
    layout = (
        "* `NNNNNN.mcap`: recording N, from time 0: `/wrench` (geometry_msgs/WrenchStamped), `/labels` (whenever one "
        "changes; online labels appear when they were published), `/events` (starts of states, harmonised);\n"
        "* `trials.csv`: one row per recording: names, outcome, starts of states;\n"
        "* `dataset.json`: sampling period, columns with units, alphabets, provenance."
    )
    _finish(data, folder, layout)


def _mcap_recording(data: DataSet, row: int, path: Path) -> None:
    recordings, samples = data.recordings, int(data.recordings.length[row])
    codes = None if data.tracks is None else codes_at_samples(data.tracks, row, samples)
    onsets = recordings.onset_harmonised[row]
    begins = set(np.rint(onsets[np.isfinite(onsets)] / recordings.dt).astype(int).tolist())
    with McapWriter(path) as mcap:
        for sample, values in enumerate(recordings.wrench[row, :samples].astype(float).tolist()):
            time = sample * recordings.dt
            if sample in begins:
                mcap.event(SubtaskStarted(sample, time, sample, False))
            mcap.wrench(time, tuple(values))
            if codes is not None and (sample == 0 or (codes[sample] != codes[sample - 1]).any()):
                mcap.labels(time, codes[sample])


def _lerobot(data: DataSet, folder: Path, progress: Progress) -> None:
    from rcbht_jax.io.export.lerobot import write_lerobot

    write_lerobot(data, folder, progress)


FORMATS: dict[str, Callable[[DataSet, Path, Progress], None]] = {
    "parquet": _parquet,
    "lerobot": _lerobot,
    "mcap": _mcap,
    "csv": _csv,
}
