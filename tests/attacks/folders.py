"""Readers of what other programs and earlier runs leave: exports, bags, monitors, segmenters, unfinished syntheses."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from rcbht_jax._util.digest import content_hash
from rcbht_jax.introspection import nominal_file, segmenter_file
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.introspection.segmenter_stream import SegmenterStream
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.store_schema import open_store
from rcbht_jax.types import Recordings
from sim_mjx.synthesis import shards
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import manifest_of
from sim_mjx.synthesis.workers import SynthesisProgress
from tests.attacks import mutations
from tests.attacks.readers import Reader, finite
from tests.io.importing.test_readers import write_ros1
from tests.support.fake_simulation import SMALL, fake_engine


def recordings(names: tuple[str, ...] = ("a", "b")) -> Recordings:
    """Short recordings of these names, with intervals and columns."""
    rng = np.random.default_rng(0)
    rows = [(0, "phase", "free", 0.0, 0.1), (len(names) - 1, "phase", "push", 0.1, float("nan"))]
    return Recordings.from_arrays(
        [rng.normal(size=(40, 6)) for _ in names], 200.0, annotations=rows, trial=list(names),
        depth=np.linspace(0, 1, len(names)),
    )  # fmt: skip


def _export(kind: str) -> Callable[[Path], None]:
    return lambda path: export(DataSet.of(recordings()), path, kind)


def _imported(kind: str) -> Callable[[Path], Any]:
    def read(path: Path) -> list[Any]:
        found = read_source(path, kind).recordings
        return [found.wrench, found.dt]

    return read


def _make_monitor(path: Path) -> None:
    rng = np.random.default_rng(0)
    monitor = NominalMonitor(rate=20, score_rate=20, memory=0.05)
    monitor.fit([rng.normal(size=(40, 2)) for _ in range(8)])
    nominal_file.save(path, nominal_file.MonitorFile(monitor, ("Fx", "Fy"), ()))


def _make_segmenter(path: Path) -> None:
    data = recordings(("a", "b", "c"))
    segmenter = WrenchSegmenter(trees=3).fit(data, [np.arange(40) // 20] * 3)
    segmenter_file.save(path, segmenter_file.SegmenterFile.of(segmenter, "phase", ("free", "contact")))


def _beliefs(path: Path) -> list[float]:
    """Of a few samples of whatever axes the file names."""
    file = segmenter_file.load(path)
    beliefs = SegmenterStream(file).push(np.ones((20, len(file.axes))))
    return [number for belief in beliefs for number in belief.probabilities]


def _make_work(path: Path) -> None:
    """The work folder of a synthesis that was interrupted after two of three shards."""
    shown = []

    def stop(progress: SynthesisProgress) -> None:
        shown.append(progress)
        if len(shown) == 3:
            raise KeyboardInterrupt

    target = path.with_name(path.name.removesuffix(".work"))
    with suppress(KeyboardInterrupt):
        synthesise(target, SMALL, simulate=fake_engine, progress=stop)
    assert shards.finished(path) == {0, 1}


def _renewed(path: Path) -> dict[int, str]:
    """Digests of the shards that a run which goes on believes, in a copy of the work folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / path.name
        shutil.copytree(path, folder, symlinks=True, copy_function=_copy)
        shards.begin(folder, manifest_of(SMALL))
        shards.renew(folder)
        members = sorted(open_store(shards.store_of(folder)).members(None), key=lambda member: member[0])
        arrays = [one for _, one in members if isinstance(one, zarr.Array)]
        return {shard: _content(arrays, shard) for shard in shards.finished(folder)}


def _content(arrays: list[Any], shard: int) -> str:
    """Digest of what the arrays hold of a shard: a file may be another one and hold the same."""
    rows = {"trial": slice(shard * SMALL.shard, (shard + 1) * SMALL.shard), "part": slice(shard, shard + 1)}
    held = [(one, rows.get((one.metadata.dimension_names or ("",))[0])) for one in arrays]
    return content_hash([np.asarray(one[span].tolist()) for one, span in held if span is not None])


def _believed(good: dict[int, str], found: dict[int, str]) -> str:
    return "" if found.items() <= good.items() else "a shard is believed that is not as it was written"


def _copy(source: str, target: str, *, follow_symlinks: bool = True) -> str:
    """A copy of a file, also of one that is none: a pipe is another pipe."""
    if Path(source).is_fifo():
        mutations.pipe(Path(target))
        return target
    return shutil.copy2(source, target, follow_symlinks=follow_symlinks)


READERS = (
    *(Reader(f"export-{kind}", _export(kind), _imported(kind), None, finite) for kind in ("csv", "parquet", "mcap")),
    Reader("export-lerobot", _export("lerobot"), _imported("lerobot"), None, finite),
    Reader("run.bag", write_ros1, _imported("bag"), mutations.damaged, finite),
    Reader("monitor", _make_monitor, lambda path: nominal_file.load(path).monitor.peaks_, mutations.damaged_archive,
           finite),
    Reader("segmenter", _make_segmenter, _beliefs, mutations.damaged_archive, finite),
    Reader("trials.zarr.work", _make_work, _renewed, None, _believed),
)  # fmt: skip
