"""Candidates per second of the search for thresholds, compared with a loop over the NumPy taxonomy in the same run.

Run: python -m experiments.calibration.speed STORE.zarr
All one-arm simulation successes and real successes, six axes, W=5: 4,096 candidates scored in one call.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments._lib.results_io import write_result
from experiments._lib.tasks import states
from rcbht_jax import reference
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.tasks import labelled_intervals

SOURCES = ("SIM_HIRO_ONE_SA_SUCCESS", "REAL_HIRO_ONE_SA_SUCCESS")
DT = 0.005
SEED = 0
CANDIDATES = 4096
NUMPY_TRIALS = 6  # of the data, which the NumPy taxonomy encodes


def from_store(path: Path) -> CalibrationData:
    recordings = read_recordings(path)
    return calibration_data(recordings, labelled_intervals(recordings, states(sources=SOURCES)), EncoderConfig(5, DT))


def numpy_rate(data: CalibrationData, clock: Callable[[], float] = time.perf_counter) -> float:
    """Samples (one axis, one time) per second of the NumPy taxonomy, trial after trial."""
    rows = np.linspace(0, len(data) - 1, NUMPY_TRIALS).astype(int)
    samples, start = 0, clock()
    for row in rows:
        length = int(data.windows.length[row])
        wrench = data.wrench[row, :length].astype(np.float64)
        reference.encode(reference.sample_times(length, DT), wrench, (data.edges[row, :-1] * DT).tolist())
        samples += 6 * length
    return samples / (clock() - start)


def measure(data: CalibrationData) -> dict[str, Any]:
    config, options = EncoderConfig(5, DT), SearchOptions(candidates=CANDIDATES, space=SearchSpace(), seed=SEED)
    limits = np.asarray(options.space.thresholds(options.points()).limits)
    once = len(limits) if jax.default_backend() != "cpu" else 128  # compiles what the timed call needs
    warm = time.perf_counter()
    score_candidates(data, config, limits[:once])
    warm = time.perf_counter() - warm
    before = numpy_rate(data)
    start, used = time.perf_counter(), time.process_time()
    score_candidates(data, config, limits)
    seconds, used = time.perf_counter() - start, time.process_time() - used
    numpy = (before + numpy_rate(data)) / 2
    samples = 6 * int(data.windows.length.sum())
    return {
        "trials": len(data),
        "candidates": CANDIDATES,
        "seconds": round(seconds, 2),
        "processor seconds": round(used, 1),
        "seconds of the first call, compilation included": round(warm, 1),
        "candidates per second": round(CANDIDATES / seconds, 2),
        "million samples per second": round(CANDIDATES * samples / seconds / 1e6, 1),
        "NumPy loop, million samples per second (before and after)": round(numpy / 1e6, 3),
        "ratio to the NumPy loop": round(CANDIDATES * samples / seconds / numpy, 1),
    }


def main(store: tyro.conf.Positional[Path]) -> None:
    result, backend = measure(from_store(store)), jax.default_backend()
    write_result(f"calibration_speed_{backend}", "python -m experiments.calibration.speed STORE.zarr", result, SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
