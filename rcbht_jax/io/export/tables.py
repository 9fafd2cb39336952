"""A data set as flat tables, the same for every format: column name -> values, all of one length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.io.export.dataset import Block, DataSet, words
from rcbht_jax.labels import LAYERS, MEANING, name
from rcbht_jax.types import Recordings

Table = dict[str, NDArray[Any]]

SAMPLE = ("recording", "sample", "time")  # columns beside the axes
TEXTS = ("trial", "arm", "source", "session", "outcome", "note")

COLUMNS = {
    "recording": "number of the recording, from 0: one arm of one trial",
    "trial": "name of the trial; all arms of a trial share it",
    "arm": "arm or sensor",
    "source": "data set",
    "session": "recording session",
    "outcome": "success, failure, unknown, or the data set's own words",
    "note": "flags of the importer, separated by semicolons",
    "samples": "number of samples",
    "seconds": "duration, s",
    "track": "name of a track of annotations",
    "sample": "number of the sample, from 0",
    "time": "s from the first sample",
    "layer": "primitive, mc or llb",
    "axis": "name of the axis",
    "word": "number of the label in its layer and axis, from 0",
    "code": "label as a number, see alphabets",
    "label": "label as a name; of a track, what was annotated",
    "t0, t1": "first sample of the span, and one past its last",
    "start, end": "the span in s; an empty or NaN end = unknown",
    "emit": "samples received when the label was published; -1 = not online",
    "vmax, vmin": "largest and smallest value of the fitted lines, unit of the axis",
    "avg": "mean, unit of the axis",
    "grad": "slope, unit of the axis per s",
}


def trials(recordings: Recordings) -> Table:
    """One row per recording."""
    table: Table = {"recording": np.arange(len(recordings), dtype=np.int32)}
    table |= {field: np.asarray(getattr(recordings, field)) for field in TEXTS}
    table |= {"samples": recordings.length, "seconds": recordings.length * recordings.dt}
    return table | dict(recordings.columns)


def intervals(recordings: Recordings) -> Table:
    """One row per annotated interval; empty without annotations."""
    marks = recordings.annotations
    if not len(marks):
        return {}
    table = {"recording": marks.recording, "track": np.array(marks.tracks)[marks.track], "label": marks.names()}
    return table | {"start": marks.start, "end": marks.end}


def wrench(block: Block, row: int) -> Table:
    """One row per sample of one recording of a block."""
    recordings = block.recordings
    samples = int(recordings.length[row])
    number = np.arange(samples, dtype=np.int32)
    places = (np.full(samples, block.first + row, np.int32), number, number * recordings.dt)
    table: Table = dict(zip(SAMPLE, places, strict=True))
    return table | {axis: recordings.wrench[row, :samples, column] for column, axis in enumerate(recordings.axes)}


def labels(block: Block) -> Iterator[Table]:
    """One row per label, one table per recording of a block."""
    if block.tracks is None:
        return
    for row in range(len(block.recordings)):
        axes = range(len(block.recordings.axes))
        parts = [_sentence(block, row, layer, axis) for layer in LAYERS for axis in axes]
        yield {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}


def _sentence(block: Block, row: int, layer: str, axis: int) -> Table:
    word = words(getattr(block.tracks, layer), row, axis)
    count = len(word["label"])
    names = np.array([name(layer, code) for code in range(len(MEANING[layer]) + 1)])
    return {
        "recording": np.full(count, block.first + row, np.int32),
        "layer": np.full(count, layer),
        "axis": np.full(count, block.recordings.axes[axis]),
        "word": np.arange(count, dtype=np.int32),
        "code": word["label"].astype(np.int8),
        "label": names[word["label"]],
        **{field: word[field].astype(np.int32) for field in ("t0", "t1")},
        "start": word["t0"] * block.recordings.dt,
        "end": word["t1"] * block.recordings.dt,
        "emit": word["emit"].astype(np.int32),
        **{field: word[field].astype(np.float32) for field in ("vmax", "vmin", "avg", "grad")},
    }


def simulation(arrays: Mapping[str, NDArray[Any]], first: int = 0) -> Table:
    """Parameters and ground truth of simulated recordings, one row each; a column per element: ``name[i,j]``.

    Args:
        arrays: ``[recording, ...]`` by name.
        first: number of the first recording.
    """
    count = len(next(iter(arrays.values())))
    table: Table = {"recording": np.arange(first, first + count, dtype=np.int32)}
    for key, values in arrays.items():
        if values.ndim == 1:
            table[key] = values
            continue
        for index in np.ndindex(values.shape[1:]):
            table[f"{key}[{','.join(map(str, index))}]"] = values[(slice(None), *index)]
    return table


def optional(data: DataSet) -> Iterator[tuple[str, Table]]:
    """Tables that not every data set has, with their names; the rows of one may come in several pieces."""
    if marks := intervals(data.recordings):
        yield "annotations", marks
    first = 0
    for arrays in data.simulation():
        yield "simulation", simulation(arrays, first)
        first += len(next(iter(arrays.values())))
