"""Session B's part and stand from many starts, on the driven hand of driven_fit.

A fit by differences ends in the valley in which it begins. Here candidates are drawn around the fit of driven_fit, the
heights of seat and rear hooks, the overlaps, the place and the tilt of the stand from the whole of their ranges; the
best of them, and that fit, are where Gauss-Newton begins. Seen are the white cells of B's grid, predicted the black
ones; cells in which the hand stands beside the slots are left out.

Beside it, where the hand is loaded before and after mating begins: the point at the height of the tips through which a
single force would give the recorded moment. And the gate's figures with these parts and the recorded controller.
Run: python -m experiments.simulation.driven_starts --engine warp
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from experiments._lib.benchmarks import recorded
from experiments._lib.catalogue import DATA
from experiments._lib.driven_objective import AFTER, EARLY, DrivenObjective, DrivenTrial, Wrench, block_means
from experiments._lib.results_io import committed, machine, write_result
from experiments.simulation import driven_fit as joint
from experiments.simulation import fidelity_gate
from experiments.simulation.joint_fit import cells, within
from rcbht_jax._util import checkpoint as checkpoint_file
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import PartParams
from sim_mjx.assembly.scene import hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import HOOKED
from sim_mjx.validation import gauss_newton, sessions, system_id
from sim_mjx.validation.driven import driven
from sim_mjx.validation.fidelity import rerun
from sim_mjx.validation.gauss_newton import Iteration
from sim_mjx.validation.system_id import Bound, Search, Values

SESSION = "hooked-B"
NAMES = ("driven_starts", "driven_starts_mating", "driven_starts_loads")  # of results, in the order of the searches
BESIDE = -2  # mm, to the right: in these cells the hand stands on one corner, beside the slots
OVERLAPS = {
    f"parts.hook_overlap[{tabs}]": Bound(0.3e-3, most) for tabs, most in (("0", 2.2e-3), ("1", 2.2e-3), ("2:4", 1.8e-3))
}
WIDER = OVERLAPS | {
    "parts.rear_rise[0]": Bound(-4e-3, 3e-3),
    "parts.rear_rise[1]": Bound(-3e-3, 4e-3),
    "parts.foot_offset[0]": Bound(-22e-3, 10e-3),
    "parts.foot_offset[1]": Bound(-22e-3, 10e-3),
    "parts.foot_contact[1]": Bound(0.6, 0.99),
    f"{SESSION}:parts.tilt[0]": Bound(-0.08, 0.08),
    f"{SESSION}:parts.tilt[1]": Bound(-0.08, 0.08),
    f"{SESSION}:parts.mount_stiffness[0]": Bound(600.0, 6e4, True),
}
FREE = {  # drawn from the whole of their ranges, each in OFTEN of the candidates
    *OVERLAPS, "parts.rear_rise[0]", "parts.rear_rise[1]", "parts.foot_offset[0]", "parts.seat_depth",
    *(f"{SESSION}:parts.{name}" for name in ("tilt[0]", "tilt[1]", "position[0]", "position[2]")),
}  # fmt: skip
SPREAD, OFTEN, INSIDE = 0.12, 0.6, 0.01  # standard deviation of all others, and the least distance to an end, in widths
BATCH = 1024  # candidates that are simulated together
BEFORE, SINCE, LONG = 1.0, 1.0, 0.5  # s: before mating begins, after it began, and how long each stretch is
FORWARD = 10e-3  # m, by which the load must move to count as moved
SHALLOW = {"parts.hook_overlap[0]": 0.4e-3, "parts.hook_overlap[1]": 0.5e-3, "parts.hook_overlap[2:4]": 0.5e-3}  # m
SHOWN = ("presets", "from many starts")  # parts of the picture


def search(name: str = NAMES[0]) -> list[Search]:
    """Ranges, and where candidates are drawn: around the fit of driven_fit to this session, and the searches before."""
    pairs = joint.search((SESSION,)).bounds
    bounds = {name: bound for name, bound in pairs.items() if not name.startswith("parts.hook_overlap")} | WIDER
    start = dict(committed("driven_fit")["alone"][SESSION]["values"])
    start["parts.hook_overlap[0]"] = start["parts.hook_overlap[1]"] = start.pop("parts.hook_overlap[0:2]")
    before = NAMES[: NAMES.index(name)]
    starts = [start, *(fit["values"] for one in before for fit in committed(one)["fits"])]
    return [Search(bounds, start=within(bounds, values)) for values in starts]


def drawn(around: list[Search], count: int, seed: int) -> list[Values]:
    """The starts of some searches, and candidates around each in turn."""
    rng, starts = np.random.default_rng(seed), [system_id.point_of(one) for one in around]
    bounds, points = around[0].bounds, list(starts)
    while len(points) < count:
        start = starts[len(points) % len(starts)]
        point = start + rng.normal(size=len(start)) * SPREAD
        for at, name in enumerate(bounds):
            if name in FREE and rng.random() < OFTEN:
                point[at] = rng.uniform()
        points.append(np.clip(point, INSIDE, 1 - INSIDE))
    return [system_id.values_of(point, bounds) for point in points]


def best_drawn(objective: DrivenObjective, around: list[Search], draws: int, fits: int, seed: int) -> dict[str, Any]:
    """Where the fits begin: at the first of the starts, and at the best that were drawn."""
    candidates = drawn(around, draws, seed)
    losses = np.concatenate([
        (objective(candidates[at : at + BATCH]) ** 2).sum(1) for at in range(0, draws, BATCH)
    ])  # fmt: skip
    chosen = [0, *(at for at in np.argsort(losses).tolist() if at)][:fits]
    begun = [{"loss": float(losses[at]), "candidates": 0, "iterations": 0, "values": candidates[at]} for at in chosen]
    return {"drawn": {"candidates": draws, "best": np.sort(losses)[:fits].round(4).tolist()}, "fits": begun}


def fitted(
    objective: DrivenObjective, first: Search, found: dict[str, Any], iterations: int, keep: Callable[[Any], None]
) -> None:
    """Go on with all fits, which are kept at every iteration; the best first at the end."""
    begun, fits = time.perf_counter(), found["fits"]
    before = [dict(fit) for fit in fits]
    rounds = iterations - min(fit["iterations"] for fit in fits)
    if rounds <= 0:
        return

    def entry(number: int, loss: float, candidates: int, done: int, values: Values) -> dict[str, Any]:
        more = {
            name: before[number][name] + count for name, count in (("candidates", candidates), ("iterations", done))
        }
        return {"loss": loss, **more, "values": values}

    def progress(number: int, at: Iteration, values: Values) -> None:
        took, rows = time.perf_counter() - begun, len(first.bounds) + len(gauss_newton.DAMPINGS)
        print(f"{took:.0f} s, fit {number}, {at.candidates} candidates: {at.loss:.4f}", flush=True)
        fits[number] = entry(number, at.loss, at.candidates, (at.candidates - 1) // rows, values)
        keep(found)

    searches = [replace(first, start=fit["values"]) for fit in fits]
    ended = gauss_newton.fit_together(objective, searches, iterations=rounds, progress=progress)
    fits[:] = [entry(n, fit.loss, fit.candidates, rounds, fit.values) for n, fit in enumerate(ended)]
    fits.sort(key=lambda fit: float(fit["loss"]))
    keep(found)


def loads(objective: DrivenObjective, wrenches: list[Wrench], recordings: Recordings) -> dict[str, Any]:
    """Medians over trials before and after mating begins, mm, and in how many the load moves to the front."""
    rows = {str(name): row for row, name in enumerate(recordings.trial)}
    starts, long = recordings.starts(HARMONISED), round(LONG / CONTROL_PERIOD)
    points = []
    for at, (trial, wrench) in enumerate(zip(objective.trials, wrenches, strict=True)):
        _, rotation, _, mating = starts[rows[trial.name]]
        begins = trial.begin + EARLY + round((mating - rotation) / CONTROL_PERIOD)
        first = (begins - round(BEFORE / CONTROL_PERIOD), begins + round(SINCE / CONTROL_PERIOD))
        path = objective.load_point(at, wrench)
        points.append([np.nanmedian(path[row : row + long], axis=0) for row in first])
    before, after = np.median(points, axis=0) * 1e3
    moved = [bool(last[0] - first[0] > FORWARD) for first, last in points]
    return {
        "before": np.round(before, 1).tolist(), "after": np.round(after, 1).tolist(),
        "to the front": sum(moved), "trials": len(points), "moved": moved,
    }  # fmt: skip


def traces(
    objective: DrivenObjective, wrenches: dict[str, list[Wrench]], moved: list[bool], first: int
) -> dict[str, Any]:
    """Means of 0.1 s of two trials from ``first`` on: one whose load moves to the front, and one whose does not."""
    out = {}
    for title, which in (("at once", True), ("later", False)):
        at = first + moved[first:].index(which)
        curves: dict[str, Any] = {"trial": objective.trials[at].name}
        for name, those in wrenches.items():
            drawn = np.column_stack([those[at][:, [0, 2, 4]], objective.load_point(at, those[at])[:, 0] * 1e3])
            drawn[: objective.trials[at].begin, 3] = np.nan  # nothing is touched yet
            means = np.clip(block_means(drawn, joint.PER_TRACE), -99.0, 99.0)
            curves[name] = {
                axis: [None if np.isnan(value) else round(value, 3) for value in column]
                for axis, column in zip(("Fx", "Fz", "My", "load"), means.T.tolist(), strict=True)
            }
        out[title] = curves
    return out


def closed_loop(parts: PartParams, recordings: Recordings) -> dict[str, Any]:
    """Measures of the gate for session B with these parts and the recorded controller."""
    preset = replace(HOOKED[SESSION], parts=parts)
    target = sessions.recorded(recordings, SESSION)
    run, _, _ = rerun(preset, seed=0)
    row = fidelity_gate.row(preset, target.profiles, sessions.profiles(run))
    return {name: row["checks"][name]["value"] for name in ("coverage", "W1/sd", "DTW/sd", "AUC")} | {
        "trials": len(run.seated), "tabs": run.seated.mean(0).round(2).tolist(),
        "outcomes as recorded": sessions.agreement(preset, run),
    }  # fmt: skip


def scored(
    objective: DrivenObjective,
    held: tuple[DrivenTrial, ...],
    around: list[Search],
    best: Values,
    recordings: Recordings,
) -> dict[str, Any]:
    """Presets, starts and the best fit: explained variance, place of the load, and the gate in the closed loop."""
    seen = objective.trials
    both = replace(objective, trials=seen + held, engine="native", load_weight=0.0)
    values = {"presets": joint.search((SESSION,)).start, "driven_fit": around[0].start}
    values |= {"from many starts": best, "with shallow hooks": best | SHALLOW}
    out: dict[str, Any] = {"trials": {"seen": [t.name for t in seen], "held": [t.name for t in held]}, "scores": {}}
    out["loads"] = {"recorded": loads(both, [trial.wrench for trial in both.trials], recordings)}
    simulated = dict(zip(values, both.simulate(list(values.values())), strict=True))
    for name, wrenches in simulated.items():
        parts = zip(("seen", "held"), (seen, held), (wrenches[: len(seen)], wrenches[len(seen) :]), strict=True)
        out["scores"][name] = {part: joint.scores_of(replace(both, trials=of), those) for part, of, those in parts}
        out["loads"][name] = loads(both, wrenches, recordings)
        pairs = zip(out["loads"][name]["moved"], out["loads"]["recorded"]["moved"], strict=True)
        out["loads"][name]["as recorded"] = sum(one == other for one, other in pairs)
    simulated = {"recorded": [t.wrench for t in both.trials]} | {name: simulated[name] for name in SHOWN}
    out["traces"] = traces(both, simulated, out["loads"]["recorded"]["moved"], len(seen))
    out["closed loop"] = {
        name: closed_loop(objective.parts(SESSION, of), recordings)
        for name, of in values.items()
        if name != "driven_fit"
    }
    return out


def trials(recordings: Recordings, after: float) -> tuple[tuple[DrivenTrial, ...], tuple[DrivenTrial, ...]]:
    """Seen and predicted trials of session B."""
    data = joint.trials(recordings, DATA, 0, after)
    rows = sessions.recorded_rows(recordings, SESSION)
    cell = dict(zip(recordings.trial[rows].tolist(), cells(recordings, rows), strict=True))

    def reaches(trial: DrivenTrial) -> bool:
        return cell[trial.name][1] != BESIDE

    return tuple(filter(reaches, data.seen)), tuple(filter(reaches, data.held["B, black cells"]))


def main(
    engine: Literal["native", "mjx", "warp"] = "native",
    draws: int = 2048,
    fits: int = 7,
    iterations: int = 10,
    seed: int = 0,
    mating: float = AFTER,
    load_weight: float = 0.0,
    checkpoint: Path = Path("driven_starts_fits.json"),
) -> None:
    """See the module.

    Args:
        engine: that fits; the scores at the end are the native engine's.
        draws: candidates that are drawn. fits: from the best of them and from the fit of driven_fit.
        iterations: of Gauss-Newton. seed: of the draws.
        mating: s, of it that are compared. load_weight: of the places where the hand is loaded, beside the wrench.
            Searches with more than 4 s, and with a weight, have results of their own.
        checkpoint: of the fits; an existing one is gone on with.
    """
    recordings = recorded()
    seen, held = trials(recordings, mating)
    scene = driven(hooked(joint.SUBSTEPS, impratio=HOOKED[SESSION].impratio))
    objective = DrivenObjective(scene, {SESSION: HOOKED[SESSION]}, seen, engine, load_weight)
    name = NAMES[2 if load_weight else int(mating > AFTER)]
    command = f"python -m experiments.simulation.driven_starts --engine {engine} --draws {draws} --fits {fits}"
    command += f" --seed {seed} --mating {mating:g}" + (f" --load-weight {load_weight:g}" if load_weight else "")
    keep = partial(checkpoint_file.save, checkpoint, command)
    around = search(name)
    result = checkpoint_file.load(checkpoint, command)
    if result is None:
        result = best_drawn(objective, around, draws, fits, seed) | {"fitted on": machine()}
        keep(result)
    fitted(objective, around[0], result, iterations, keep)
    result["fits"].sort(key=lambda fit: float(fit["loss"]))
    result |= scored(objective, held, around, result["fits"][0]["values"], recordings)
    write_result(name, f"{command} --iterations {iterations}", result, seed=seed, show=False)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
