"""What calibrated thresholds are worth: preset, context, search and gradient on hard labels with nested SVMs.

Run: python -m experiments.calibration.methods STORE.zarr [--tasks sim1 real-transfer sim1-to-real failure-type]
Thresholds are chosen inside the training side of every split; results are added task by task.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from experiments._lib.results_io import RESULTS, write_result
from rcbht_jax.calibration import contextual, gradient
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data
from rcbht_jax.calibration.nested import CalibratedSvm, CandidateBank, Choose, fixed
from rcbht_jax.calibration.objective import Objective
from rcbht_jax.calibration.search import SearchOptions, SearchSpace
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec, recipes
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

SIM1, REAL = "SIM_HIRO_ONE_SA_SUCCESS", "REAL_HIRO_ONE_SA_SUCCESS"
FAILURES = "SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob"
WORDS, FULL = FeatureSpec(families=recipes.PLAIN), FeatureSpec(families=recipes.FULL)
GRID = Grid(kernels=("linear", "rbf"), costs=(0.1, 1.0, 10.0, 100.0), scalings=(True,))
TOP = 6
SCALES = 2.0 ** (np.arange(-4, 5) / 2)
SEED = 0


def library_limits(count: int) -> np.ndarray:
    """The preset, then Sobol points: half with one set for forces and one for moments, half per axis."""
    spaces = (SearchSpace(groups=(0, 0, 0, 1, 1, 1)), SearchSpace())
    parts = [s.limits(SearchOptions(space=s, candidates=count // 2, seed=SEED).points()) for s in spaces]
    return np.concatenate(parts)


def part_of(recordings: Recordings, sources: tuple[str, ...]) -> Recordings:
    return recordings.take(np.isin(recordings.source, sources))


def methods(recordings: Recordings, items: LabelledIntervals, config: EncoderConfig, count: int) -> dict[str, Choose]:
    data = calibration_data(recordings, items, config)
    start = time.perf_counter()
    library = CandidateBank.make(data, config, library_limits(count))
    print(f"{count} candidates on {len(data)} trials: {time.perf_counter() - start:.0f} s", flush=True)
    (spans,) = items.intervals
    rows_of = np.array(list(dict.fromkeys(spans.recording.tolist())))
    best = library.chooser(Objective(), TOP)

    def by_context(rows: np.ndarray, seed: int) -> np.ndarray:
        pair = [
            contextual.calibrate(recordings, rows_of[rows], config, copy=copy)
            for copy in (contextual.AUTHORS_COPY, contextual.OWN)
        ]
        return np.stack([np.asarray(one.thresholds.limits) for one in pair])

    def by_gradient(rows: np.ndarray, seed: int) -> np.ndarray:
        return trained_limits(data.take(rows), config)[None]

    found = {
        "preset": fixed(preset().limits),
        "context": by_context,
        "search, best": library.chooser(Objective(), 1),
        f"search, inner folds choose among {TOP} and the preset": lambda rows, seed: np.concatenate(
            [np.asarray(preset().limits)[None], best(rows, seed)]
        ),
        "preset scaled, inner folds choose the scale": fixed(np.asarray(preset().limits) * SCALES[:, None, None]),
        "gradient": by_gradient,
    }
    return {name: remembered(choose) for name, choose in found.items()}


def remembered(choose: Choose) -> Choose:
    """The same, but a fold that comes again is not calibrated again."""
    known: dict[bytes, np.ndarray] = {}

    def once(rows: np.ndarray, seed: int) -> np.ndarray:
        key = rows.tobytes()
        if key not in known:
            known[key] = choose(rows, seed)
        return known[key]

    return once


def trained_limits(data: CalibrationData, config: EncoderConfig) -> np.ndarray:
    options = gradient.GradientOptions(steps=60, rate=0.1, temperature=(0.7, 0.1))
    return np.asarray(gradient.calibrate(data, config, preset(), options).thresholds.limits)


def compare(
    recordings: Recordings,
    spec: TaskSpec,
    measure: Callable[[validation.Estimator, LabelledIntervals], dict[str, Any]],
    count: int,
    only: tuple[str, ...] = (),
) -> dict[str, Any]:
    items = labelled_intervals(recordings, spec)
    config = EncoderConfig(5, recordings.dt)
    result: dict[str, Any] = {
        "classes": list(items.classes),
        "trials": len(np.unique(items.trial)),
        "duration alone": measure(validation.forest(items.seconds, items.y), items),
    }
    for name, choose in methods(recordings, items, config, count).items():
        if only and name not in only:
            continue
        for title, features in (("words", WORDS), ("words, duration and offset", FULL)):
            start = time.perf_counter()
            learner = CalibratedSvm(recordings, items, config, choose, GRID, features).learner()
            made = measure(learner, items)
            result.setdefault(name, {})[title] = made
            print(name, "|", title, "|", made, f"{time.perf_counter() - start:.0f} s", flush=True)
    return result


def folds(repeats: int) -> Callable[[validation.Estimator, LabelledIntervals], dict[str, Any]]:
    def measure(learner: validation.Estimator, items: LabelledIntervals) -> dict[str, Any]:
        splits = validation.repeated_folds(items.y, items.trial, 5, repeats, SEED)
        made = validation.cross_validate(learner, items.y, splits, SEED)
        return {key: rounded(made.summary()[key]) for key in ("accuracy", "balanced_accuracy")}

    return measure


def across(train_on: tuple[str, ...], test_on: tuple[str, ...]) -> Callable[..., dict[str, Any]]:
    def measure(learner: validation.Estimator, items: LabelledIntervals) -> dict[str, Any]:
        split = tuple(np.flatnonzero(np.isin(items.session, side)) for side in (train_on, test_on))
        made = validation.holdout_score(learner, items.y, items.trial, (split[0], split[1]), SEED)
        return {key: rounded(value) for key, value in made.summary().items()}

    return measure


def rounded(values: dict[str, float]) -> dict[str, float]:
    return {key: round(value, 4) for key, value in values.items()}


def run(task: str, store: Recordings, count: int, repeats: int) -> dict[str, Any]:
    if task == "sim1":
        return compare(part_of(store, (SIM1,)), TaskSpec(), folds(repeats), count)
    if task == "failure-type":
        spec = TaskSpec("failure-type")
        return compare(part_of(store, (FAILURES,)), spec, folds(1), count)
    result = {}
    sources, pairs = {
        "real-transfer": ((REAL,), ((("A",), ("B",)), (("B",), ("A",)))),
        "sim1-to-real": ((SIM1, REAL), ((("SIM1",), ("A", "B")),)),
    }[task]
    for boundaries in ("harmonised", "merged"):
        for train_on, test_on in pairs:
            name = f"{'+'.join(train_on)} -> {'+'.join(test_on)}, {boundaries}"
            print(name, flush=True)
            spec = TaskSpec(boundaries=boundaries)
            result[name] = compare(part_of(store, sources), spec, across(train_on, test_on), count)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--tasks", nargs="+", default=["sim1", "real-transfer", "sim1-to-real", "failure-type"])
    parser.add_argument("--candidates", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    store = read_recordings(given.store)
    path = RESULTS / "calibration.json"
    for task in given.tasks:
        known = json.loads(path.read_text())["result"] if path.exists() else {}
        made = run(task, store, given.candidates, given.repeats)
        command = "python -m experiments.calibration.methods STORE.zarr"
        write_result("calibration", command, known | {task: made}, seed=SEED)


if __name__ == "__main__":
    main()
