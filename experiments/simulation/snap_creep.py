"""How long hooks hold out: hooked-B with contacts that creep less, and rear hooks that reach less far.

A resting contact of MuJoCo creeps under a tangential force. The option ``impratio`` divides that in all contacts, the
impedance of a pair in one. Of every ``impratio`` and overlap of the rear hooks: their passes on six placements, as in
``snap_needs``. Then the gate over all placements and several seeds, with the last snap of each trial that seated, and
the same of the recordings; snaps of the recorded size are also counted on the white cells, to which the part was
fitted, and on the black ones. At last the preset with half and twice the physics step, and with more iterations of the
solver: by how much they move the passes of tabs and the force.
Run: python -m experiments.simulation.snap_creep
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.intervals import bootstrap
from experiments._lib.results_io import defaults_of, given, write_result
from experiments.simulation.fidelity_gate import row
from experiments.simulation.joint_fit import SEEN
from experiments.simulation.snap_needs import CELLS, LONGEST, REAR, SESSION, compared, passes
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import HOOK_SUBSTEPS, ITERATIONS, LS_ITERATIONS, Scene, hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets.camera import CAMERA
from sim_mjx.presets.session import SessionPreset
from sim_mjx.synthesis.passes import passes_of
from sim_mjx.validation import sessions, snaps
from sim_mjx.validation.dynamics import dynamics
from sim_mjx.validation.fidelity import snap_shares
from sim_mjx.validation.replay import Recorder, find_snaps

IMPRATIOS = (1.0, 3.0, 10.0, 30.0)
OVERLAPS = (0.8, 0.85, 0.9, 0.95)  # mm, of the rear hooks; the last is the preset's
AT_ONCE = -0.1  # s from the start of mating, when a push may already let hooks go
GIVES, HOLDS = 0.95, 0.99  # impedance of the rear lips' contacts, in place of 0.9805
MEASURES = ("coverage", "W1/sd", "DTW/sd", "wrong signs", "snaps")  # of the gate
TWICE = "twice the physics step"
FINER: dict[str, dict[str, int]] = {  # of the scene
    "half the physics step": {"substeps": 2 * HOOK_SUBSTEPS},
    TWICE: {"substeps": HOOK_SUBSTEPS // 2},
    "twice the solver's iterations": {"iterations": 2 * ITERATIONS, "ls_iterations": 2 * LS_ITERATIONS},
}
FZ, SEED = 2, 0


class Gated(NamedTuple):
    """Whole trials on all placements, of one seed."""

    measures: dict[str, float]  # of the gate
    last: list[float]  # when the last snap comes, s after mating began, of each trial that seated and has one
    colours: dict[str, tuple[int, int]]  # cells -> trials that seated, and of those with a snap as recorded
    snapped: dict[int, bool]  # placement -> whether the trial that seated there has a snap as recorded
    as_recorded: NDArray[np.bool_]  # of each placement: whether the trial ends as recorded


def changed(
    impratio: float = SESSION.impratio, overlap: float | None = None, held: float | None = None
) -> SessionPreset:
    """The preset with another ``impratio``, rear hooks that reach ``overlap`` mm and whose contacts hold harder."""
    parts = CAMERA
    if overlap is not None:
        parts = replace(parts, hook_overlap=np.where(REAR > 0, overlap * 1e-3, parts.hook_overlap))
    if held is not None:
        parts = replace(parts, lip_impedance=np.where(REAR > 0, held, parts.lip_impedance))
    return replace(SESSION, impratio=impratio, parts=parts)


def candidates() -> dict[str, SessionPreset]:
    """The presets that are measured by the gate, with the physics step of the preset, and once with twice that."""
    return {
        "the preset": changed(),
        TWICE: changed(),
        "impratio 1": changed(1.0),
        "impratio 10, rear hooks 0.8 mm": changed(10.0, 0.8),
        "rear lips give way": changed(held=GIVES),
        "rear lips hold harder": changed(held=HOLDS),
    }


def sweep(impratio: float, cells: tuple[tuple[int, int], ...]) -> dict[str, Any]:
    """Passes of the rear hooks on a few placements, overlap by overlap."""
    presets = {f"{overlap:g}": changed(impratio, overlap) for overlap in OVERLAPS}
    return compared(changed(impratio).scene(), presets, cells)


def last_snaps(found: dict[int, list[snaps.Snap]], mating: NDArray[np.float64]) -> list[float]:
    """When the last snap of each trial comes, s after the start of mating; without one in mating there is no time."""
    starts = {row: float(mating[row]) for row in found}
    times = [[s.time - starts[row] for s in each if s.time - starts[row] > AT_ONCE] for row, each in found.items()]
    return [max(each) for each in times if each]


def by_colour(found: dict[int, list[snaps.Snap]], cells: tuple[tuple[int, int], ...]) -> dict[str, tuple[int, int]]:
    """For the cells used by the fit, and for the others: trials that seated, and those with a snap as recorded."""
    out = {}
    for colour, seen in (("white", True), ("black", False)):
        each = [trial for at, trial in found.items() if (cells[at] in SEEN) is seen]
        out[colour] = len(each), sum(any(map(snaps.as_recorded, trial)) for trial in each)
    return out


def gated(session: SessionPreset, scene: Scene, target: sessions.Target, seed: int) -> Gated:
    """Whole trials on all placements before the gate."""
    recorder = Recorder(scene, len(session.placements))
    run = native.simulate(scene, sessions.trials_of(session, seed=seed), watch=recorder.watch)
    events = dynamics(run.wrench[..., FZ], run.length, run.onset[:, 1], run.onset[:, 3])
    pair = None if target.dynamics is None else (target.dynamics, events)
    found = find_snaps(run, recorder)
    shares = snap_shares(target, snaps.summary(list(found.values())))
    checks = row(session, target.profiles, sessions.profiles(run), pair, shares)["checks"]
    measures = {name: checks[name]["value"] for name in MEASURES}
    measures |= {"outcomes as recorded": sessions.agreement(session, run)}
    snapped = {at: any(map(snaps.as_recorded, trial)) for at, trial in found.items()}
    wanted = sessions.should_seat(session, len(run.length), session.placements)
    return Gated(
        measures, last_snaps(found, run.onset[:, 3]), by_colour(found, session.placements), snapped,
        run.seated.all(1) == wanted,
    )  # fmt: skip


def over_seeds(session: SessionPreset, scene: Scene, target: sessions.Target, seeds: int) -> dict[str, Any]:
    """Means over seeds, their lowest and highest values, quartiles of the last snaps of all, and snaps by colour.

    The intervals of the shares of snaps and of outcomes are from placements drawn with replacement, all seeds of each.
    """
    runs = [gated(session, scene, target, seed) for seed in range(seeds)]
    out: dict[str, Any] = {}
    for name in runs[0].measures:
        values = [float(each.measures[name]) for each in runs]
        out[name] = {"mean": float(np.mean(values)), "lowest": min(values), "highest": max(values)}
    places, snapped = zip(*(item for each in runs for item in each.snapped.items()), strict=True)
    out["snaps"]["interval"] = list(bootstrap(np.array(snapped), np.array(places), SEED))
    ended = np.concatenate([each.as_recorded for each in runs])
    low, high = bootstrap(ended, np.tile(np.arange(len(session.placements)), seeds), SEED)
    out["outcomes as recorded"]["interval"] = [each * len(session.placements) for each in (low, high)]
    for colour in runs[0].colours:
        seated, snapped = (sum(counts) for counts in zip(*(each.colours[colour] for each in runs), strict=True))
        out[f"{colour} cells"] = {"seated": seated, "with a snap as recorded": snapped}
    return out | quartiles([time for each in runs for time in each.last])


def quartiles(last: list[float]) -> dict[str, Any]:
    """How many trials have a snap in mating, and when the last one comes."""
    times = np.round(np.percentile(last, (25, 50, 75)), 2).tolist() if last else []
    return {"with a snap in mating": len(last), "last snap, s, quartiles": times}


def as_recorded(recordings: Recordings) -> dict[str, Any]:
    """The last snaps of the recorded trials that seated."""
    found = sessions.recorded_snaps(recordings, sessions.recorded_rows(recordings, SESSION.name))
    return {"trials": len(found)} | quartiles(last_snaps(found, recordings.starts(RECORDED)[:, 3]))


def finer(cells: tuple[tuple[int, int], ...]) -> dict[str, Any]:
    """By how much other physics steps, or more iterations, change trials of the preset on a few placements."""
    batch = sessions.trials_of(SESSION, placements=cells, longest=LONGEST)

    def simulated(**options: int) -> tuple[Rollouts, Recorder]:
        scene = hooked(impratio=SESSION.impratio, **options)
        recorder = Recorder(scene, len(cells))
        return native.simulate(scene, batch, watch=recorder.watch), recorder

    preset = simulated()
    return {name: changes(*preset, *simulated(**options)) for name, options in FINER.items()}


def changes(run: Rollouts, recorder: Recorder, other: Rollouts, watched: Recorder) -> dict[str, Any]:
    """Medians and largest changes between the same trials, simulated twice: of passes, rear snaps and logged Fz."""
    rows, both = range(len(run.length)), np.minimum(run.length, other.length)
    times = [(stays(run, at), stays(other, at)) for at in rows]
    moved = [abs(now[tab] - then[tab]) * 1e3 for then, now in times for tab in then.keys() & now.keys()]
    pairs = [(passes(run, recorder, at), passes(other, watched, at)) for at in rows]
    rear = np.array([np.abs(np.subtract(now, then)) for then, now in pairs if then and now]).reshape(-1, 3)
    force = [np.abs(run.wrench[at, : both[at], FZ] - other.wrench[at, : both[at], FZ]) for at in rows]
    columns = {
        "pass, ms": np.array(moved),
        "release, N": rear[:, 1],
        "fall, N": rear[:, 2],
        "Fz, N": np.concatenate(force),
    }
    spreads = {
        name: {"median": round(float(np.median(each)), 3), "largest": round(float(each.max()), 3)}
        for name, each in columns.items()
        if len(each)
    }
    alike = sum(then.keys() == now.keys() for then, now in times)
    return {"trials": len(rows), "with the same tabs in": alike, "passes": len(moved), **spreads}


def stays(run: Rollouts, at: int) -> dict[int, float]:
    """When each tab of a trial passed that is still in at its end, s."""
    found = passes_of(run.past[at : at + 1], run.length[at : at + 1])[0].tolist()
    return {tab: start * CONTROL_PERIOD for tab, start, end in found if end == run.length[at]}


def main(trials: int = len(CELLS), seeds: int = 3, only: tuple[str, ...] = tuple(candidates())) -> None:
    recordings = recorded()
    target = sessions.recorded(recordings, SESSION.name)
    swept = {f"{impratio:g}": sweep(impratio, CELLS[:trials]) for impratio in IMPRATIOS}
    rows = {
        name: over_seeds(session, hooked(impratio=session.impratio, **FINER.get(name, {})), target, seeds)
        for name, session in candidates().items()
        if name in only
    }
    result = {"sweep": swept, "gate": rounded(rows), "seeds": seeds, "recorded": as_recorded(recordings)}
    result["finer"] = finer(CELLS[:trials])
    command = "python -m experiments.simulation.snap_creep" + given(locals(), defaults_of(main))
    write_result("snap_creep", command, result, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
