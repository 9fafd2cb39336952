"""Is the wrench converged? Production settings of the solver against far more iterations.

Two comparisons: one control period from the same state, which is the solver's error itself, and whole trials, in
which a contact amplifies any difference, as long as both go through the same states.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int64
from mujoco import rollout as mj_rollout

from sim_mjx.assembly.rollout import Rollouts, batch_size, single_trials
from sim_mjx.assembly.scene import ITERATIONS, LS_ITERATIONS, Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.engines.native import Rows, States, Steps
from sim_mjx.validation.engine_parity import FORCE_LIMIT, MOMENT_LIMIT

REFERENCE = (100, 50)  # iterations of the solver and of its line search
THREADS = os.cpu_count() or 1
Periods = Int64[np.ndarray, " trial"]  # control periods
Errors = Float[np.ndarray, "trial time reading"]  # N and Nm, six readings per wrist


@dataclass(frozen=True)
class Difference:
    """Largest absolute difference, and where the force has it."""

    force: float  # N, any axis
    moment: float  # Nm, any axis
    trial: int
    time: float  # s


@dataclass(frozen=True)
class Certificate:
    """How far the production settings are from the reference."""

    trials: int
    touched: int  # trials whose controller noticed a contact
    step: Difference  # sensor after one control period from the same state
    path: Difference  # logged wrench until the trials enter their states at different times
    same_onsets: float  # share of trials that enter all states in the same control periods
    same_outcome: float  # share of trials with the same tabs seated

    @property
    def converged(self) -> bool:
        """Whether the solver's own error is within the limits, with contacts: without any it has nothing to solve."""
        return self.touched > 0 and self.step.force <= FORCE_LIMIT and self.step.moment <= MOMENT_LIMIT


def certify(
    params: Any,
    scene_of: Callable[..., Scene],
    settings: tuple[int, int] = (ITERATIONS, LS_ITERATIONS),
) -> Certificate:
    """Simulate a batch of trials with the native engine, with production and with reference settings.

    Args:
        params: batch of trials.
        scene_of: makes their scene, given ``iterations`` and ``ls_iterations``.
        settings: iterations of the solver and of its line search that are certified.
    """
    scene = scene_of(iterations=settings[0], ls_iterations=settings[1])
    exact = scene_of(iterations=REFERENCE[0], ls_iterations=REFERENCE[1])
    with mj_rollout.Rollout(nthread=THREADS if THREADS > 1 else 0) as pool:
        probe = _Probe(exact, params, pool)
        production = native.simulate(scene, params, watch=probe.compare)
    expected = native.simulate(exact, params)
    agreeing = _agree_until(production, expected)
    same = (np.nan_to_num(production.onset, nan=-1.0) == np.nan_to_num(expected.onset, nan=-1.0)).all(1)
    return Certificate(
        batch_size(params),
        int(np.isfinite(production.onset[:, 1]).sum()),
        probe.largest,
        _largest(_path_errors(production, expected, agreeing)),
        float(same.mean()),
        float((production.seated == expected.seated).all(1).mean()),
    )


class _Probe:
    """Repeats each control period of a running simulation with the reference settings."""

    def __init__(self, exact: Scene, params: Any, pool: mj_rollout.Rollout) -> None:
        self._exact, self._pool, self.largest = exact, pool, Difference(0.0, 0.0, 0, 0.0)
        self._models = [native.model_of(exact, parts) for parts in single_trials(params.parts)]
        self._datas = [mujoco.MjData(exact.model) for _ in range(THREADS)]

    def compare(self, trials: Rows, state: States, wanted: Steps, readings: Steps) -> None:
        """One control period of some trials; see ``native.Watch``."""
        models = [self._models[trial] for trial in trials]
        _, exact = self._pool.rollout(models, self._datas, state, wanted, nstep=self._exact.substeps)
        wrench = (self._exact.forces[:, None] + np.arange(6)).ravel()
        here = _largest(np.abs(readings - exact)[:, :, wrench])
        worst, moment = self.largest, max(self.largest.moment, here.moment)
        if here.force > worst.force:  # a full physics state begins with the time
            worst = Difference(here.force, moment, int(trials[here.trial]), float(state[here.trial, 0]))
        self.largest = replace(worst, moment=moment)


def _agree_until(production: Rollouts, expected: Rollouts) -> Periods:
    """Control periods during which both simulations are in the same state."""
    first, second = (np.nan_to_num(np.round(out.onset / CONTROL_PERIOD), nan=np.inf) for out in (production, expected))
    differ = np.where(first != second, np.minimum(first, second), np.inf).min(1)
    return np.minimum(differ, np.minimum(production.length, expected.length)).astype(np.int64)


def _path_errors(production: Rollouts, expected: Rollouts, periods: Periods) -> Errors:
    longest = min(production.wrench.shape[1], expected.wrench.shape[1])
    error = np.abs(production.wrench[:, :longest].astype(np.float64) - expected.wrench[:, :longest])
    return np.where((np.arange(longest) < periods[:, None])[..., None], error, 0.0)


def _largest(errors: Errors) -> Difference:
    by_kind = errors.reshape(*errors.shape[:2], -1, 2, 3).max((2, 4))
    force, moment = by_kind[..., 0], float(by_kind[..., 1].max())
    trial, period = np.unravel_index(force.argmax(), force.shape)
    return Difference(float(force.max()), moment, int(trial), float(period) * CONTROL_PERIOD)
