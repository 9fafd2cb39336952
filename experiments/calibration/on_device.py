"""Thresholds from thousands of simulated trials that stay on the device: rollouts, labels, search and training.

Run: python -m experiments.calibration.on_device --engine warp (GPU; or mjx). A small run on a CPU: --engine mjx
--trials 48 --preset openhrp --longest 7 --candidates 16 --generations 1 --steps 4 --batch 8 --svm-trials 16
--agreement 8 --agreement-trials 8
A fifth of the trials is held out of all selection. The result is written after each part, so that an interruption loses
one part at most. Parts: rollouts, search, gradient, svm, agreement.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from experiments._lib.results_io import given as stated
from experiments._lib.results_io import write_result
from experiments._lib.simulated import assembled
from experiments._lib.tasks import failure_types
from experiments._lib.timing import seconds_of
from rcbht_jax.calibration import gradient
from rcbht_jax.calibration.dataset import CalibrationData, device_calibration_data
from rcbht_jax.calibration.objective import SCORES, Objective
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import PLAIN
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import extract_features, labelled_intervals
from rcbht_jax.robots.snap_assembly import FAILURE_TYPES
from rcbht_jax.types import Recordings
from sim_mjx import engines
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import device
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.calibration_data import whole_corpus

SEED = 0
CONFIG = EncoderConfig(5, CONTROL_PERIOD)
SPACE = SearchSpace(groups=(0, 0, 0, 1, 1, 1))
WORDS = FeatureSpec(families=PLAIN)
GRID = Grid(kernels=("linear",), costs=(0.01, 0.1, 1.0), scalings=(True,))


@dataclass
class Run:
    """The data that the parts pass on."""

    given: argparse.Namespace
    result: dict[str, Any]
    data: CalibrationData = field(init=False)  # on the device; training trials first
    training: int = field(init=False)  # trials
    limits: dict[str, np.ndarray] = field(default_factory=lambda: {"preset": np.asarray(preset().limits)})  # [6, 4]

    def parts(self) -> tuple[CalibrationData, CalibrationData]:
        """Training and held-out trials, on the device."""
        return _rows(self.data, slice(self.training)), _rows(self.data, slice(self.training, None))


def _rows(data: CalibrationData, span: slice) -> CalibrationData:
    return device_calibration_data(CONFIG, data.wrench[span], data.edges[span], data.y[span], data.classes)


def unseen(work: Callable[[], Any], direction: Any) -> tuple[Any, str]:
    """Run under a guard that forbids implicit copies; if it raises, run again without it, and report that."""
    try:
        with direction("disallow"):
            return work(), "none"
    except jax.errors.JaxRuntimeError as error:
        if "isallowed" not in str(error):
            raise
        return work(), str(error)[:200]


def rollouts(run: Run) -> dict[str, Any]:
    """Simulate; the compiled programs do not depend on how long the trials last, so short ones compile them."""
    given, impl = run.given, engines.IMPLEMENTATIONS[run.given.engine]
    spec = DomainRandomization(nominal_share=0.0, faults=("pose",), longest=given.longest)
    scenario = get_scenario(given.preset)
    scene = scenario.scene()
    (params, faults), drawn = seconds_of(lambda: scenario.draw_batch(SEED, range(given.trials), spec))
    short = replace(params, task=replace(params.task, timeout=np.full(given.trials, 0.2)))
    _, compiling = seconds_of(lambda: device.run(scene, short, impl).wrench)
    guard = jax.transfer_guard_device_to_host
    (out, copies), simulated = seconds_of(lambda: unseen(lambda: device.run(scene, params, impl), guard))
    kinds = [fault.failure_type for fault in faults]
    y = np.array([FAILURE_TYPES.index(kind) if kind in FAILURE_TYPES else -1 for kind in kinds])
    run.data = whole_corpus(out, y, FAILURE_TYPES, CONFIG)
    run.training = round(len(run.data) * 0.8)
    periods = int(out.length.sum())
    return {
        "trials": given.trials, "usable": len(run.data), "training": run.training,
        "seconds to draw": round(drawn, 2), "seconds to compile (with trials of 0.2 s)": round(compiling, 2),
        "seconds to simulate": round(simulated, 2),
        "physics steps per second": round(scene.substeps * periods / simulated),
        "mean length, s": round(periods * CONTROL_PERIOD / given.trials, 2),
        "implicit copies to the host": copies,
    }  # fmt: skip


def agreement(run: Run) -> dict[str, Any]:
    """The objective of fixed candidates here and on this machine's CPU, for the same trials."""
    options = SearchOptions(space=SPACE, candidates=run.given.agreement, seed=SEED)
    candidates, weights = options.space.thresholds(options.points()), Objective().weights()
    out: dict[str, Any] = {"candidates": run.given.agreement, "device": jax.devices()[0].device_kind}
    data = _rows(run.parts()[0], slice(run.given.agreement_trials))
    here = score_candidates(data, CONFIG, candidates)
    with jax.default_device(jax.devices("cpu")[0]):
        wrench, edges, y = jax.device_put(jax.device_get((data.wrench, data.edges, data.y)))
        same = device_calibration_data(CONFIG, wrench, edges, y, data.classes)
        there = score_candidates(same, CONFIG, candidates, chunk=64, group=8)
    off = np.abs((here - there).astype(np.float64))
    out["simulated"] = {
        "trials": len(data),
        "largest difference of the objective": float((off @ weights).max()),
    }
    return out


def searched(run: Run) -> dict[str, Any]:
    training, outside = run.parts()
    given = run.given
    options = SearchOptions(space=SPACE, candidates=given.candidates, generations=given.generations, seed=SEED)
    few = replace(options, candidates=min(given.candidates, 256), generations=min(given.generations, 1))
    _, compiling = seconds_of(lambda: search(training, CONFIG, few).value)
    (found, copies), spent = seconds_of(lambda: unseen(lambda: search(training, CONFIG, options), jax.transfer_guard))
    samples = 6 * int(training.windows.length.sum()) * found.evaluations
    run.limits["search"] = np.asarray(found.thresholds.limits)
    both = np.stack([run.limits[name] for name in ("preset", "search")])
    held_out = score_candidates(outside, CONFIG, both).astype(np.float64)
    return {
        "evaluations": found.evaluations, "seconds of a first, small search (compiles)": round(compiling, 2),
        "seconds": round(spent, 2), "billion samples per second": round(samples / spent / 1e9, 3),
        "implicit copies": copies, "limits": run.limits["search"].round(4).tolist(),
        "training objective of preset and found": [round(found.start_value, 4), round(found.value, 4)],
        "held-out scores of preset and found": [_named(row) for row in held_out],
    }  # fmt: skip


def trained(run: Run) -> dict[str, Any]:
    training, outside = run.parts()
    given = run.given
    options = gradient.GradientOptions(steps=given.steps, rate=0.1, temperature=(0.7, 0.1), batch=given.batch)
    held_out = _rows(outside, slice(given.batch))
    once = replace(options, steps=1)
    _, compiling = seconds_of(lambda: gradient.calibrate(training, CONFIG, preset(), once, held_out=held_out).history)
    made, spent = seconds_of(lambda: gradient.calibrate(training, CONFIG, preset(), options, held_out=held_out))
    run.limits["gradient"] = np.asarray(made.thresholds.limits)
    values = score_candidates(outside, CONFIG, run.limits["gradient"][None]).astype(np.float64)
    return {
        "steps": given.steps, "trials per step": given.batch,
        "seconds of the first step (compiles)": round(compiling, 2), "seconds": round(spent, 2),
        "limits": run.limits["gradient"].round(4).tolist(),
        "held-out loss, first and last": [round(made.history[k][2], 4) for k in (0, -1)],
        "held-out scores": _named(values[0]),
    }  # fmt: skip


def _recordings(data: CalibrationData, name: str) -> Recordings:
    """The completed trials on the host."""
    count, (wrench, edges, y) = len(data), jax.device_get((data.wrench, data.edges, data.y))
    onset = np.full((count, 4), np.nan)
    onset[:, 0] = edges[:, 0] * CONTROL_PERIOD
    return assembled(
        wrench, edges[:, -1], onset, f"SIM_MJX_{name}", outcome=np.full(count, "failure"),
        failure_type=np.array(data.classes)[y[:, 0]], deviation=np.full((count, 3), np.nan),
        session=np.full(count, f"sim-{name}"), trial=np.array([f"sim-{name}-{i:06d}" for i in range(count)]),
    )  # fmt: skip


def svm(run: Run) -> dict[str, Any]:
    """Support vector machines on the words of each method, on as many trials as is affordable."""
    count = run.given.svm_trials
    some = np.r_[np.arange(run.training)[:count], np.arange(run.training, len(run.data))[:count]]
    everything = _recordings(run.data, run.given.preset)
    recordings = everything.take(some)
    items = labelled_intervals(recordings, failure_types())
    inside = np.isin(items.trial, everything.trial[: run.training])
    split = np.flatnonzero(inside), np.flatnonzero(~inside)
    out: dict[str, Any] = {"trials": len(some), "training": len(np.unique(items.trial[inside]))}

    def score(learner: validation.Estimator) -> dict[str, Any]:
        made = validation.holdout_score(learner, items.y, items.trial, split, SEED).summary()["accuracy"]
        return {key: round(value, 4) for key, value in made.items()}

    out["duration alone"] = score(validation.forest(items.seconds, items.y))
    out["majority"] = {"mean": score(validation.majority(items.y))["mean"]}  # fixed by construction
    wrench, length = jax.device_put((recordings.wrench, recordings.length))
    for name, limits in run.limits.items():
        start = time.perf_counter()
        tracks = jax.device_get(encode_on_device(CONFIG, GradientThresholds(limits).limits, wrench, length))
        words = extract_features(tracks, items, WORDS).values
        described = time.perf_counter() - start
        out[name] = score(validation.nested_svm({"": words}, items.y, items.trial, GRID))
        out[name]["seconds to describe and in all"] = [round(described, 1), round(time.perf_counter() - start, 1)]
    return out


def _named(values: np.ndarray) -> dict[str, float]:
    return dict(zip(SCORES, np.round(values, 4).tolist(), strict=True))


PARTS: dict[str, Callable[[Run], dict[str, Any]]] = {
    "rollouts": rollouts, "search": searched, "gradient": trained, "svm": svm, "agreement": agreement,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=["mjx", "warp"], required=True)
    parser.add_argument("--preset", default="hooked-B", help="of one arm")
    parser.add_argument("--trials", type=int, default=10240, help="four fifths of the usable ones calibrate")
    parser.add_argument("--longest", type=float, default=25.0, help="s, cuts every trial")
    parser.add_argument("--candidates", type=int, default=2048)
    parser.add_argument("--generations", type=int, default=16)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--batch", type=int, default=512, help="trials per step of the training")
    parser.add_argument("--svm-trials", type=int, default=1024, help="on each side")
    parser.add_argument("--agreement", type=int, default=64, help="candidates compared between devices")
    parser.add_argument("--agreement-trials", type=int, default=2048, help="for them")
    given = parser.parse_args()
    run = Run(given, {"engine": given.engine, "preset": given.preset})
    options = stated(vars(given), vars(parser.parse_args(["--engine", "mjx"])) | {"engine": None})
    name_of_result = f"calibration_device_{given.engine}_failure_type_{given.preset}".replace("-", "_").lower()
    for name, part in PARTS.items():
        start = time.perf_counter()
        run.result[name] = part(run)
        run.result[name]["seconds of this part"] = round(time.perf_counter() - start, 1)
        write_result(name_of_result, f"python -m experiments.calibration.on_device{options}", run.result, seed=SEED)


if __name__ == "__main__":
    main()
