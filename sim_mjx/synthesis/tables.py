"""What a store holds of simulated trials: recordings with annotated phases and columns, and the drawn parameters."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.annotations import Annotations
from rcbht_jax.robots.snap_assembly import DEVIATIONS, snap_recordings
from rcbht_jax.types import Recordings
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.randomization.trials import Fault
from sim_mjx.registry import Scenario
from sim_mjx.synthesis import passes, records
from sim_mjx.synthesis.records import Arrays

PHASES = "phase"  # track of an assembly's phases
WORLD = "Wrenches are in the world's axes, z up; moments are about the wrist's sensor."


def recordings_of(
    preset: str,
    scenario: Scenario,
    rows: Arrays,
    index: NDArray[np.int64],
    faults: list[Fault],
    outcome: NDArray[np.str_],
) -> Recordings:
    """The recordings of trials, as a store holds them.

    Args:
        preset: name of what was simulated. scenario: likewise.
        rows: arrays of ``records.of_trials``, of the stored trials.
        index: of the trials. faults: of the trials. outcome: of the trials, of :func:`outcomes`.
    """
    wrench, length = records.by_wrist(rows["wrench"], rows["length"])
    arms, name = scenario.arms, preset if scenario.recorded else f"{scenario.assembly}-{scenario.robot}"

    def each(values: Any) -> NDArray[Any]:
        return np.repeat(np.asarray(values), len(arms), axis=0)

    trials: dict[str, Any] = {
        "wrench": wrench,
        "length": length,
        "dt": CONTROL_PERIOD,
        "trial": each([f"sim-{name}-{i:06d}" for i in index]),
        "arm": np.tile(np.array(arms), len(index)),
        "source": np.full(len(length), f"SIM_MJX_{name}"),
        "session": np.full(len(length), f"sim-{name}"),
        "outcome": each(outcome),
        "note": each(rows["note"]),
    }
    deviation = each(np.stack([fault.deviation for fault in faults]))
    tracks = [passes.as_track(each(rows["passes"]), scenario.tabs)] if scenario.tabs else []
    if scenario.recorded:
        made = snap_recordings(
            **trials, deviation=deviation, onset=each(rows["onset"]), onset_harmonised=each(rows["onset_harmonised"]),
            failure_type=each(np.array([fault.failure_type for fault in faults], np.str_)),
        )  # fmt: skip
        return replace(made, annotations=Annotations.join([made.annotations, *tracks]))
    columns = {
        "fault": each(np.array([fault.kind for fault in faults], np.str_)),
        "robot": np.full(len(deviation), scenario.robot),
        **dict(zip(DEVIATIONS, deviation.T, strict=True)),
    }
    marks = Annotations.from_starts(PHASES, scenario.states, each(rows["onset"]), trials["length"] * CONTROL_PERIOD)
    # the phases come first: they are a task's default track
    return Recordings(**trials, annotations=Annotations.join([marks, *tracks]), columns=columns)


def outcomes(scenario: Scenario, rows: Arrays, params: Any, longest: float | None) -> NDArray[np.str_]:
    """The outcome of each trial: "success" if all its tabs are seated, else "failure" or "unfinished".

    A trial that ends by itself, or by the controller's own limit, has failed. One that ``longest`` (s) ends sooner is
    unfinished: tabs might have been seated later.

    Args:
        scenario: what was simulated.
        rows: as of :func:`recordings_of`.
        params: of the trials as drawn without ``longest``: a fault may have given them a limit of their own.
        longest: s; None = nothing is cut.
    """
    found = np.where(rows["seated"].all(1), "success", "failure")
    if longest is None:
        return found
    limit = (params.task if scenario.recorded else params).timeout
    # rounded as controllers do; the first sample is number 0
    ends, last = (np.round(np.float32(time) / np.float32(CONTROL_PERIOD)) for time in (limit, longest))
    return np.where((found == "failure") & (ends > last) & (rows["length"] > last), "unfinished", found)


def simulation_of(
    scenario: Scenario,
    rows: Arrays,
    index: NDArray[np.int64],
    params: Any,
    faults: list[Fault],
    outcome: NDArray[np.str_],
) -> Arrays:
    """The arrays of the group ``simulation/``; arguments as of :func:`recordings_of`."""
    last = np.array(scenario.states)[np.isfinite(rows["onset"]).sum(1) - 1]
    drawn = {}
    for group, name in scenario.parameters:
        plain = scenario.recorded and group != "hold"
        column = name if plain or not group else f"{group.rpartition('.')[2]}_{name}"
        drawn[column] = getattr(attrgetter(group)(params) if group else params, name)
    trials = {
        "index": index,
        "fault": np.array([fault.kind for fault in faults], np.str_),
        "failed_in": np.where(outcome == "failure", last, ""),
        "seated": rows["seated"],
        "command_delay": params.command_delay,
        "noise_key": params.seed,
        **drawn,
    }
    return {name: np.repeat(np.asarray(values), len(scenario.arms), axis=0) for name, values in trials.items()}
