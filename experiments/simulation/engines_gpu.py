"""The engines on a GPU: parity with C MuJoCo, steps per second, and a synthesis with labels and storage.

Run on a machine with a GPU, for each preset and engine:
python -m experiments.simulation.engines_gpu --engine mjx [--preset B] [--sections ...]
Sections: parity, speed, sweep (batch sizes), solver (iterations), synthesis. Each replaces its part of the result.
Times are seconds; compilation is measured apart.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from threading import Event, Thread
from typing import Any

import jax
import numpy as np

from experiments._lib.results_io import machine, record_of, write_result
from experiments._lib.timing import seconds_of
from experiments.simulation.engines import PRESET, SEED, trials_of
from rcbht_jax.io import store
from sim_mjx import engines
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD, ENDED
from sim_mjx.engines import device, lanes
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import pipeline
from sim_mjx.synthesis.plan import SynthesisConfig
from sim_mjx.validation.engine_parity import parity, reference

PARITY, LONGEST, SHORT, LONG = 200, 15.0, 9.0, 25.0  # trials; s of a trial of parity, of speed and of a synthesis
BATCH, SWEEP = 8192, (32768,)  # trials at once
SOLVERS = ((6, 4), (4, 4), (1, 1), (10, 6))  # most iterations, of its line search; the first cannot converge
CONVERGED = (30, 20)
COMPARED = 64  # trials
SAMPLED = 1.0  # s between two readings of the memory in use


def scene_of(options: argparse.Namespace) -> Scene:
    scene: Scene = get_scenario(options.preset).scene()
    return scene


def compared(options: argparse.Namespace) -> dict[str, Any]:
    params, scene = trials_of(PARITY, LONGEST, preset=options.preset), scene_of(options)
    return asdict(parity(*reference(scene, params), engines.simulate(scene, params, options.engine)))


def throughput(batch: int, options: argparse.Namespace) -> dict[str, Any]:
    """Physics steps per second with controller, sensor and state machine, all trials running to the end."""
    params, scene = trials_of(batch, SHORT, 1.0, options.preset), scene_of(options)
    impl = engines.ON_DEVICE[options.engine]
    (_, first), (out, seconds) = (seconds_of(lambda: device.run(scene, params, impl)) for _ in range(2))
    steps = int((out.phase < ENDED).sum()) * scene.substeps
    return {
        "batch": batch,
        "compile_s": round(first - seconds, 2),
        "seconds": round(seconds, 3),
        "simulated_s_per_trial": round(float(out.length.mean()) * CONTROL_PERIOD, 2),
        "steps_per_s": round(steps / seconds),
        "memory_peak_GB": round((jax.devices()[0].memory_stats() or {}).get("peak_bytes_in_use", 0) / 1e9, 2),
    }


def solver(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Speed with other iterations of the solver, and the wrench of 64 trials against that of many iterations."""
    kept, rows, impl = device.SOLVER, [], engines.ON_DEVICE[options.engine]
    few, scene = trials_of(COMPARED, SHORT, 1.0, options.preset), scene_of(options)
    try:
        device.SOLVER = CONVERGED
        expected = device.run(scene, few, impl)
        for device.SOLVER in SOLVERS:
            found = device.run(scene, few, impl)
            speed = throughput(BATCH, options)
            rows.append({"solver": device.SOLVER, **speed, **_differences(expected, found)})
    finally:
        device.SOLVER = kept
    return rows


def _differences(expected: device.Outcome, found: device.Outcome) -> dict[str, float]:
    """Forces while both are in the same state; N."""
    samples = min(expected.wrench.shape[1], found.wrench.shape[1])
    first, second = (np.asarray(out.phase[:, :samples]) for out in (expected, found))
    same = (first == second) & (first > 0) & (first < ENDED)
    error = np.abs(np.asarray(expected.wrench[:, :samples, :3]) - np.asarray(found.wrench[:, :samples, :3]))[same]
    seated = np.asarray(expected.seated).all(1) == np.asarray(found.seated).all(1)
    return {
        "median_force_difference_after_contact": float(np.median(error)),
        "p99_force_difference_after_contact": float(np.percentile(error, 99)),
        "same_outcome": float(seated.mean()),
    }


def synthesis(trials: int, options: argparse.Namespace) -> dict[str, Any]:
    """A store with onsets, outcomes, faults and all label tracks, after one of one wave of lanes, which compiles."""
    count, substeps = pipeline.lanes_for(trials, options.engine), get_scenario(options.preset).scene().substeps
    out: dict[str, Any] = {"trials": trials}
    for turn, many in (("with_compilation_s", count), ("seconds", trials)):
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "trials.zarr"
            spec = DomainRandomization(longest=LONG)
            job = SynthesisConfig(options.preset, many, SEED, options.engine, spec=spec, window=5)
            with _memory() as memory, _kept_lanes() as kept:
                start = time.perf_counter()
                report = pipeline.synthesise(target, job, lanes=count)
                out[turn] = round(time.perf_counter() - start, 2)
            out |= {"lanes": kept[0].count, "utilisation": round(kept[0].utilisation, 3)}
            out |= {"stored": report.stored, "seated": report.seated, "diverged": len(report.diverged)}
            out["store_GB"] = round(sum(file.stat().st_size for file in target.rglob("*") if file.is_file()) / 1e9, 3)
            out["physics_steps_per_trial"] = round(float(store.read_table(target).length.mean()) * substeps)
            out["host_memory_with_writers_GB"] = round(memory[0] / 1e9, 2)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return out | {"host_memory_peak_GB": round(peak * 1024 / 1e9, 2)}


@contextmanager
def _memory() -> Iterator[list[int]]:
    """The most bytes seen of this process and those it has started, pages that they share counted once."""
    most, ended = [0], Event()

    def watch() -> None:
        while not ended.wait(SAMPLED):
            most[0] = max(most[0], sum(map(_proportional, [os.getpid(), *_children(os.getpid())])))

    thread = Thread(target=watch)
    thread.start()
    try:
        yield most
    finally:
        ended.set()
        thread.join()


def _children(process: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(OSError):  # a thread that has ended
            found += [int(child) for child in (task / "children").read_text().split()]
    return found


def _proportional(process: int) -> int:
    """A process's share of the memory that is in use, bytes; 0 = it has ended."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))


@contextmanager
def _kept_lanes() -> Iterator[list[lanes.Lanes]]:
    """The lanes that are made meanwhile."""
    made, begin = list[lanes.Lanes](), lanes.Lanes.__init__

    def kept(self: lanes.Lanes, *args: Any, **options: Any) -> None:
        begin(self, *args, **options)
        made.append(self)

    lanes.Lanes.__init__ = kept  # type: ignore[method-assign]
    try:
        yield made
    finally:
        lanes.Lanes.__init__ = begin  # type: ignore[method-assign]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=[*engines.ON_DEVICE], required=True)
    parser.add_argument("--sections", nargs="*", default=["parity", "speed", "synthesis", "sweep", "solver"])
    parser.add_argument("--trials", type=int, nargs="*", default=[10000], help="of each synthesis")
    parser.add_argument("--preset", default=PRESET)
    options = parser.parse_args()
    work: dict[str, Callable[[], Any]] = {
        "parity": lambda: compared(options),
        "speed": lambda: throughput(BATCH, options),
        "synthesis": lambda: {str(count): synthesis(count, options) for count in options.trials},
        "sweep": lambda: [throughput(n, options) for n in SWEEP],
        "solver": lambda: solver(options),
    }
    result = record_of("engines_gpu").get("result", {"presets": {}})
    measured = result["presets"].setdefault(options.preset, {}).setdefault(options.engine, {})
    measured["machine"] = machine()
    for section in options.sections:
        measured[section] = work[section]()
        print(section, json.dumps(measured[section]), flush=True)
        command = "python -m experiments.simulation.engines_gpu --engine ENGINE --preset PRESET"
        write_result("engines_gpu", command, result, SEED, show=False)


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
