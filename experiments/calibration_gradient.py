"""Training by gradients over ten seeds, and objective over time beside random search with the same classifier.

Run: python -m experiments.calibration_gradient STORE.zarr
Each seed holds out a quarter of the trials of the one-arm simulation; the held-out loss is recorded, never used.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.record import write_result
from rcbht_jax.calibrate.corpus import Corpus, corpus
from rcbht_jax.calibrate.gradient import GradientOptions, calibrate
from rcbht_jax.calibrate.objective import Objective
from rcbht_jax.calibrate.search import SearchOptions, Space, evaluate, search
from rcbht_jax.data.store import read_recordings
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.tasks import TaskSpec, sentences
from rcbht_jax.thresholds import Thresholds, preset

SOURCE = "SIM_HIRO_ONE_SA_SUCCESS"
SPREAD = 0.3  # standard deviation of the logarithm of the preset's steps, from which a seed starts


def start_of(seed: int) -> Thresholds:
    """The preset with every step between limits changed at random."""
    rng = np.random.default_rng(seed)
    ascending = np.asarray(preset().limits)[:, ::-1]
    steps = np.diff(ascending, axis=1, prepend=0) * np.exp(SPREAD * rng.normal(size=(6, 4)))
    return Thresholds(np.cumsum(steps, axis=1)[:, ::-1])


def one_seed(data: Corpus, config: EncoderConfig, seed: int, steps: int) -> dict[str, Any]:
    order = np.random.default_rng([seed, 1]).permutation(len(data))
    quarter = len(data) // 4
    outside, inside = data.take(np.sort(order[:quarter])), data.take(np.sort(order[quarter:]))
    options = GradientOptions(steps=steps, seed=seed)
    start, began = start_of(seed), time.perf_counter()
    trained = calibrate(inside, config, start, options, held_out=outside)
    seconds = time.perf_counter() - began
    weights = Objective().weights()
    both = evaluate(inside, config, np.stack([start.limits, trained.thresholds.limits])) @ weights
    history = np.array(trained.history)
    return {
        "held-out loss, first and last": [round(float(history[k, 2]), 4) for k in (0, -1)],
        "training loss, first and last": [round(float(history[k, 1]), 4) for k in (0, -1)],
        "search objective on hard labels, first and last": np.round(both, 4).tolist(),
        "seconds": round(seconds, 1),
        "curve (second, training loss, held-out loss)": np.round(history[:: max(1, steps // 12)], 3).tolist(),
    }


def random_search(data: Corpus, config: EncoderConfig, candidates: int) -> dict[str, Any]:
    """The search on the same kind of training trials, for the comparison of objectives over time."""
    inside = data.take(np.sort(np.random.default_rng([0, 1]).permutation(len(data))[len(data) // 4 :]))
    curves = {}
    for name, options in (
        ("Sobol points", SearchOptions(space=Space(), candidates=candidates)),
        ("Sobol points, then CMA-ES", SearchOptions(space=Space(), candidates=candidates // 4, generations=8)),
    ):
        began = time.perf_counter()
        found = search(inside, config, options)
        curves[name] = {
            "start": round(found.start_value, 4),
            "found": round(found.value, 4),
            "evaluations": found.evaluations,
            "seconds": round(time.perf_counter() - began, 1),
            "curve (evaluations, seconds, objective)": [[n, round(s, 1), round(v, 4)] for n, s, v in found.history],
        }
    return curves


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--candidates", type=int, default=1024)
    given = parser.parse_args()
    recordings = read_recordings(given.store)
    rows = np.flatnonzero(recordings.source == SOURCE)
    names = [field.name for field in fields(recordings) if field.name != "dt"]
    recordings = replace(recordings, **{name: getattr(recordings, name)[rows] for name in names})
    config = EncoderConfig(5, recordings.dt)
    data = corpus(recordings, sentences(recordings, TaskSpec()), config)
    seeds = {}
    for seed in range(given.seeds):
        seeds[str(seed)] = one_seed(data, config, seed, given.steps)
        print(seed, {k: v for k, v in seeds[str(seed)].items() if "curve" not in k}, flush=True)
    lower = [s["held-out loss, first and last"][1] < s["held-out loss, first and last"][0] for s in seeds.values()]
    result = {
        "held-out loss ends below its start": f"{sum(lower)} of {len(lower)} seeds",
        "seeds": seeds,
        "search": random_search(data, config, given.candidates),
    }
    write_result("calibration_gradient", "python -m experiments.calibration_gradient STORE.zarr", result, seed=0)


if __name__ == "__main__":
    main()
