"""LeRobotDataset v3 layout: one episode per recording, frames in ``data/``, everything else in ``meta/``.

Source: the LeRobotDataset v3.0 documentation (folder layout, ``meta/info.json``, statistics per episode).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.export import card, tables
from rcbht_jax.io.export.dataset import DataSet, codes_at_samples, states_at_samples
from rcbht_jax.io.export.tables import Table
from rcbht_jax.labels import AXES, LAYERS

VERSION = "v3.0"
CHUNK, FILE_BYTES = 1000, 100 * 2**20  # files per folder; largest file, before compression
QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

_LAYOUT = """LeRobotDataset v3.0: `LeRobotDataset("any/name", root="this folder")` reads it. One episode is one
recording (one arm of one trial); names, outcome and starts of states are further columns of `meta/episodes`. Tasks are
the sources. There are no actions and no images.

* `observation.wrench`: Fx Fy Fz Mx My Mz, N and N m;
* `observation.state_index`: 0 approach, 1 rotation, 2 insertion, 3 mating (harmonised); -1 = not known;
* `observation.label.primitive`, `.mc`, `.llb`: codes per axis, 0 = none. Labels of the streaming encoder appear when
  they were published, so that a frame holds nothing of its future; offline labels cover the span that they describe,
  which does use the future;
* `next.done`: true in an episode's last frame."""


def write_lerobot(data: DataSet, folder: Path, progress: Callable[[int], None]) -> None:
    """Fill ``folder`` with a LeRobot data set.

    Raises:
        InputError: pyarrow or pandas is missing, or the sampling rate is no whole number per second.
    """
    from rcbht_jax.io.export.write import require

    pd, fps = require("pandas"), _fps(data.recordings.dt)
    tasks = list(dict.fromkeys(source or "unnamed" for source in data.recordings.source.tolist()))
    episodes, total = _write_frames(data, folder, fps, tasks, progress)
    meta = folder / "meta"
    (meta / "episodes" / "chunk-000").mkdir(parents=True)
    flat = {key: [episode[key] for episode in episodes] for key in episodes[0]}
    _write_table(flat, meta / "episodes" / "chunk-000" / "file-000.parquet")
    named = pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks, name="task"))
    named.to_parquet(meta / "tasks.parquet")
    _write_json(meta / "info.json", _info(data, fps, len(tasks), len(episodes), total))
    _write_json(meta / "stats.json", _total(episodes))
    _write_json(folder / "dataset.json", card.description(data))
    front = "---\ntags: [LeRobot, robotics, force-torque]\nconfigs:\n- config_name: default\n"
    front += "  data_files: data/*/*.parquet\n---\n"
    (folder / "README.md").write_text(card.card(data, _LAYOUT, front), encoding="utf-8")


def _fps(dt: float) -> int:
    fps = round(1 / dt)
    if fps < 1 or abs(fps * dt - 1) > 1e-6:
        raise InputError(
            f"LeRobot counts whole frames per second, but the samples are {dt:g} s apart; choose another format."
        )
    return fps


def _features(labelled: bool) -> dict[str, dict[str, Any]]:
    axes, one = list(AXES), {"shape": [1], "names": None}
    features: dict[str, dict[str, Any]] = {
        "observation.wrench": {"dtype": "float32", "shape": [6], "names": axes},
        "observation.state_index": {"dtype": "int64", **one},
    }
    if labelled:
        features |= {f"observation.label.{layer}": {"dtype": "int64", "shape": [6], "names": axes} for layer in LAYERS}
    features |= {"next.done": {"dtype": "bool", **one}, "timestamp": {"dtype": "float32", **one}}
    return features | {
        key: {"dtype": "int64", **one} for key in ("frame_index", "episode_index", "index", "task_index")
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
        "features": _features(data.tracks is not None),
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
    """Write the frames, one row group per episode; the episodes' rows of ``meta/episodes`` and the number of frames."""
    from rcbht_jax.io.export.write import require

    pa, pq = require("pyarrow"), require("pyarrow.parquet")
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
            known = {key: values[row].item() for key, values in names.items() if key not in ("recording", "samples")}
            episodes.append(
                {
                    "episode_index": row, "tasks": [task], "length": last - first,
                    "dataset_from_index": first, "dataset_to_index": last,
                    "data/chunk_index": chunk, "data/file_index": place,
                    "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
                    **known, **_statistics(frames),
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
    """``stats/FEATURE/WHAT`` of one episode: lists of one value per element, ``count`` of one number."""
    found: dict[str, list[Any]] = {}
    for key, values in frames.items():
        wide = values.reshape(len(values), -1).astype(np.float64)
        moments = {"min": wide.min(0), "max": wide.max(0), "mean": wide.mean(0), "std": wide.std(0)}
        shares = {
            f"q{100 * q:02.0f}": level for q, level in zip(QUANTILES, np.quantile(wide, QUANTILES, 0), strict=True)
        }
        found |= {f"stats/{key}/{what}": value.tolist() for what, value in (moments | shares).items()}
        found[f"stats/{key}/count"] = [len(values)]
    return found


def _total(episodes: list[dict[str, Any]]) -> dict[str, dict[str, list[Any]]]:
    """Statistics of all frames; quantiles are means over the episodes, weighted by frames, as LeRobot's are."""
    weight = np.array([episode["length"] for episode in episodes], np.float64)[:, None]
    total: dict[str, dict[str, list[Any]]] = {}
    for path in (key for key in episodes[0] if key.startswith("stats/")):
        key, what = path.removeprefix("stats/").rsplit("/", 1)
        total.setdefault(key, {})[what] = _combined(what, _stacked(episodes, path), weight).tolist()
    for key, found in total.items():
        means = _stacked(episodes, f"stats/{key}/mean")
        within = _stacked(episodes, f"stats/{key}/std") ** 2
        spread = ((within + (means - found["mean"]) ** 2) * weight).sum(0) / weight.sum()
        found["std"] = np.sqrt(spread).tolist()
    return total


def _stacked(episodes: Iterable[dict[str, Any]], path: str) -> NDArray[Any]:
    return np.array([episode[path] for episode in episodes])


def _combined(what: str, values: NDArray[Any], weight: NDArray[np.float64]) -> NDArray[Any]:
    if what in ("min", "max"):
        return values.min(0) if what == "min" else values.max(0)
    return values.sum(0) if what == "count" else (values * weight).sum(0) / weight.sum()


def _write_table(columns: dict[str, list[Any]], path: Path) -> None:
    from rcbht_jax.io.export.write import require

    require("pyarrow.parquet").write_table(require("pyarrow").table(columns), path)


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
