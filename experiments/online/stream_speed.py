"""Latency and start-up of the streaming chain, six axes, window to belief.

* latency: wall time of single pushes of one window, each of which gives a belief, on real trials;
* start: from the model file to the first belief in a fresh process, compilation included, with and without a warm
  compilation cache.

Run on an otherwise idle machine: python -m experiments.online.stream_speed MODEL --pushes 100000
MODEL is made by "rcbht train-online".
Reads the recorded trials (RCBHT_DATA) for the signal.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.catalogue import DATA
from experiments._lib.results_io import write_result
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.io.messages import Sample
from rcbht_jax.io.playback import read_folder

TRIAL = "REAL_HIRO_ONE_SA_SUCCESS/20121127-HIROSA-S-13"
START = """
import resource, sys, time
start = time.perf_counter()
from pathlib import Path
from rcbht_jax._util import compile_cache
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
if sys.argv[2]:
    compile_cache.use(Path(sys.argv[2]))
introspector = Introspector(load(Path(sys.argv[1])), rate=None)
assert introspector.push([[0.0] * 6] * introspector.model.encoder.window)
used = resource.getrusage(resource.RUSAGE_SELF)
print(time.perf_counter() - start, used.ru_utime + used.ru_stime)
"""
QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "largest": 1.0}


def signal(data: Path) -> NDArray[np.float32]:
    return np.array([m.wrench for m in read_folder(data / TRIAL) if isinstance(m, Sample)], np.float32)


def latency(model: Path, wrench: NDArray[np.float32], pushes: int) -> dict[str, float]:
    """Wall and processor time of single pushes; the latter is the same on a busy machine."""
    introspector = Introspector(load(model), rate=None)
    introspector.warm_up()
    window = introspector.model.encoder.window
    windows = wrench[: len(wrench) // window * window].reshape(-1, window, 6)
    wall, processor = np.empty(pushes), np.empty(pushes)
    for k in range(pushes):
        piece = windows[k % len(windows)]
        start, used = time.perf_counter(), time.process_time()
        introspector.push(piece)
        wall[k], processor[k] = time.perf_counter() - start, time.process_time() - used
    return {
        f"{name}, {what}ms": round(float(np.quantile(seconds, q)) * 1e3, 3)
        for what, seconds in (("", wall), ("processor ", processor))
        for name, q in QUANTILES.items()
    }


def start_up(model: Path) -> dict[str, dict[str, float]]:
    """Wall and processor seconds of a fresh process from the first import to the first belief."""

    def once(cache: str) -> dict[str, float]:
        command = [sys.executable, "-c", START, str(model), cache]
        output = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        return {"wall, s": round(float(output[0]), 2), "processor, s": round(float(output[1]), 2)}

    with tempfile.TemporaryDirectory() as folder:
        return {"cold": once(""), "filling the cache": once(folder), "warm cache": once(folder)}


def main(model: tyro.conf.Positional[Path], pushes: int = 100_000) -> None:
    head = load(model).heads[0].machine.svm
    about = {"kernel": head.spec.kernel, "features": head.center.size, "support vectors": len(head.support)}
    result: dict[str, Any] = {"model": about}
    for part, work in (("start", partial(start_up, model)), ("latency", partial(latency, model, signal(DATA), pushes))):
        result[part] = {"load of the machine before, processes": round(os.getloadavg()[0], 1), **work()}
    write_result("stream_speed", f"python -m experiments.online.stream_speed MODEL --pushes {pushes}", result)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
