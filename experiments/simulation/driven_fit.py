"""One set of parts for sessions A and B from the hand's recorded motion: Gauss-Newton compared with CMA-ES.

The hand is moved along the recorded joint angles, and the wrench compared with the recorded one. The fit uses some
trials of A and the white cells of B's grid; the rest of A, B's black cells and all of C, with the part as fitted, are
predicted. Both methods begin at the presets and minimise one sum of squares. A candidate is one simulation of all
fitted trials; those of Gauss-Newton's differences count.
Run: python -m experiments.simulation.driven_fit --engine warp
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from experiments._lib.benchmarks import recorded
from experiments._lib.catalogue import DATA
from experiments._lib.driven_objective import (
    AFTER,
    WINDOW,
    DrivenObjective,
    DrivenTrial,
    Wrench,
    block_means,
    driven_trial,
    explained,
    rows_with_angles,
)
from experiments._lib.results_io import write_result
from experiments.simulation.joint_fit import AROUND, SEEN, SHARED, cells, of_sessions, present, within
from rcbht_jax.labels import AXES
from rcbht_jax.types import Recordings
from sim_mjx.assembly.scene import Scene, hooked
from sim_mjx.presets import HOOKED
from sim_mjx.validation import gauss_newton, sessions, system_id
from sim_mjx.validation.driven import driven
from sim_mjx.validation.gauss_newton import Iteration, LeastSquares
from sim_mjx.validation.system_id import Bound, Fit, Generation, Losses, Search, Values

# Against the encoders the stand is stiffer than against the commands, which the joint fit saw.
WIDER = {
    "parts.tab_stiffness": Bound(4e3, 1.5e4, True),
    "parts.stop_play": Bound(0.02e-3, 2e-3),
    "parts.seat_depth": Bound(0.5e-3, 6e-3),
    "parts.rear_rise[0]": Bound(-3e-3, 2e-3),
    "parts.slot_play": Bound(0.5e-3, 5e-3),
    "parts.foot_contact[0]": Bound(0.003, 0.03, True),
    "parts.friction": Bound(0.1, 0.6),
}
OWN = {f"parts.mount_stiffness[{axis}]": Bound(1e3, 6e4, True) for axis in range(3)}
OWN |= {f"parts.mount_damping[{axis}]": Bound(5.0, 2e3, True) for axis in range(3)}
SUBSTEPS = 4  # a mean of ten samples does not need the eight of a snap's size
SHOWN, PER_TRACE = ("Fx", "Fz", "My"), 20  # axes and samples of a point in the picture
NAMES = ("hooked-A", "hooked-B", "hooked-C")


@dataclass(frozen=True)
class Trials:
    """The fitted and the predicted trials."""

    seen: tuple[DrivenTrial, ...]
    held: dict[str, tuple[DrivenTrial, ...]]  # by what they are


def trials(recordings: Recordings, folder: Path, of_a: int, after: float = AFTER) -> Trials:
    """The recorded trials with joint angles, up to ``after`` seconds of mating."""
    rows = {name: sessions.recorded_rows(recordings, name) for name in NAMES}
    rows = {name: rows_with_angles(folder, recordings, those, HOOKED[name]) for name, those in rows.items()}
    made = {
        name: [driven_trial(folder, recordings, row, name, HOOKED[name], after) for row in those]
        for name, those in rows.items()
    }
    placed = list(zip(made["hooked-B"], cells(recordings, np.array(rows["hooked-B"], int)), strict=True))
    white = [trial for trial, cell in placed if cell in SEEN]
    black = [trial for trial, cell in placed if cell not in SEEN]
    held = {"A": tuple(made["hooked-A"][of_a:]), "B, black cells": tuple(black), "C": tuple(made["hooked-C"])}
    return Trials((*made["hooked-A"][:of_a], *white), held)


def search(
    names: tuple[str, ...], population: int = 4, generations: int = 1, spread: float = 0.1, seed: int = 0
) -> Search:
    """From the presets' present values; Gauss-Newton needs none of the numbers."""
    around = {name: 1.5 * by for name, by in AROUND.items()}
    bounds, start = of_sessions(names, SHARED | WIDER, OWN, around)
    return Search(bounds, population, generations, seed, within(bounds, start), spread)


def of_c(values: Values) -> Values:
    """The parts as fitted, for session C, whose stand is B's and stands where its preset has it from there."""
    moved = {
        name.replace("hooked-B:", "hooked-C:"): value for name, value in values.items() if name.startswith("hooked-B:")
    }
    for axis in range(3):
        name = f"parts.position[{axis}]"
        moved[f"hooked-C:{name}"] += present("hooked-C", name) - present("hooked-B", name)
    return values | moved


def scores(objective: DrivenObjective, values: Values) -> dict[str, Any]:
    """Explained variance of one candidate."""
    return scores_of(objective, *objective.simulate([values]))


def scores_of(objective: DrivenObjective, wrenches: list[Wrench]) -> dict[str, Any]:
    """Explained share of the variance by axis, mean over trials, and the sum of squares."""
    each = [explained(t, w).tolist() for t, w in zip(objective.trials, wrenches, strict=True)]
    return {
        "trials": len(each),
        "explained": np.round(np.mean(each, axis=0), 3).tolist(),
        "loss": float(np.sum(objective.residuals(wrenches) ** 2)),
    }


def all_scores(data: Trials, objective: DrivenObjective, values: Values) -> dict[str, Any]:
    out = {"seen": scores(objective, values)}
    for name, held in data.held.items():
        if held:
            those = DrivenObjective(objective.scene, objective.presets, held, objective.engine)
            out[name] = scores(those, of_c(values) if name == "C" else values)
    return out


def by_search(objective: DrivenObjective, how: Search, checkpoint: Path, start: float) -> dict[str, Any]:
    """CMA-ES on the same sum of squares."""

    def losses(candidates: list[Values]) -> Losses:
        return (objective(candidates) ** 2).sum(1)

    def progress(generation: Generation, best: Fit) -> None:
        if generation.number % 5 == 0:
            took = time.perf_counter() - start
            print(
                f"{took:.0f} s, generation {generation.number}: {generation.best:.4f}, best {best.loss:.4f}", flush=True
            )

    found = system_id.fit(losses, how, checkpoint=checkpoint, progress=progress)
    best = np.minimum.accumulate([generation.best for generation in found.generations])
    return {
        "loss": found.loss,
        "candidates": len(best) * how.population,
        "loss_by_candidates": [[(i + 1) * how.population, round(float(best[i]), 4)] for i in range(0, len(best), 5)],
        "values": found.values,
    }


def progress(begun: float, at: Iteration, values: Values) -> None:
    """Print how far Gauss-Newton is."""
    took = time.perf_counter() - begun
    print(f"{took:.0f} s, {at.candidates} candidates: {at.loss:.4f}, step {at.step:g}", flush=True)


def by_gauss_newton(
    data: Trials, objective: DrivenObjective, how: Search, iterations: int, step: float, begun: float
) -> dict[str, Any]:
    """The fit, the identifiability of its parameters, and the explained variance of presets and fit."""
    found: LeastSquares = gauss_newton.fit(
        objective, how, iterations=iterations, step=step, progress=partial(progress, begun)
    )
    windows = sum((len(t.path) - t.begin) // WINDOW for t in data.seen)
    identifiable = gauss_newton.identifiability(found.jacobian, list(how.bounds), found.loss, 6.0 * windows)
    return {
        "start": how.start,
        "trials": {"seen": [t.name for t in data.seen], **{k: [t.name for t in v] for k, v in data.held.items()}},
        "gauss_newton": {
            "loss": found.loss, "candidates": found.candidates, "values": found.values, "at_bound": found.at_bound,
            "loss_by_candidates": [[at.candidates, round(at.loss, 4)] for at in found.iterations],
            "identifiability": identifiable,
        },
        "scores": {
            "presets": all_scores(data, objective, how.start), "fitted": all_scores(data, objective, found.values),
        },
    }  # fmt: skip


def alone(data: Trials, scene: Scene, engine: str, iterations: int, begun: float) -> dict[str, Any]:
    """The same fit to one session at a time, as if each had its own part."""
    out = {}
    for name, held in (("hooked-A", "A"), ("hooked-B", "B, black cells")):
        seen = tuple(trial for trial in data.seen if trial.session == name)
        objective = DrivenObjective(scene, {name: HOOKED[name]}, seen, engine)
        how = search((name,))
        found = gauss_newton.fit(objective, how, iterations=iterations, progress=partial(progress, begun))
        unseen = DrivenObjective(scene, objective.presets, data.held[held], engine)
        out[name] = {
            "loss": found.loss, "candidates": found.candidates, "values": found.values, "at_bound": found.at_bound,
            "seen": scores(objective, found.values), "held": scores(unseen, found.values),
        }  # fmt: skip
    return out


def traces(data: Trials, scene: Scene, start: Values, fitted: Values) -> dict[str, Any]:
    """Means of 0.1 s of one seen and one predicted trial: recorded, and of the presets and the fit, natively."""
    out = {}
    for title, trial in (("A, seen", data.seen[0]), ("B, black cell", data.held["B, black cells"][2])):
        objective = DrivenObjective(scene, {name: HOOKED[name] for name in NAMES}, (trial,))
        (before,), (after,) = objective.simulate([start, fitted])
        curves = {"recorded": trial.wrench, "presets": before, "fitted": after}
        out[title] = {
            "trial": trial.name,
            **{
                name: {
                    axis: column
                    for axis, column in zip(AXES, block_means(w, PER_TRACE).round(3).T.tolist(), strict=True)
                    if axis in SHOWN
                }
                for name, w in curves.items()
            },
        }
    return out


def main(
    engine: Literal["native", "mjx", "warp"] = "native",
    of_a: int = 3,
    iterations: int = 20,
    step: float = 0.02,
    population: int = 64,
    generations: int = 80,
    spread: float = 0.12,
    seed: int = 0,
    checkpoint: Path = Path("driven_fit_search.json"),
) -> None:
    """See the module.

    Args:
        engine: that simulates. of_a: trials of session A that are seen. iterations, step: of Gauss-Newton.
        population, generations, spread, seed, checkpoint: of CMA-ES.
    """
    begun = time.perf_counter()
    data = trials(recorded(), DATA, of_a)
    scene = driven(hooked(SUBSTEPS, impratio=HOOKED["hooked-A"].impratio))
    objective = DrivenObjective(scene, {name: HOOKED[name] for name in NAMES}, data.seen, engine)
    how = search(NAMES[:2], population, max(generations, 1), spread, seed)
    command = f"python -m experiments.simulation.driven_fit --engine {engine} --of-a {of_a} --iterations {iterations}"
    command += (
        f" --step {step:g} --population {population} --generations {generations} --spread {spread:g} --seed {seed}"
    )
    result = by_gauss_newton(data, objective, how, iterations, step, begun)
    result["alone"] = alone(data, scene, engine, iterations, begun)
    write_result("driven_fit", command, result, seed=seed, show=False)  # a search that is cut off leaves this much
    result["traces"] = traces(data, scene, how.start, result["gauss_newton"]["values"])
    result["cma_es"] = by_search(objective, how, checkpoint, begun) if generations else None
    if generations:
        pairs = result["gauss_newton"]["loss_by_candidates"]
        reached = next((count for count, loss in pairs if loss <= result["cma_es"]["loss"]), None)
        result["gauss_newton"]["candidates_to_cma_es"] = reached
    write_result("driven_fit", command, result, seed=seed, show=False)


if __name__ == "__main__":
    tyro.cli(main)
