"""``rcbht simulate`` on GPUs, from the command to the last byte: with and without programs in the cache, two devices.

Rows "in a process that has compiled" come after a set of one wave of lanes in the same process. Run where there is a
GPU; rows that are measured are kept in FOLDER, and an interrupted run goes on with the others:
python -m experiments.simulation.simulate_gpu FOLDER
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from experiments._lib.results_io import record_of, write_result
from rcbht_jax._util import checkpoint
from sim_mjx.synthesis import launch

ENGINE, PRESET, LONGEST, TRIALS = "fused", "hooked-B", 25.0, 10_000
COMMAND = ("simulate", "--preset", PRESET, "--max-seconds", str(LONGEST), "--engine", ENGINE, "--window", "5")
Row = dict[str, Any]


def in_one_process(folder: Path, trials: int, preset: str) -> Row:
    """A set of trials in a process that has compiled."""
    words = ["--engine", ENGINE, "--preset", preset, "--sections", "synthesis", "--trials", str(trials)]
    # memory as the command takes it
    env = {**os.environ, launch.AS_NEEDED[0]: launch.AS_NEEDED[1], "RCBHT_RESULTS": str(folder)}
    subprocess.run([sys.executable, "-m", "experiments.simulation.engines_gpu", *words], check=True, env=env)
    found: Row = record_of("engines_gpu", folder)["result"]["presets"][preset][ENGINE]["synthesis"][str(trials)]
    return found | {"gpus": 1, "cores": os.cpu_count()}


def command(folder: Path, trials: int, gpus: list[str]) -> Row:
    """Seconds of the command, its start included."""
    target = folder / "trials.zarr"
    words = [*COMMAND, str(target), "--trials", str(trials), "--compile-cache", str(folder / "cache"), "--json"]
    words += ["--devices", "all"] if len(gpus) > 1 else ["--lanes", str(TRIALS)]
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "rcbht_jax", *words], check=True, stdout=subprocess.DEVNULL,
        env={**os.environ, launch.DEVICES: ",".join(gpus)},
    )  # fmt: skip
    seconds = time.perf_counter() - start
    shutil.rmtree(target)
    return {"trials": trials, "gpus": len(gpus), "seconds": round(seconds, 1), "cores": os.cpu_count()}


def rows_for(folder: Path, gpus: list[str]) -> Iterator[tuple[str, Callable[[], Row]]]:
    """Names of the rows, and what measures them; each command after the first finds its programs in the cache."""
    alone = "{:,} trials of {}, one GPU, in a process that has compiled"
    yield alone.format(TRIALS, PRESET), partial(in_one_process, folder, TRIALS, PRESET)
    name = f"{{:,}} trials of {PRESET}, {{}}, command, {{}}"
    for what in ("JAX's programs not compiled", "programs in the cache"):
        yield name.format(TRIALS, "one GPU", what), partial(command, folder, TRIALS, gpus[:1])
    if len(gpus) > 1:
        yield name.format(2 * TRIALS, "two GPUs", what), partial(command, folder, 2 * TRIALS, gpus[:2])
    for count, preset in ((10 * TRIALS, PRESET), (TRIALS, "B")):
        yield alone.format(count, preset), partial(in_one_process, folder, count, preset)


def main(folder: Annotated[Path, tyro.conf.Positional]) -> None:
    """Measure and store."""
    folder.mkdir(parents=True, exist_ok=True)
    gpus = launch.visible_devices()
    here = {"gpus": gpus, "cores": os.cpu_count(), "jax": jax.__version__, "engine": ENGINE, "longest_s": LONGEST}
    kept = folder / "rows.json"
    rows: dict[str, Row] = checkpoint.load(kept, here) or {}
    for name, measure in rows_for(folder, gpus):
        if name not in rows:
            rows[name] = measure()
            checkpoint.save(kept, here, rows)
    card = jax.devices()[0].device_kind.split()[1]  # at the end: from here on this process holds a GPU
    about = {"longest_s": LONGEST, "engine": ENGINE, "rows": {name: row | {"card": card} for name, row in rows.items()}}
    write_result("simulate_gpu", "python -m experiments.simulation.simulate_gpu FOLDER", about, 0)


if __name__ == "__main__":
    tyro.cli(main)
