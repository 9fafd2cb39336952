"""``rcbht simulate`` on GPUs, from the command to the last byte: nothing compiled, programs in the cache, two devices.

The first rows come after sets of one wave of lanes in the same process; rows of other presets are kept. Run where
there is a GPU: python -m experiments.simulation.simulate_gpu FOLDER [--preset B]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from experiments._lib.results_io import record_of, write_result
from sim_mjx.synthesis import launch

ENGINE, PRESET, LONGEST, TRIALS = "warp", "hooked-B", 25.0, 10_000
COMMAND = ("simulate", "--max-seconds", str(LONGEST), "--engine", ENGINE, "--window", "5", "--preset")


def in_one_process(folder: Path, preset: str) -> list[dict[str, Any]]:
    """Sets of trials in a process that has compiled, by parts."""
    sizes = [str(TRIALS), str(10 * TRIALS)]
    words = ["--engine", ENGINE, "--preset", preset, "--sections", "synthesis", "--trials", *sizes]
    # memory as the command takes it
    env = {**os.environ, launch.AS_NEEDED[0]: launch.AS_NEEDED[1], "RCBHT_RESULTS": str(folder)}
    subprocess.run([sys.executable, "-m", "experiments.simulation.engines_gpu", *words], check=True, env=env)
    found: dict[str, Any] = record_of("engines_gpu", folder)["result"]["presets"][preset][ENGINE]["synthesis"]
    return [found[size] | {"gpus": 1, "cores": os.cpu_count()} for size in sizes]


def command(folder: Path, preset: str, trials: int, gpus: list[str]) -> dict[str, Any]:
    """Seconds of the command, its start included."""
    target = folder / "trials.zarr"
    words = [*COMMAND, preset, str(target), "--trials", str(trials), "--compile-cache", str(folder / "cache"), "--json"]
    words += ["--devices", "all"] if len(gpus) > 1 else ["--lanes", str(TRIALS)]
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "rcbht_jax", *words], check=True, stdout=subprocess.DEVNULL,
        env={**os.environ, launch.DEVICES: ",".join(gpus)},
    )  # fmt: skip
    seconds = time.perf_counter() - start
    shutil.rmtree(target)
    return {"trials": trials, "gpus": len(gpus), "seconds": round(seconds, 1), "cores": os.cpu_count()}


def main(folder: Annotated[Path, tyro.conf.Positional], preset: str = PRESET) -> None:
    """Measure and store."""
    gpus, timed = launch.visible_devices(), partial(command, folder, preset)
    name = f"{{:,}} trials of {preset}, {{}}"
    compiled, cached = "in a process that has compiled", "command, programs in the cache"
    rows = {name.format(row["trials"], f"one GPU, {compiled}"): row for row in in_one_process(folder, preset)}
    for what in ("command, nothing compiled", cached):
        rows[name.format(TRIALS, f"one GPU, {what}")] = timed(TRIALS, gpus[:1])
    if len(gpus) > 1:
        for trials, count in ((2, 1), (2, 2), (10, 2)):
            title = name.format(trials * TRIALS, f"{('one GPU', 'two GPUs')[count - 1]}, {cached}")
            rows[title] = timed(trials * TRIALS, gpus[:count])
    card = jax.devices()[0].device_kind.split()[1]
    rows = {name: row | {"card": card} for name, row in rows.items()}
    known = record_of("simulate_gpu").get("result", {"rows": {}})["rows"]
    about = {"longest_s": LONGEST, "engine": ENGINE, "rows": known | rows}
    write_result("simulate_gpu", f"python -m experiments.simulation.simulate_gpu FOLDER --preset {preset}", about, 0)


if __name__ == "__main__":
    tyro.cli(main)
