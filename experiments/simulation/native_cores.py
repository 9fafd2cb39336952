"""Threads and processes of the native engine on a machine of many cores: trials of 15 s a minute, compilation apart.

Every process simulates its share of the trials, all from the same moment on; the last one ends the time.
Run: python -m experiments.simulation.native_cores [--cores 32]. Writes experiments/results/native_cores.json.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from typing import Any

import jax
import tyro

from experiments._lib.results_io import write_result
from experiments.simulation.engines import PRESET, SEED, trials_of
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines.native import LANES, THREADS, simulate
from sim_mjx.registry import get_scenario

LONGEST = 9.0  # s, of a trial
PATIENCE = 600.0  # s


def share(number: int, trials: int, threads: int, together: Any, done: Any) -> None:
    """One process: compile, wait for the others, simulate; seconds, processor seconds and simulated seconds."""
    scene = get_scenario(PRESET).scene()
    params = jax.tree.map(lambda leaf: leaf[trials * number :], trials_of(trials * (number + 1), LONGEST))
    simulate(scene, trials_of(4, 1.0), threads=1)
    together.wait()
    start, used = time.perf_counter(), time.process_time()
    out = simulate(scene, params, threads=threads)
    seconds = time.perf_counter() - start
    done.put((seconds, time.process_time() - used, float(out.length.sum()) * CONTROL_PERIOD))


def measured(trials: int, processes: int, threads: int) -> dict[str, Any]:
    """Speed of so many processes with so many threads each, which share the trials."""
    spawn = multiprocessing.get_context("spawn")  # a fork would copy JAX's locks
    together, done = spawn.Barrier(processes), spawn.Queue()
    workers = [
        spawn.Process(target=share, args=(number, trials // processes, threads, together, done))
        for number in range(processes)
    ]
    for worker in workers:
        worker.start()
    runs = [done.get(timeout=PATIENCE) for _ in workers]
    for worker in workers:
        worker.join()
    seconds, used, simulated = max(run[0] for run in runs), sum(run[1] for run in runs), sum(run[2] for run in runs)
    return {
        "trials": trials, "processes": processes, "threads": threads, "seconds": round(seconds, 2),
        "processor_seconds": round(used, 1), "trials_of_15_s_per_minute": round(60 * simulated / 15 / seconds),
    }  # fmt: skip


def main(cores: int = os.cpu_count() or 1) -> None:
    """Measure and store.

    Args:
        cores: that are kept busy where several processes share them.
    """
    plans = [(8 * LANES, 1, 2), (8 * LANES, 1, THREADS)]
    plans += [(cores * LANES // 2, cores // threads, threads) for threads in (8, 4, 2) if cores >= 2 * threads]
    plans += [(cores * LANES, cores, 1)]
    rows = [measured(*plan) for plan in plans]
    about = {"preset": PRESET, "longest_s": LONGEST, "lanes_of_a_thread": LANES, "rows": rows}
    write_result("native_cores", f"python -m experiments.simulation.native_cores --cores {cores}", about, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
