"""What a snap needs: hooked-B with one thing changed at a time, tab by tab as the rear hooks pass their lips.

A tab gives way at once where nothing else carries the hand, and where it has room to fall. Changed are the height of
the seat, how far the rear hooks reach, and the height of their lips. Of every seated trial: how long after the start of
mating the first rear hook passes, the largest force in the 60 ms before, and how far it has fallen 180 ms after.
Run: python -m experiments.simulation.snap_needs
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.results_io import defaults_of, given, write_result
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import Scene
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets import HOOKED
from sim_mjx.presets.session import SessionPreset
from sim_mjx.synthesis.passes import passes_of
from sim_mjx.validation import sessions, snaps
from sim_mjx.validation.replay import Recorder, raw_force

SESSION = HOOKED["hooked-B"]
CELLS = ((0, 0), (2, 0), (1, 1), (0, -1), (-1, 0), (-2, 1))  # mm, placements that were recorded to seat
LONGEST = 12.0  # s of mating
REAR = np.array([0.0, 0.0, 1.0, 1.0])  # of the four tabs


def variants(parts: PartParams) -> dict[str, PartParams]:
    """The part, and the same with one thing changed."""
    return {
        "the preset": parts,
        "seat 0.4 mm higher": replace(parts, seat_depth=parts.seat_depth - 0.4e-3),
        "seat 1 mm higher": replace(parts, seat_depth=parts.seat_depth - 1e-3),
        "rear hooks 1/4 mm shorter": replace(parts, hook_overlap=parts.hook_overlap - 0.25e-3 * REAR),
        "rear lips 0.4 mm higher": replace(parts, rear_rise=parts.rear_rise + np.array([0.4e-3, 0.0])),
    }


def passes(run: Rollouts, recorder: Recorder, row: int) -> list[float] | None:
    """Seconds from mating to the first rear pass, N of the release, N of the fall; None without a pass or a seat."""
    found = passes_of(run.past[row : row + 1], run.length[row : row + 1])[0]
    rear = [start for tab, start, end in found.tolist() if end and REAR[tab]]
    if not rear or not run.seated[row].all():
        return None
    at, force = min(rear), raw_force(recorder, run, row)[:, 2]
    before, after = force[at - snaps.FALL : at + 1], force[at : at + 3 * snaps.FALL]
    return [at * CONTROL_PERIOD - run.onset[row, 3], before.max(), before.max() - after.min()]


def summary(rows: list[list[float] | None]) -> dict[str, Any]:
    """Medians over the trials that seated, and how many fell like the recorded ones."""
    measured: NDArray[np.float64] = np.array([row for row in rows if row is not None]).reshape(-1, 3)
    falls = (measured[:, 2] >= snaps.DROP[0]) & (measured[:, 0] > 0)
    names = ("s after mating began", "release, N", "fall, N")
    medians = dict(zip(names, np.round(np.median(measured, axis=0), 2).tolist(), strict=True)) if len(measured) else {}
    return {"trials": len(rows), "seated": len(measured), "fall of 7 N in mating": int(falls.sum()), **medians}


def compared(scene: Scene, presets: dict[str, SessionPreset], cells: tuple[tuple[int, int], ...]) -> dict[str, Any]:
    """Summaries of the trials of presets on the same placements, simulated together."""
    drawn = [sessions.trials_of(preset, placements=cells, longest=LONGEST) for preset in presets.values()]
    batch = jax.tree.map(lambda *leaves: np.concatenate(leaves), *drawn)
    recorder = Recorder(scene, len(cells) * len(presets))
    run = native.simulate(scene, batch, watch=recorder.watch)
    rows = [passes(run, recorder, row) for row in range(len(run.length))]
    return {name: summary(rows[i * len(cells) : (i + 1) * len(cells)]) for i, name in enumerate(presets)}


def main(trials: int = len(CELLS)) -> None:
    changed = {name: replace(SESSION, parts=parts) for name, parts in variants(SESSION.parts).items()}
    result = compared(SESSION.scene(), changed, CELLS[:trials])
    command = "python -m experiments.simulation.snap_needs" + given(locals(), defaults_of(main))
    write_result("snap_needs", command, {"rows": result}, seed=0)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
