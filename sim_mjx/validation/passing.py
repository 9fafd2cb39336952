"""When tabs pass their lips: the truth about snaps, from the places of the parts in simulated trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from rcbht_jax.annotations import Annotations
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.randomization.trials import Fault
from sim_mjx.registry import Scenario
from sim_mjx.validation.replay import Recorder, tab_states

TRACK = "passing"  # of annotations


@dataclass(frozen=True)
class Passed:
    """Simulated trials whose passes are known."""

    run: Rollouts
    faults: list[Fault]
    params: Any  # batch of trials
    past: list[Bool[np.ndarray, "time tab"]]  # of each trial, which tabs are past their lips
    tabs: tuple[str, ...]  # their names

    def moments(self, trial: int) -> list[tuple[int, int]]:
        """Sample and tab of each pass of a trial, in order; a tab that is pulled out may pass again.

        A pass is the first sample that was logged with the tab beneath its lip.
        """
        return moments(self.past[trial])

    def annotations(self) -> Annotations:
        """The passes of all trials as a track: of each tab, from its pass to when it comes out or the trial ends."""
        rows = []
        for trial, past in enumerate(self.past):
            for sample, tab in moments(past):
                out = np.flatnonzero(~past[sample:, tab])
                end = sample + int(out[0]) if len(out) else len(past)
                rows.append((trial, TRACK, self.tabs[tab], sample * CONTROL_PERIOD, end * CONTROL_PERIOD))
        return Annotations.from_rows(rows, {TRACK: self.tabs})


def moments(past: Bool[np.ndarray, "time tab"]) -> list[tuple[int, int]]:
    """Sample and tab of each pass, in order.

    Example:
        >>> moments(np.array([[0, 0], [0, 1], [1, 1], [0, 1], [1, 1]], bool))
        [(1, 1), (2, 0), (4, 0)]
    """
    begins = past[1:] & ~past[:-1]
    return [(int(row) + 1, int(tab)) for row, tab in zip(*np.nonzero(begins), strict=True)]


def simulate(
    scenario: Scenario, seed: int, indices: Sequence[int], spec: Any, progress: Callable[[int], None] | None = None
) -> Passed:
    """Simulate trials with the native engine and note when their tabs pass.

    Args:
        scenario: what is simulated. seed: of the set. indices: of the trials.
        spec: distributions of the scenario.
        progress: see :func:`sim_mjx.engines.native.simulate`.
    """
    params, faults = scenario.draw_batch(seed, indices, spec)
    scene = scenario.scene()
    recorder = Recorder(scene, len(faults))
    run = native.simulate(scene, params, watch=recorder.watch, progress=progress)
    past = []
    for trial in range(len(faults)):
        model = native.model_of(scene, jax.tree.map(lambda leaf, trial=trial: leaf[trial], params.parts))
        places = recorder.qpos(trial)
        known = tab_states(scene, model, places)[0]
        past.append(known[np.minimum(np.arange(run.length[trial]), len(known) - 1)])
    names = tuple(scene.model.geom(tip).name.split("TIP_")[-1] for tip in scene.tips)
    return Passed(run, faults, params, past, names)
