"""Thresholds calibrated on thousands of simulated failures, tested on the authors' failures.

The limits are those that experiments.calibration.on_device found by search and by gradients. All use the same folds of
the authors' trials and an SVM on words alone, its cost and kernel selected on the training side, with features scaled
by their deviation or by ranks.

Run: python -m experiments.calibration.transfer STORE.zarr
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from experiments._lib.benchmarks import FAILURES, Benchmark, of_sources, published_words
from experiments._lib.checkpointed_rows import Rows, command_of
from experiments._lib.results_io import committed
from experiments._lib.tasks import failure_types
from experiments.calibration.methods import WORDS, accuracies
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import extract_features, labelled_intervals

SOURCES = {  # preset of the simulated trials -> result with the limits
    "openhrp": "calibration_device_warp_failure_type_openhrp",
    "hooked-B": "calibration_device_warp_failure_type_hooked_b",
}
COSTS = (0.1, 1.0, 10.0, 100.0)
SEED = 0


def main(
    store: tyro.conf.Positional[Path], repeats: Annotated[int, tyro.conf.arg(help="Of the five folds.")] = 2
) -> None:
    limits = {"preset": np.asarray(preset().limits)}
    for simulated, result in SOURCES.items():
        device = committed(result)  # the committed one: it takes a GPU to make it
        limits |= {f"{simulated}, {name}": np.array(device[name]["limits"]) for name in ("search", "gradient")}
    recordings = of_sources(read_recordings(store), (FAILURES,))
    benchmark = Benchmark(failure_types())
    items = labelled_intervals(recordings, benchmark.task)

    def measure(learner: validation.Estimator) -> dict[str, Any]:
        return accuracies(benchmark, learner, items, repeats)

    def row(which: np.ndarray, ranks: bool) -> dict[str, Any]:
        x = extract_features(published_words(recordings, limits=which), items, WORDS).values
        grid = Grid(kernels=("linear", "rbf"), costs=COSTS, scalings=(True,), ranks=ranks)
        return measure(validation.nested_svm({"": x}, items.y, items.trial, grid))

    wanted: dict[str, Callable[[], Any]] = {
        f"{name} | {'ranks' if ranks else 'deviation'}": partial(row, which, ranks)
        for ranks in (False, True)
        for name, which in limits.items()
    }
    wanted["duration alone"] = lambda: measure(validation.forest(items.seconds, items.y))
    wanted["majority"] = lambda: validation.without_intervals(measure(validation.majority(items.y)))
    about = {
        "task": "failure types of the authors' simulated failures, words alone",
        "trials": len(np.unique(items.trial)), "classes": list(items.classes), "repeats": repeats,
        "limits": {name: which.round(4).tolist() for name, which in limits.items()},
    }  # fmt: skip
    Rows("calibration_transfer", command_of(main, locals(), "STORE.zarr"), about, SEED).fill(wanted)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
