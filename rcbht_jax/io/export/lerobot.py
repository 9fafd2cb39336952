"""LeRobotDataset v3 layout: one episode per recording, frames in ``data/``, everything else in ``meta/``.

Source: the LeRobotDataset v3.0 documentation (folder layout, ``meta/info.json``, statistics per episode).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError
from rcbht_jax.io.export import tables
from rcbht_jax.io.export.card import write_card
from rcbht_jax.io.export.dataset import Block, DataSet, codes_at_samples, states_at_samples
from rcbht_jax.io.export.parquet import ParquetFiles
from rcbht_jax.io.export.tables import Table
from rcbht_jax.labels import LAYERS

VERSION = "v3.0"
CHUNK, FILE_BYTES = 1000, 100 * 2**20  # files per folder; largest file, before compression
EPISODE = (
    "episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index", "data/chunk_index",
    "data/file_index", "meta/episodes/chunk_index", "meta/episodes/file_index",
)  # LeRobot's own columns of an episode  # fmt: skip
GROUP = 256  # episodes in a row group of their table
QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
_Statistics = dict[str, dict[str, NDArray[Any]]]  # of each feature, by name
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

_LAYOUT = """LeRobotDataset v3.0: `LeRobotDataset("any/name", root="this folder")` reads it. One episode is one
recording (one arm of one trial); names, outcome and further columns are in `meta/episodes`, annotations in
`annotations.parquet`, parameters and ground truth of simulated trials in `simulation.parquet`. The tasks are the data
sets. There are no actions and no images.

* `observation.wrench`: axes and units as in `dataset.json`;
* `observation.state_index`: number, from 0, of the annotated label of the first track of `dataset.json`, or of its
  corrected variant where it has one; -1 = none;
* `observation.label.primitive`, `.mc`, `.llb`: codes per axis, 0 = none. Labels of the streaming encoder start when
  they were published, so that no frame depends on later ones; offline labels cover the span that they describe and
  do depend on later frames;
* `next.done`: true in an episode's last frame."""


def write_lerobot(data: DataSet, folder: Path, progress: Callable[[int], None]) -> None:
    """Fill ``folder`` with a LeRobot data set.

    Raises:
        InputError: pyarrow or pandas is missing, or the sampling rate is not a whole number of hertz.
    """
    pd, fps = require("pandas", "export"), _fps(data.recordings.dt)
    tasks = list(dict.fromkeys(source or "unnamed" for source in data.recordings.source.tolist()))
    meta = folder / "meta"
    (meta / "episodes" / "chunk-000").mkdir(parents=True)
    with ParquetFiles(meta / "episodes", rows=GROUP) as episodes:
        frames, total = _write_frames(data, folder, fps, tasks, episodes, progress)
        episodes.flush()
    with ParquetFiles(folder) as files:
        for title, rows in tables.optional(data):
            files.add(title, rows)
        files.flush()
    named = pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks, name="task"))
    named.to_parquet(meta / "tasks.parquet")
    _write_json(meta / "info.json", _info(data, fps, len(tasks), frames))
    _write_json(meta / "stats.json", _listed(total))
    front = "---\ntags: [LeRobot, robotics, force-torque]\nconfigs:\n- config_name: default\n"
    front += "  data_files: data/*/*.parquet\n---\n"
    write_card(data, folder, _LAYOUT, front)


def _fps(dt: float) -> int:
    fps = round(1 / dt)
    if fps < 1 or abs(fps * dt - 1) > 1e-6:
        raise InputError(
            f"LeRobot needs a whole number of frames per second, but the period is {dt:g} s; choose another format."
        )
    return fps


def _features(labelled: bool, axes: list[str]) -> dict[str, dict[str, Any]]:
    scalar, shape = {"shape": [1], "names": None}, [len(axes)]
    features: dict[str, dict[str, Any]] = {
        "observation.wrench": {"dtype": "float32", "shape": shape, "names": axes},
        "observation.state_index": {"dtype": "int64", **scalar},
    }
    if labelled:
        features |= {
            f"observation.label.{layer}": {"dtype": "int64", "shape": shape, "names": axes} for layer in LAYERS
        }
    features |= {"next.done": {"dtype": "bool", **scalar}, "timestamp": {"dtype": "float32", **scalar}}
    return features | {
        key: {"dtype": "int64", **scalar} for key in ("frame_index", "episode_index", "index", "task_index")
    }


def _info(data: DataSet, fps: int, tasks: int, frames: int) -> dict[str, Any]:
    episodes = len(data.recordings)
    return {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": FILE_BYTES // 2**20,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA,
        "video_path": None,
        "features": _features(bool(data.tracks_name), list(data.recordings.axes)),
    }


def _frames(block: Block, row: int, fps: int, first: int, task: int) -> Table:
    """Features of one episode: ``[frame]`` or ``[frame, axis]``."""
    recordings, samples = block.recordings, int(block.recordings.length[row])
    number = np.arange(samples, dtype=np.int64)
    table: Table = {
        "observation.wrench": recordings.wrench[row, :samples],
        "observation.state_index": states_at_samples(recordings, row).astype(np.int64),
    }
    if block.tracks is not None:
        codes = codes_at_samples(block.tracks, row, samples).astype(np.int64)
        table |= {f"observation.label.{layer}": codes[:, place] for place, layer in enumerate(LAYERS)}
    return table | {
        "next.done": number == samples - 1,
        "timestamp": (number / fps).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(samples, block.first + row, np.int64),
        "index": first + number,
        "task_index": np.full(samples, task, np.int64),
    }


def _write_frames(
    data: DataSet, folder: Path, fps: int, tasks: list[str], episodes: ParquetFiles, progress: Callable[[int], None]
) -> tuple[int, _Statistics]:
    """Write the frames, one row group per episode, and the table of episodes; returns their number and statistics."""
    pa, pq = require("pyarrow", "export"), require("pyarrow.parquet", "export")
    names, ours = tables.trials(data.recordings), {"recording", "samples"} - set(data.recordings.columns)
    first, file, written, writer, total = 0, 0, 0, None, _Statistics()
    try:
        for block, row in ((some, row) for some in data.blocks() for row in range(len(some.recordings))):
            number = block.first + row
            task = str(block.recordings.source[row]) or "unnamed"
            frames = _frames(block, row, fps, first, tasks.index(task))
            table = pa.table({key: _column(pa, values) for key, values in frames.items()})
            if writer is not None and written + table.nbytes > FILE_BYTES:
                writer.close()
                writer, written, file = None, 0, file + 1
            chunk, place = divmod(file, CHUNK)
            if writer is None:
                path = folder / DATA.format(chunk_index=chunk, file_index=place)
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(path, table.schema)
            writer.write_table(table)
            written += table.nbytes
            last = first + len(frames["index"])
            own = ([value] for value in (number, [task], last - first, first, last, chunk, place, 0, 0))
            columns = {key: values[number : number + 1] for key, values in names.items() if key not in ours}
            statistics = _statistics(frames)
            lists = {
                f"stats/{key}/{name}": [v] for key, found in _listed(statistics).items() for name, v in found.items()
            }
            episodes.add("chunk-000/file-000", {**dict(zip(EPISODE, own, strict=True)), **columns, **lists})
            total = {key: _combined(total[key], found) if number else found for key, found in statistics.items()}
            first = last
            progress(1)
    finally:
        if writer is not None:
            writer.close()
    return first, total


def _column(pa: Any, values: NDArray[Any]) -> Any:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), values.shape[1])


def _statistics(frames: Table) -> _Statistics:
    """Of each feature of one episode, by name: one value per element; ``count`` is one number."""
    statistics: _Statistics = {}
    for key, values in frames.items():
        wide = values.reshape(len(values), -1).astype(np.float64)
        moments = {"min": wide.min(0), "max": wide.max(0), "mean": wide.mean(0), "std": wide.std(0)}
        levels = zip(QUANTILES, np.quantile(wide, QUANTILES, 0), strict=True)
        quantiles = {f"q{100 * q:02.0f}": level for q, level in levels}
        statistics[key] = moments | quantiles | {"count": np.array([len(values)])}
    return statistics


def _listed(statistics: _Statistics) -> dict[str, dict[str, list[float]]]:
    return {key: {name: values.tolist() for name, values in found.items()} for key, found in statistics.items()}


def _combined(one: dict[str, NDArray[Any]], two: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Statistics of the frames of both; quantiles are means, weighted by frames, as in LeRobot."""
    frames, more = one["count"], two["count"]
    share = more / (frames + more)
    found = {name: one[name] + share * (two[name] - one[name]) for name in one}
    within = one["std"] ** 2 + share * (two["std"] ** 2 - one["std"] ** 2)
    found["std"] = np.sqrt(within + share * (1 - share) * (two["mean"] - one["mean"]) ** 2)
    found |= {"min": np.minimum(one["min"], two["min"]), "max": np.maximum(one["max"], two["max"])}
    return found | {"count": frames + more}


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
