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

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
import tyro
from jaxtyping import Float64

from experiments._lib.benchmarks import recorded
from experiments._lib.catalogue import DATA
from experiments._lib.results_io import committed, write_result
from experiments.simulation import driven_fit as joint
from experiments.simulation import fidelity_gate
from experiments.simulation.joint_fit import cells, within
from rcbht_jax.robots import kinematics
from rcbht_jax.robots.snap_assembly import HARMONISED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import TIP_HEIGHT, PartParams
from sim_mjx.assembly.scene import hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.presets import HOOKED
from sim_mjx.validation import gauss_newton, sessions, system_id
from sim_mjx.validation.driven import driven
from sim_mjx.validation.driven_fit import EARLY, DrivenObjective, DrivenTrial, Wrench
from sim_mjx.validation.fidelity import rerun
from sim_mjx.validation.gauss_newton import Iteration
from sim_mjx.validation.system_id import Bound, Search, Values

SESSION = "hooked-B"
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


def search() -> Search:
    """Ranges, and the fit of driven_fit to this session alone as the start."""
    pairs = joint.search((SESSION,)).bounds
    bounds = {name: bound for name, bound in pairs.items() if not name.startswith("parts.hook_overlap")} | WIDER
    start = dict(committed("driven_fit")["alone"][SESSION]["values"])
    start["parts.hook_overlap[0]"] = start["parts.hook_overlap[1]"] = start.pop("parts.hook_overlap[0:2]")
    return Search(bounds, start=within(bounds, start))


def drawn(first: Search, count: int, seed: int) -> list[Values]:
    """The start of a search, and candidates around it."""
    rng, start = np.random.default_rng(seed), system_id.point_of(first)
    points = [start]
    while len(points) < count:
        point = start + rng.normal(size=len(start)) * SPREAD
        for at, name in enumerate(first.bounds):
            if name in FREE and rng.random() < OFTEN:
                point[at] = rng.uniform()
        points.append(np.clip(point, INSIDE, 1 - INSIDE))
    return [system_id.values_of(point, first.bounds) for point in points]


def fitted(
    objective: DrivenObjective, draws: int, fits: int, iterations: int, seed: int, begun: float
) -> dict[str, Any]:
    """What was drawn, and every fit, the best first."""
    first = search()
    candidates = drawn(first, draws, seed)
    losses = np.concatenate([
        (objective(candidates[at : at + BATCH]) ** 2).sum(1) for at in range(0, draws, BATCH)
    ])  # fmt: skip
    best = [at for at in np.argsort(losses).tolist() if at][: fits - 1]
    searches = [replace(first, start=candidates[at]) for at in (0, *best)]

    def progress(number: int, at: Iteration, values: Values) -> None:
        took = time.perf_counter() - begun
        print(f"{took:.0f} s, fit {number}, {at.candidates} candidates: {at.loss:.4f}", flush=True)

    found = gauss_newton.fit_together(objective, searches, iterations=iterations, progress=progress)
    each = [{"loss": fit.loss, "candidates": fit.candidates, "values": fit.values} for fit in found]
    return {
        "drawn": {"candidates": draws, "best": np.sort(losses)[:fits].round(4).tolist()},
        "fits": sorted(each, key=lambda fit: fit["loss"]),
    }


def load_point(trial: DrivenTrial, wrench: Wrench) -> Float64[np.ndarray, "time 2"]:
    """Forward and left of the middle of the part, m, where a single force at the tips' height would give the moment."""
    rotation = np.asarray(jax.vmap(kinematics.fk)(trial.path[: len(wrench)])[1])
    force = np.einsum("tji,tj->ti", rotation, wrench[:, :3])
    reference = np.asarray(HOOKED[trial.session].sensor.reference)
    moment = np.einsum("tji,tj->ti", rotation, wrench[:, 3:]) + np.cross(reference, force)
    up = np.where(np.abs(force[:, 0]) < 1.0, np.nan, force[:, 0])  # x of the wrist points up the hand, z backwards
    back = (moment[:, 1] + TIP_HEIGHT * force[:, 2]) / up
    left = (TIP_HEIGHT * force[:, 1] - moment[:, 2]) / up
    return np.stack([-back, left], axis=1)


def loads(trials: tuple[DrivenTrial, ...], wrenches: list[Wrench], recordings: Recordings) -> dict[str, Any]:
    """Medians over trials before and after mating begins, mm, and in how many the load moves to the front."""
    rows = {str(name): row for row, name in enumerate(recordings.trial)}
    starts, long = recordings.starts(HARMONISED), round(LONG / CONTROL_PERIOD)
    points = []
    for trial, wrench in zip(trials, wrenches, strict=True):
        _, rotation, _, mating = starts[rows[trial.name]]
        begins = trial.begin + EARLY + round((mating - rotation) / CONTROL_PERIOD)
        first = (begins - round(BEFORE / CONTROL_PERIOD), begins + round(SINCE / CONTROL_PERIOD))
        path = load_point(trial, wrench)
        points.append([np.nanmedian(path[at : at + long], axis=0) for at in first])
    before, after = np.median(points, axis=0) * 1e3
    moved = np.array([last[0] - first[0] for first, last in points])
    return {
        "before": np.round(before, 1).tolist(), "after": np.round(after, 1).tolist(),
        "to the front": int((moved > FORWARD).sum()), "trials": len(points),
    }  # fmt: skip


def closed_loop(parts: PartParams, recordings: Recordings) -> dict[str, Any]:
    """What the gate says of session B with these parts, moved by the recorded controller."""
    preset = replace(HOOKED[SESSION], parts=parts)
    target = sessions.recorded(recordings, SESSION)
    run, _, _ = rerun(preset, seed=0)
    row = fidelity_gate.row(preset, target.profiles, sessions.profiles(run))
    return {name: row["checks"][name]["value"] for name in ("coverage", "W1/sd", "DTW/sd", "AUC")} | {
        "trials": len(run.seated), "tabs": run.seated.mean(0).round(2).tolist(),
        "outcomes as recorded": sessions.agreement(preset, run),
    }  # fmt: skip


def trials(recordings: Recordings) -> tuple[tuple[DrivenTrial, ...], tuple[DrivenTrial, ...]]:
    """Seen and predicted trials of session B."""
    data = joint.trials(recordings, DATA, 0)
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
    found: Path | None = None,
) -> None:
    """See the module.

    Args:
        engine: that simulates; the scores at the end are the native engine's.
        draws: candidates that are drawn. fits: from the best of them and from the fit of driven_fit.
        iterations: of Gauss-Newton. seed: of the draws. found: fits of an earlier run, which are scored only.
    """
    begun = time.perf_counter()
    recordings = recorded()
    seen, held = trials(recordings)
    scene = driven(hooked(joint.SUBSTEPS, impratio=HOOKED[SESSION].impratio))
    objective = DrivenObjective(scene, {SESSION: HOOKED[SESSION]}, seen, engine)
    result = json.loads(found.read_text()) if found else fitted(objective, draws, fits, iterations, seed, begun)
    unseen, both = replace(objective, trials=held), replace(objective, trials=seen + held, engine="native")
    values = {"presets": joint.search((SESSION,)).start, "driven_fit": search().start}
    values |= {"from many starts": result["fits"][0]["values"]}
    result["trials"] = {"seen": [trial.name for trial in seen], "held": [trial.name for trial in held]}
    result["scores"] = {}
    result["loads"] = {"recorded": loads(both.trials, [trial.wrench for trial in both.trials], recordings)}
    for name, wrenches in zip(values, both.simulate(list(values.values())), strict=True):
        parts = zip(("seen", "held"), (objective, unseen), (wrenches[: len(seen)], wrenches[len(seen) :]), strict=True)
        result["scores"][name] = {part: joint.scores_of(of, those) for part, of, those in parts}
        result["loads"][name] = loads(both.trials, wrenches, recordings)
    result["closed loop"] = {
        name: closed_loop(objective.parts(SESSION, values[name]), recordings)
        for name in ("presets", "from many starts")
    }
    command = f"python -m experiments.simulation.driven_starts --engine {engine} --draws {draws} --fits {fits}"
    command += f" --iterations {iterations} --seed {seed}"
    write_result("driven_starts", command, result, seed=seed, show=False)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
