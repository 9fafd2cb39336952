"""LeRobotDataset v3 layout: one episode per recording, frames in ``data/``, everything else in ``meta/``.

Source: the LeRobotDataset v3.0 documentation (folder layout, ``meta/info.json``, statistics per episode).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError
from rcbht_jax.io.export import tables
from rcbht_jax.io.export.card import write_card
from rcbht_jax.io.export.dataset import DataSet, codes_at_samples, states_at_samples
from rcbht_jax.io.export.tables import Table
from rcbht_jax.labels import LAYERS

VERSION = "v3.0"
CHUNK, FILE_BYTES = 1000, 100 * 2**20  # files per folder; largest file, before compression
QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

_LAYOUT = """LeRobotDataset v3.0: `LeRobotDataset("any/name", root="this folder")` reads it. One episode is one
recording (one arm of one trial); names, outcome and further columns are in `meta/episodes`, annotations in
`annotations.parquet`. The tasks are the data sets. There are no actions and no images.

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
    episodes, total = _write_frames(data, folder, fps, tasks, progress)
    if intervals := tables.intervals(data.recordings):
        _write_table(intervals, folder / "annotations.parquet")
    meta = folder / "meta"
    (meta / "episodes" / "chunk-000").mkdir(parents=True)
    flat = {key: [episode[key] for episode in episodes] for key in episodes[0]}
    _write_table(flat, meta / "episodes" / "chunk-000" / "file-000.parquet")
    named = pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks, name="task"))
    named.to_parquet(meta / "tasks.parquet")
    _write_json(meta / "info.json", _info(data, fps, len(tasks), len(episodes), total))
    _write_json(meta / "stats.json", _total(episodes))
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


def _info(data: DataSet, fps: int, tasks: int, episodes: int, frames: int) -> dict[str, Any]:
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
        "features": _features(data.tracks is not None, list(data.recordings.axes)),
    }


def _frames(data: DataSet, row: int, fps: int, first: int, task: int) -> Table:
    """Features of one episode: ``[frame]`` or ``[frame, axis]``."""
    recordings, samples = data.recordings, int(data.recordings.length[row])
    number = np.arange(samples, dtype=np.int64)
    table: Table = {
        "observation.wrench": recordings.wrench[row, :samples],
        "observation.state_index": states_at_samples(recordings, row).astype(np.int64),
    }
    if data.tracks is not None:
        codes = codes_at_samples(data.tracks, row, samples).astype(np.int64)
        table |= {f"observation.label.{layer}": codes[:, place] for place, layer in enumerate(LAYERS)}
    return table | {
        "next.done": number == samples - 1,
        "timestamp": (number / fps).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(samples, row, np.int64),
        "index": first + number,
        "task_index": np.full(samples, task, np.int64),
    }


def _write_frames(
    data: DataSet, folder: Path, fps: int, tasks: list[str], progress: Callable[[int], None]
) -> tuple[list[dict[str, Any]], int]:
    """Write the frames, one row group per episode.

    Returns:
        the rows of ``meta/episodes`` and the number of frames.
    """
    pa, pq = require("pyarrow", "export"), require("pyarrow.parquet", "export")
    names = tables.trials(data.recordings)
    episodes: list[dict[str, Any]] = []
    first, file, written, writer = 0, 0, 0, None
    try:
        for row in range(len(data.recordings)):
            task = str(data.recordings.source[row]) or "unnamed"
            frames = _frames(data, row, fps, first, tasks.index(task))
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
            columns = {key: values[row].item() for key, values in names.items() if key not in ("recording", "samples")}
            episodes.append(
                {
                    "episode_index": row, "tasks": [task], "length": last - first,
                    "dataset_from_index": first, "dataset_to_index": last,
                    "data/chunk_index": chunk, "data/file_index": place,
                    "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
                    **columns, **_statistics(frames),
                }
            )  # fmt: skip
            first = last
            progress(1)
    finally:
        if writer is not None:
            writer.close()
    return episodes, first


def _column(pa: Any, values: NDArray[Any]) -> Any:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), values.shape[1])


def _statistics(frames: Table) -> dict[str, list[Any]]:
    """``stats/FEATURE/STATISTIC`` of one episode: lists of one value per element, ``count`` of one number."""
    statistics: dict[str, list[Any]] = {}
    for key, values in frames.items():
        wide = values.reshape(len(values), -1).astype(np.float64)
        moments = {"min": wide.min(0), "max": wide.max(0), "mean": wide.mean(0), "std": wide.std(0)}
        levels = zip(QUANTILES, np.quantile(wide, QUANTILES, 0), strict=True)
        quantiles = {f"q{100 * q:02.0f}": level for q, level in levels}
        statistics |= {f"stats/{key}/{name}": value.tolist() for name, value in (moments | quantiles).items()}
        statistics[f"stats/{key}/count"] = [len(values)]
    return statistics


def _total(episodes: list[dict[str, Any]]) -> dict[str, dict[str, list[Any]]]:
    """Statistics of all frames; quantiles are means over the episodes, weighted by frames, as in LeRobot."""
    weight = np.array([episode["length"] for episode in episodes], np.float64)[:, None]
    total: dict[str, dict[str, list[Any]]] = {}
    for path in (key for key in episodes[0] if key.startswith("stats/")):
        key, name = path.removeprefix("stats/").rsplit("/", 1)
        total.setdefault(key, {})[name] = _combined(name, _stacked(episodes, path), weight).tolist()
    for key, statistics in total.items():
        means = _stacked(episodes, f"stats/{key}/mean")
        within = _stacked(episodes, f"stats/{key}/std") ** 2
        variance = ((within + (means - statistics["mean"]) ** 2) * weight).sum(0) / weight.sum()
        statistics["std"] = np.sqrt(variance).tolist()
    return total


def _stacked(episodes: Iterable[dict[str, Any]], path: str) -> NDArray[Any]:
    return np.array([episode[path] for episode in episodes])


def _combined(name: str, values: NDArray[Any], weight: NDArray[np.float64]) -> NDArray[Any]:
    if name in ("min", "max"):
        return values.min(0) if name == "min" else values.max(0)
    return values.sum(0) if name == "count" else (values * weight).sum(0) / weight.sum()


def _write_table(columns: Mapping[str, Any], path: Path) -> None:
    require("pyarrow.parquet", "export").write_table(require("pyarrow", "export").table(columns), path)


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
