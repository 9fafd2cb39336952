"""Engines against each other on one machine: parity, the solver's convergence, and speed.

Run: python -m experiments.engines [--engines mjx] [--parity 200] [--speed 256] [--longest 15]
Speeds are those of this machine while nothing else runs. Writes results/engines.json beside this file.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from typing import Any

import jax
import mujoco
import numpy as np

from experiments.record import write_result
from rcbht_jax.compact import encode_on_device
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.labels import LAYERS
from rcbht_jax.thresholds import preset
from sim_mjx import engines
from sim_mjx.certificate import certify
from sim_mjx.engines import native
from sim_mjx.presets import CONTROL_PERIOD
from sim_mjx.randomize import Randomisation, draw_batch
from sim_mjx.rollout import Rollouts, TrialParams, batch_size
from sim_mjx.scene import ITERATIONS, LS_ITERATIONS, SUBSTEPS, Scene, one_arm

SEED, PRESET, WINDOW = 0, "B", 5
CERTIFIED = 64  # trials


def trials_of(count: int, longest: float, nominal_share: float = 0.5) -> TrialParams:
    return draw_batch(PRESET, SEED, range(count), Randomisation(nominal_share=nominal_share, longest=longest))[0]


class FirstContact:
    """When any pair of each trial first touches, seen by watching the native engine."""

    def __init__(self, scene: Scene, params: TrialParams) -> None:
        self._models = [
            native.model_of(scene, jax.tree.map(lambda leaf, i=i: leaf[i], params.parts))
            for i in range(batch_size(params))
        ]
        self._data = mujoco.MjData(scene.model)
        self.period = np.full(batch_size(params), np.iinfo(np.int64).max)

    def watch(self, trials: np.ndarray, state: np.ndarray, wanted: np.ndarray, readings: np.ndarray) -> None:
        del wanted, readings
        for row in np.flatnonzero(self.period[trials] == np.iinfo(np.int64).max):
            model = self._models[trials[row]]
            mujoco.mj_setState(model, self._data, state[row], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_kinematics(model, self._data)
            mujoco.mj_comPos(model, self._data)
            mujoco.mj_collision(model, self._data)
            if self._data.ncon:
                self.period[trials[row]] = round(state[row, 0] / CONTROL_PERIOD)


def reference(params: TrialParams) -> tuple[Rollouts, np.ndarray]:
    """Native trials and the control period of each one's first contact."""
    scene = one_arm()
    contact = FirstContact(scene, params)
    return native.simulate(scene, params, watch=contact.watch), contact.period


def parity(expected: Rollouts, contact: np.ndarray, found: Rollouts) -> dict[str, Any]:
    """How an engine differs from the native one."""
    samples = min(expected.wrench.shape[1], found.wrench.shape[1])
    time = np.arange(samples)
    shared = time < np.minimum(expected.length, found.length)[:, None]
    free = shared & (time < contact[:, None])
    error = np.abs(expected.wrench[:, :samples] - found.wrench[:, :samples])
    late = np.abs(expected.onset - found.onset)
    return {
        "trials": len(contact),
        "trials_with_contact": int((contact < samples).sum()),
        "force_until_contact": float(error[..., :3][free].max()),
        "moment_until_contact": float(error[..., 3:][free].max()),
        "median_force_difference_after_contact": float(np.median(error[..., :3][shared & ~free])),
        "label_agreement_over_time": label_agreement(expected, found, shared),
        "state_agreement_over_time": float((_states(expected, samples) == _states(found, samples))[shared].mean()),
        "same_outcome": float((expected.seated.all(1) == found.seated.all(1)).mean()),
        "same_tabs": float((expected.seated == found.seated).mean()),
        "onset_difference_s_percentile_95": float(np.nanpercentile(late, 95)),
        "diverged": int(found.diverged.sum()),
    }


def label_agreement(expected: Rollouts, found: Rollouts, shared: np.ndarray) -> dict[str, float]:
    """Share of time, over all trials and axes, in which both wrenches have the same word."""
    both = [_words(out, shared.shape[1]) for out in (expected, found)]
    wide = np.broadcast_to(shared[:, None], both[0][0].shape)
    return {layer: float((both[0][k] == both[1][k])[wide].mean()) for k, layer in enumerate(LAYERS)}


def _words(out: Rollouts, samples: int) -> list[np.ndarray]:
    """Label of every sample [trial, axis, time], layer by layer; 0 = none."""
    config = EncoderConfig(window=WINDOW, dt=CONTROL_PERIOD)
    tracks = encode_on_device(config, np.asarray(preset("hiro").limits), jax.numpy.asarray(out.wrench), out.length)
    words = []
    for layer in LAYERS:
        track = jax.device_get(getattr(tracks, layer))
        # spans of a lane do not overlap: a label is switched on at its start and off at its end
        change = np.zeros((*track.label.shape[:2], out.wrench.shape[1] + 1), np.int32)
        trial, axis, _ = np.nonzero(track.label)
        used = track.label != 0
        np.add.at(change, (trial, axis, track.t0[used]), track.label[used])
        np.add.at(change, (trial, axis, track.t1[used]), -track.label[used].astype(np.int32))
        words.append(np.cumsum(change, axis=2)[:, :, :samples])
    return words


def _states(out: Rollouts, samples: int) -> np.ndarray:
    ticks = np.nan_to_num(np.round(out.onset / CONTROL_PERIOD), nan=np.inf)
    return (np.arange(samples)[None, :, None] >= ticks[:, None, :]).sum(2)


def speed(engine: str, params: TrialParams, scene: Scene | None = None) -> dict[str, float]:
    """The second run is timed; the first one compiles."""
    scene = scene or one_arm()
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        out = engines.simulate(scene, params, engine)
        seconds.append(time.perf_counter() - start)
    steps = int(out.length.sum()) * SUBSTEPS
    return {
        "trials": len(out.length),
        "compile_s": round(seconds[0] - seconds[1], 2),
        "seconds": round(seconds[1], 3),
        "steps_per_s": round(steps / seconds[1]),
        "mean_simulated_seconds": round(float(out.length.mean()) * CONTROL_PERIOD, 2),
        "trials_per_minute": round(60 * len(out.length) / seconds[1], 1),
        "trials_of_15_s_per_minute": round(60 * out.length.sum() * CONTROL_PERIOD / 15.0 / seconds[1], 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engines", nargs="*", default=["mjx"], choices=["mjx", "warp"])
    parser.add_argument("--parity", type=int, default=200, help="trials")
    parser.add_argument("--speed", type=int, default=256, help="trials")
    parser.add_argument("--longest", type=float, default=15.0, help="s, cuts every trial")
    options = parser.parse_args()
    few, many = trials_of(options.parity, options.longest), trials_of(options.speed, options.longest)
    certificate = certify(trials_of(CERTIFIED, options.longest))
    result: dict[str, Any] = {
        "preset": PRESET,
        "solver": [ITERATIONS, LS_ITERATIONS],
        "certificate": asdict(certificate) | {"converged": certificate.converged},
        "native": speed("native", many),
    }
    expected, contact = reference(few)
    for engine in options.engines:
        # the first batch compiles, the second one, of the same size, is timed and compared
        measured = speed(engine, few)
        ratio = result["native"]["steps_per_s"] / measured["steps_per_s"]
        found = engines.simulate(one_arm(), few, engine)
        result[engine] = measured | {"native_is_faster_by": round(ratio, 2), "parity": parity(expected, contact, found)}
    write_result("engines", "python -m experiments.engines", result, seed=SEED)


if __name__ == "__main__":
    main()
