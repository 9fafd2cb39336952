"""Objective over time of four calibration methods: random search, halving with CMA-ES, gradients, Optuna's TPE.

All methods use the states of the authors' simulated one-arm trials and the same objective: leave-one-trial-out accuracy
of a ridge classifier on time shares, plus half its explained variance, on hard labels. A quarter of the trials is held
out per seed; a classifier trained on the training trials scores the chosen thresholds there, and nothing is selected by
that score. The gradient method minimises the loss of a classifier trained along with the thresholds, or (fit) the
smooth part of the objective itself. Times are processor seconds of this process without compilation. Optuna (extra
``search``) proposes one candidate at a time: its time is its own plus that of the NumPy taxonomy on the training
trials, measured here; its scores come from the same labels as those of the other methods.

Run: python -m experiments.calibration.curves STORE.zarr [--methods random halving ...]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
import tyro
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss

from experiments._lib.benchmarks import SIM1, of_sources
from experiments._lib.checkpointed_rows import ALL_ROWS, Rows
from experiments._lib.tasks import states
from experiments.calibration.speed import numpy_rate
from rcbht_jax.calibration import gradient
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data
from rcbht_jax.calibration.label_durations import label_durations
from rcbht_jax.calibration.objective import Objective, shares
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.io.store import read_recordings
from rcbht_jax.learning.tasks import labelled_intervals

SPREAD = 0.3  # standard deviation of the logarithm of the preset's steps, from which training starts
CANDIDATES, STEPS, ASKED = 2048, 80, 200  # of the searches, of training, and those that Optuna asks for
SPACE = SearchSpace()  # all 24 numbers
WEIGHTS = Objective().weights()


@dataclass(frozen=True)
class Side:
    """The trials of one seed."""

    inside: CalibrationData
    outside: CalibrationData
    config: EncoderConfig

    def values(self, limits: np.ndarray) -> np.ndarray:
        """Objective ``[candidate]`` on the training trials."""
        return score_candidates(self.inside, self.config, limits).astype(np.float64) @ WEIGHTS

    def held_out(self, limits: np.ndarray) -> tuple[float, float]:
        """Accuracy and log-loss on the held-out trials of a classifier trained on the others."""
        x, test = (self._shares(data, limits) for data in (self.inside, self.outside))
        model = LogisticRegression(C=10.0, max_iter=2000).fit(x, self.inside.y.ravel())
        y_true, probability = self.outside.y.ravel(), model.predict_proba(test)
        accuracy = float((probability.argmax(1) == y_true).mean())
        return accuracy, float(log_loss(y_true, probability, labels=model.classes_))

    def _shares(self, data: CalibrationData, limits: np.ndarray) -> np.ndarray:
        one = jnp.asarray(limits[None], data.windows.slope.dtype)
        times = label_durations(self.config, one, data.windows, jnp.asarray(data.edges), group=1)
        return np.sqrt(np.asarray(shares(times[0]))).reshape(data.y.size, -1)


def side_of(data: CalibrationData, config: EncoderConfig, seed: int) -> Side:
    order = np.random.default_rng([seed, 1]).permutation(len(data))
    quarter = len(data) // 4
    return Side(data.take(np.sort(order[quarter:])), data.take(np.sort(order[:quarter])), config)


def start_of(seed: int) -> GradientThresholds:
    """The preset with every step between limits changed at random."""
    rng = np.random.default_rng(seed)
    ascending = np.asarray(preset().limits)[:, ::-1]
    steps = np.diff(ascending, axis=1, prepend=0) * np.exp(SPREAD * rng.normal(size=(6, 4)))
    return GradientThresholds(np.cumsum(steps, axis=1)[:, ::-1])


def row(side: Side, seconds: np.ndarray, values: np.ndarray, limits: np.ndarray) -> dict[str, Any]:
    """The best objective so far over time, and its scores on the held-out trials whenever it changes."""
    best = np.maximum.accumulate(values)
    news = np.flatnonzero(np.diff(best, prepend=-np.inf) > 0)
    points = []
    for at in news:
        accuracy, loss = side.held_out(limits[at])
        points.append([float(seconds[at]), float(best[at]), accuracy, loss])
    return {
        "evaluations": len(values),
        "seconds": round(float(seconds[-1]), 2),
        "curve (seconds, objective, held-out accuracy, held-out log-loss)": np.round(points, 4).tolist(),
    }


def random_search(side: Side, seed: int) -> dict[str, Any]:
    """Sobol points, the preset among them, a chunk at a time."""
    options = SearchOptions(space=SPACE, candidates=CANDIDATES, seed=seed)
    limits, chunk = np.asarray(SPACE.thresholds(options.points()).limits), 128
    side.values(limits[:chunk])  # compiles
    seconds, values, start = [], [], time.process_time()
    for first in range(0, CANDIDATES, chunk):
        made = side.values(limits[first : first + chunk])
        values.append(made)
        seconds.append(np.full(len(made), time.process_time() - start))
    return row(side, np.concatenate(seconds), np.concatenate(values), limits)


def halving(side: Side, seed: int) -> dict[str, Any]:
    """Successive halving over the trials, then CMA-ES around the best, replayed from the record of the search."""
    options = SearchOptions(space=SPACE, candidates=CANDIDATES // 2, rungs=(0.25, 1.0), generations=16, seed=seed)
    side.values(np.asarray(SPACE.thresholds(options.points()[:128]).limits))
    search(side.inside, side.config, SearchOptions(space=SPACE, candidates=128, rungs=(0.25, 1.0), generations=1))
    notes: list[float] = []
    start = time.process_time()
    result = search(side.inside, side.config, options, progress=lambda _: notes.append(time.process_time() - start))
    accuracy, loss = side.held_out(np.asarray(result.thresholds.limits))
    share = notes[-1] / result.history[-1][1]  # processor seconds per second of wall time
    points = [[round(s * share, 4), round(value, 4), None, None] for _, s, value in result.history]
    points[-1][2:] = [round(accuracy, 4), round(loss, 4)]
    return {
        "evaluations": result.evaluations,
        "seconds": round(notes[-1], 2),
        "curve (seconds, objective, held-out accuracy, held-out log-loss)": points,
    }


def by_gradient(side: Side, seed: int, loss: Literal["logistic", "fit"]) -> dict[str, Any]:
    """Training from a start of its own; the objective on hard labels is computed afterwards, outside the timing."""
    options = gradient.GradientOptions(steps=STEPS, rate=0.1, temperature=(0.7, 0.1), seed=seed, loss=loss)
    start = start_of(seed)
    gradient.calibrate(side.inside, side.config, start, replace(options, steps=1))
    clock: list[float] = []
    began = time.process_time()
    made = gradient.calibrate(
        side.inside, side.config, start, options, progress=lambda _: clock.append(time.process_time() - began)
    )
    watched = gradient.calibrate(side.inside, side.config, start, options, held_out=side.outside)
    path = np.concatenate([np.asarray(start.limits)[None], made.path])
    out = row(side, np.array([0.0, *clock]), side.values(path), path)
    losses = [watched.history[k][2] for k in (0, -1)]
    last = side.held_out(made.path[-1])
    return out | {
        "held-out training loss, first and last": [round(value, 4) for value in losses],
        "held-out accuracy and log-loss at the end": [round(value, 4) for value in last],
    }


def tpe(side: Side, seed: int) -> dict[str, Any]:
    """Optuna's sampler over the same space, one candidate at a time."""
    import optuna  # type: ignore[import-not-found,unused-ignore]

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    samples = 6 * int(side.inside.windows.length.sum())
    each = samples / numpy_rate(side.inside, clock=time.process_time)
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial({f"x{k}": float(v) for k, v in enumerate(SPACE.point(SPACE.base))})
    seconds, values, tried, own = [], [], [], 0.0
    for _ in range(ASKED):
        start = time.process_time()
        trial = study.ask()
        point = np.array([trial.suggest_float(f"x{k}", 0, 1) for k in range(SPACE.dimensions)])
        own += time.process_time() - start
        limits = np.asarray(SPACE.thresholds(point[None]).limits)
        value = float(side.values(limits)[0])
        start = time.process_time()
        study.tell(trial, value)
        own += time.process_time() - start
        tried.append(limits[0])
        values.append(value)
        seconds.append(own + len(values) * each)
    return row(side, np.array(seconds), np.array(values), np.array(tried)) | {"optuna": optuna.__version__}


def main(
    store: tyro.conf.Positional[Path],
    methods: Annotated[tuple[str, ...], tyro.conf.arg(help="Some of them; default all.")] = (),
) -> None:
    recordings = of_sources(read_recordings(store), (SIM1,))
    config = EncoderConfig(5, recordings.dt)
    data = calibration_data(recordings, labelled_intervals(recordings, states()), config)
    ways: dict[str, tuple[int, Callable[[Side, int], dict[str, Any]]]] = {
        "gradient": (10, partial(by_gradient, loss="logistic")),
        "gradient of the fit": (10, partial(by_gradient, loss="fit")),
        "random": (3, random_search),
        "halving": (3, halving),
        "optuna": (3, tpe),
    }
    wanted: dict[str, Callable[[], Any]] = {
        f"{name} | seed {seed}": partial(lambda way, seed: way(side_of(data, config, seed), seed), way, seed)
        for name, (count, way) in ways.items()
        for seed in range(count)
    }
    about = {
        "task": "SIM1 states, harmonised; a quarter of the trials held out per seed",
        "candidates": CANDIDATES, "steps": STEPS, "asked": ASKED, "trials": len(data),
    }  # fmt: skip
    rows = Rows("calibration_curves", "python -m experiments.calibration.curves STORE.zarr", about, seed=0)
    rows.fill(wanted, [f"{method} | seed" for method in methods] or ALL_ROWS)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
