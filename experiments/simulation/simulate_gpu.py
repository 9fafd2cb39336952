"""``rcbht simulate`` on GPUs, from the command to the last byte: nothing compiled, programs in the cache, two devices.

The first rows come after sets of one wave of lanes in the same process. Run where there is a GPU:
python -m experiments.simulation.simulate_gpu FOLDER
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from experiments._lib.results_io import write_result
from sim_mjx.synthesis import launch

ENGINE, PRESET, LONGEST, TRIALS = "warp", "hooked-B", 25.0, 10_000
COMMAND = ("simulate", "--preset", PRESET, "--max-seconds", str(LONGEST), "--engine", ENGINE, "--window", "5")


def in_one_process(folder: Path) -> list[dict[str, Any]]:
    """Sets of trials in a process that has compiled, by parts."""
    out = folder / "in_one_process.json"
    sizes = [str(TRIALS), str(10 * TRIALS)]
    words = ["--engine", ENGINE, "--preset", PRESET, "--sections", "synthesis", "--trials", *sizes, "--out", str(out)]
    env = {**os.environ, launch.AS_NEEDED[0]: launch.AS_NEEDED[1]}  # as the command does
    subprocess.run([sys.executable, "-m", "experiments.simulation.engines_gpu", *words], check=True, env=env)
    found: dict[str, Any] = json.loads(out.read_text())["synthesis"]
    return [found[size] | {"gpus": 1} for size in sizes]


def command(folder: Path, trials: int, gpus: list[str]) -> dict[str, Any]:
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


def main(folder: Annotated[Path, tyro.conf.Positional]) -> None:
    """Measure and store."""
    gpus = launch.visible_devices()
    name = "{:,} trials of {}, one GPU, in a process that has compiled"
    rows = {name.format(row["trials"], PRESET): row for row in in_one_process(folder)}
    for what in ("nothing compiled", "programs in the cache"):
        rows[f"{TRIALS:,} trials of {PRESET}, one GPU, command, {what}"] = command(folder, TRIALS, gpus[:1])
    if len(gpus) > 1:
        name = f"{2 * TRIALS:,} trials of {PRESET}, {{}}, command, programs in the cache"
        rows[name.format("one GPU")] = command(folder, 2 * TRIALS, gpus[:1])
        rows[name.format("two GPUs")] = command(folder, 2 * TRIALS, gpus[:2])
        name = f"{10 * TRIALS:,} trials of {PRESET}, two GPUs, command, programs in the cache"
        rows[name] = command(folder, 10 * TRIALS, gpus[:2])
    card = jax.devices()[0].device_kind.split()[1]
    rows = {name: row | {"card": card} for name, row in rows.items()}
    about = {"longest_s": LONGEST, "engine": ENGINE, "rows": rows}
    write_result("simulate_gpu", "python -m experiments.simulation.simulate_gpu FOLDER", about, 0)


if __name__ == "__main__":
    tyro.cli(main)
