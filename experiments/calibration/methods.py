"""Accuracy with thresholds from each calibration method: preset, context, search and gradient, with nested SVMs.

Run: python -m experiments.calibration.methods STORE.zarr [--tasks sim1 real-transfer sim1-to-real failure-type]
Thresholds are chosen on the training side of every split; results are added task by task, to those of the same options.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import FAILURES, REAL, SIM1, Benchmark, of_sources
from experiments._lib.results_io import defaults_of, given, parts_of, write_result
from experiments._lib.tasks import failure_types, states
from experiments._lib.thresholds import trained_thresholds
from rcbht_jax.calibration import contextual
from rcbht_jax.calibration.dataset import calibration_data
from rcbht_jax.calibration.nested import CandidateBank, Choose, calibrated_svm, fixed
from rcbht_jax.calibration.objective import Objective
from rcbht_jax.calibration.search import SearchOptions, SearchSpace
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import FeatureSpec, recipes
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.types import Recordings

WORDS, FULL = FeatureSpec(families=recipes.PLAIN), FeatureSpec(families=recipes.FULL)
GRID = Grid(kernels=("linear", "rbf"), costs=(0.1, 1.0, 10.0, 100.0), scalings=(True,))
TASKS = ("sim1", "real-transfer", "sim1-to-real", "failure-type")
TOP = 6
SCALES = 2.0 ** (np.arange(-4, 5) / 2)
SEED = 0


def candidates(count: int) -> GradientThresholds:
    """``[count, 6, 4]``: the preset and Sobol points, half with one set each for forces and moments, half per axis."""
    spaces = (SearchSpace(groups=(0, 0, 0, 1, 1, 1)), SearchSpace())
    parts = [s.thresholds(SearchOptions(space=s, candidates=count // 2, seed=SEED).points()) for s in spaces]
    return joined(*parts)


def joined(*parts: GradientThresholds) -> GradientThresholds:
    """``[n, 6, 4]`` of parts of any number."""
    return GradientThresholds(np.concatenate([np.asarray(part.limits).reshape(-1, 6, 4) for part in parts]))


def methods(recordings: Recordings, items: LabelledIntervals, config: EncoderConfig, count: int) -> dict[str, Choose]:
    data = calibration_data(recordings, items, config)
    start = time.perf_counter()
    bank = CandidateBank.make(data, config, candidates(count))
    print(f"{count} candidates on {len(data)} trials: {time.perf_counter() - start:.0f} s", flush=True)
    (spans,) = items.intervals
    rows_of = np.array(list(dict.fromkeys(spans.recording.tolist())))
    best = bank.chooser(Objective(), TOP)

    def by_context(rows: np.ndarray, seed: int) -> GradientThresholds:
        rules = (contextual.AUTHORS_COPY, contextual.OWN)
        return joined(
            *(contextual.calibrate(recordings, rows_of[rows], config, copy=copy).thresholds for copy in rules)
        )

    chosen: dict[str, Choose] = {
        "preset": fixed(preset()),
        "context": by_context,
        "search, best": bank.chooser(Objective(), 1),
        f"search, inner folds choose among {TOP} and the preset": lambda rows, seed: joined(preset(), best(rows, seed)),
        "preset scaled, inner folds choose the scale": fixed(np.asarray(preset().limits) * SCALES[:, None, None]),
        "gradient": lambda rows, seed: joined(trained_thresholds(data.take(rows), config)),
    }
    return {name: remembered(choose) for name, choose in chosen.items()}


def remembered(choose: Choose) -> Choose:
    """The same with a cache: a fold is calibrated once."""
    known: dict[bytes, GradientThresholds] = {}

    def once(rows: np.ndarray, seed: int) -> GradientThresholds:
        key = rows.tobytes()
        if key not in known:
            known[key] = choose(rows, seed)
        return known[key]

    return once


def compare(store: Recordings, benchmark: Benchmark, count: int, repeats: int = 1) -> dict[str, Any]:
    recordings = of_sources(store, benchmark.task.sources)
    items = labelled_intervals(recordings, benchmark.task)
    config = EncoderConfig(5, recordings.dt)
    result: dict[str, Any] = {
        "classes": list(items.classes),
        "trials": len(np.unique(items.trial)),
        "duration alone": accuracies(benchmark, validation.forest(items.seconds, items.y), items, repeats),
    }
    for name, choose in methods(recordings, items, config, count).items():
        for title, features in (("words", WORDS), ("words, duration and offset", FULL)):
            start = time.perf_counter()
            learner = calibrated_svm(recordings, items, config, choose, GRID, features)
            scores = accuracies(benchmark, learner, items, repeats)
            result.setdefault(name, {})[title] = scores
            print(name, "|", title, "|", scores, f"{time.perf_counter() - start:.0f} s", flush=True)
    return result


def accuracies(
    benchmark: Benchmark, learner: validation.Estimator, items: LabelledIntervals, repeats: int
) -> dict[str, Any]:
    """Both accuracies, without the time that they took."""
    found = benchmark.score(learner, items, repeats, SEED)
    return {key: found[key] for key in ("accuracy", "balanced_accuracy")}


def run(task: str, store: Recordings, count: int, repeats: int) -> dict[str, Any]:
    if task == "sim1":
        return compare(store, Benchmark(states(sources=(SIM1,))), count, repeats)
    if task == "failure-type":
        return compare(store, Benchmark(failure_types(sources=(FAILURES,))), count)
    result = {}
    sources, pairs = {
        "real-transfer": ((REAL,), ((("A",), ("B",)), (("B",), ("A",)))),
        "sim1-to-real": ((SIM1, REAL), ((("SIM1",), ("A", "B")),)),
    }[task]
    for boundaries in ("harmonised", "merged"):
        for train_on, test_on in pairs:
            name = f"{'+'.join(train_on)} -> {'+'.join(test_on)}, {boundaries}"
            print(name, flush=True)
            benchmark = Benchmark(states(boundaries=boundaries, sources=sources), train_on, test_on)
            result[name] = compare(store, benchmark, count)
    return result


def main(
    store: tyro.conf.Positional[Path],
    tasks: tuple[str, ...] = TASKS,
    candidates: int = 1024,
    repeats: int = 3,
) -> None:
    options = given(locals() | {"tasks": TASKS}, defaults_of(main))
    command = f"python -m experiments.calibration.methods STORE.zarr{options}"
    recordings = read_recordings(store)
    for task in tasks:
        known = parts_of("calibration", command, TASKS)
        scores = run(task, recordings, candidates, repeats)
        write_result("calibration", command, known | {task: scores}, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
