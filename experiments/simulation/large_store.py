"""Stores of up to a million recordings: describing one, reading one trial, encoding and classifying all of them.

Recordings of 2.5 s are random walks in two phases. Eight parts of a store are made and repeated, names included, each
with files of its own; no measurement depends on repeated names. Memory is the largest of a command.

Run: python -m experiments.simulation.large_store WORK [--sizes 10000 100000 1000000] [--worked 4000 16000 64000]
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from experiments._lib.results_io import defaults_of, given, write_result
from rcbht_jax.annotations import Annotations
from rcbht_jax.io import store_writer
from rcbht_jax.io.store_schema import schema_of
from rcbht_jax.types import Recordings

PART, SAMPLES, DISTINCT, DT = 1000, 500, 8, 0.005
READ = 200  # trials
MEASURE = """
import json, sys, time
from pathlib import Path
import numpy as np
from rcbht_jax.io import store
path, count = Path(sys.argv[1]), int(sys.argv[2])
rows = np.random.default_rng(0).integers(0, store.count_recordings(path), count + 1)
seconds = []
for row in rows:
    start = time.perf_counter()
    one = store.read_rows(path, [int(row)])
    seconds.append(time.perf_counter() - start)
    assert one.wrench.any()
print(json.dumps(seconds[1:]))
"""


def recordings(seed: int) -> Recordings:
    """One part: random walks, faster in the second phase."""
    rng = np.random.default_rng(seed)
    speed = np.where(np.arange(SAMPLES) < SAMPLES // 2, 0.05, 0.5)[None, :, None]
    wrench = np.cumsum(rng.normal(0, 1, (PART, SAMPLES, 6)) * speed, 1).astype(np.float32)
    names = np.array([f"walk-{seed}-{row:04d}" for row in range(PART)])
    starts, length = np.tile([0.0, SAMPLES // 2 * DT], (PART, 1)), np.full(PART, SAMPLES, np.int32)
    marks = Annotations.from_starts("states", ("slow", "fast"), starts, length * DT)
    fixed = {name: np.full(PART, text) for name, text in (("arm", "R"), ("source", "walks"), ("session", "1"))}
    outcome = np.where(rng.random(PART) < 0.5, "success", "failure")
    return Recordings(
        wrench=wrench, length=length, dt=DT, trial=names, outcome=outcome, note=np.full(PART, ""), annotations=marks,
        **fixed,
    )  # fmt: skip


def make(path: Path, count: int) -> None:
    """A store of ``count`` recordings, a multiple of those of a part."""
    shutil.rmtree(path, ignore_errors=True)
    whole = count // PART
    made = [recordings(seed) for seed in range(min(DISTINCT, whole))]
    store_writer.create(path, schema_of(made[0], None, count, PART), {"importer": "repetition"}, "undated")
    for number, part in enumerate(made):
        store_writer.write_part(path, number, part)
    for metadata in path.rglob("zarr.json"):
        dimensions = json.loads(metadata.read_text()).get("dimension_names") or [""]
        if dimensions[0] in ("trial", "part"):
            for number in range(len(made), whole):
                repeat(metadata.parent / "c", number % len(made), number)
    store_writer.finish(path)


def repeat(chunks: Path, first: int, second: int) -> None:
    """Copy the chunks of one part to another."""
    source, target = chunks / str(first), chunks / str(second)
    if source.is_dir():
        shutil.copytree(source, target)
    elif source.exists():  # else all is zero there
        shutil.copyfile(source, target)


def rcbht(*words: str | Path) -> tuple[float, float]:
    """Run a command; seconds and the largest resident memory in GB."""
    # users keep what Python has compiled: without that, a command compiles all that it imports each time
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    command = [sys.executable, "-m", "rcbht_jax", *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=env)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"rcbht {words[0]} failed")
    return time.perf_counter() - start, usage.ru_maxrss * 1024 / 1e9


def reading(path: Path) -> dict[str, Any]:
    """Times of describing a store and of reading single trials."""
    info = [rcbht("info", path) for _ in range(3)]
    found = subprocess.run([sys.executable, "-c", MEASURE, path, str(READ)], check=True, capture_output=True, text=True)
    seconds = json.loads(found.stdout)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return {
        "store_GB": round(size / 1e9, 2),
        "info_s": round(statistics.median(seconds for seconds, _ in info), 2),
        "one_trial_ms": round(1e3 * statistics.median(seconds), 1),
        "one_trial_p95_ms": round(1e3 * float(np.percentile(seconds, 95)), 1),
    }


def working(path: Path, model: Path, folder: Path) -> dict[str, Any]:
    """Memory and time of encoding and classifying a whole store."""
    encoded = rcbht("encode", path, "--window", "5", "--robot", "hiro")
    classified = rcbht("classify", path, "-m", model, "-o", folder / "classes.csv")
    names = ("encode_s", "encode_GB", "classify_s", "classify_GB")
    return {name: round(value, 2) for name, value in zip(names, (*encoded, *classified), strict=True)}


def rows_of(sizes: Iterable[int], path: Path, measure: Any) -> dict[str, Any]:
    """A row for each size of the store, which is deleted afterwards."""
    rows = {}
    for count in sizes:
        make(path, count)
        rows[str(count)] = measure(path)
        shutil.rmtree(path)
    return rows


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    sizes: tuple[int, ...] = (10_000, 100_000, 1_000_000),
    worked: tuple[int, ...] = (4_000, 16_000, 64_000),
) -> None:
    """Measure and store."""
    path, model = folder / "walks.zarr", folder / "states.model"
    read = rows_of(sizes, path, reading)
    make(path, PART)
    rcbht("encode", path, "--window", "5", "--robot", "hiro")
    rcbht("train", path, "-o", model)
    work = rows_of(worked, path, lambda store: working(store, model, folder))
    command = "python -m experiments.simulation.large_store WORK" + given(locals(), defaults_of(main))
    result = {"samples": SAMPLES, "trials_read": READ, "read": read, "worked": work}
    write_result("large_store", command, result, 0)


if __name__ == "__main__":
    tyro.cli(main)
