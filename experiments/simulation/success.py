"""Success of the simulated assembly: seating rates, success over offsets, snap events.

Run: python -m experiments.simulation.success [rates] [map] [snaps]     (default: all three)
Simulates with the native engine; reads the recorded trials (RCBHT_DATA). Draws docs/images/success-map.png.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments._lib.benchmarks import recorded
from experiments._lib.intervals import seated_share
from experiments._lib.results_io import pictures, record_of, write_result
from rcbht_jax.plots import save
from rcbht_jax.plots.canvas import new_figure
from sim_mjx.assembly.rollout import stack
from sim_mjx.engines import native
from sim_mjx.presets import HOOKED, ONE_ARM
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization.trials import DomainRandomization, sample
from sim_mjx.registry import get_scenario
from sim_mjx.validation import sessions
from sim_mjx.validation.replay import Recorder, seated_snaps

SEED, TRIALS, BLOCK = 0, 500, 1000  # seed; trials per preset; trials per batch of the map
MAP_PRESET, PER_CELL = "hooked-B", 3
OFFSETS = tuple(float(mm) for mm in range(-5, 6))
ROLLS = (-2.0, -1.0, 0.0, 1.0, 2.0)  # degrees


def seating(preset: str) -> dict[str, Any]:
    """Share of mildly randomised trials, within half a millimetre, in which all four tabs are past their lips."""
    scenario, start = get_scenario(preset), time.perf_counter()
    mild = DomainRandomization(nominal_share=1.0)
    run = native.simulate(scenario.scene(), scenario.draw_batch(SEED, range(TRIALS), mild)[0])
    shares = run.seated.mean(0)
    return {
        **seated_share(run.seated.all(1)),
        "tabs": {name: float(share) for name, share in zip(("FR", "FL", "RR", "RL"), shares, strict=True)},
        "diverged": int(run.diverged.sum()),
        "seconds": round(time.perf_counter() - start, 1),
    }


def success_map() -> np.ndarray:
    """Share of seated trials [roll, y, x] of the hand displaced by x and y (mm) and turned by roll (degrees)."""
    cells = [(r, y, x) for r in ROLLS for y in OFFSETS for x in OFFSETS for _ in range(PER_CELL)]
    spec = DomainRandomization(nominal_share=1.0, shift=(0.0, 0.0), turn=(0.0, 0.0))
    preset, trials = preset_of(MAP_PRESET), []
    for index, (r, y, x) in enumerate(cells):
        trial = sample(preset, SEED, index, spec)[0]
        way = trial.task.way_position + np.array([x, y, 0.0]) * 1e-3
        turned = trial.task.way_rpy + np.array([np.radians(r), 0.0, 0.0])
        trials.append(replace(trial, task=replace(trial.task, way_position=way, way_rpy=turned)))
    scene = get_scenario(MAP_PRESET).scene()
    seated = np.concatenate(
        [native.simulate(scene, stack(trials[i : i + BLOCK])).seated for i in range(0, len(trials), BLOCK)]
    )
    return seated.all(1).reshape(len(ROLLS), len(OFFSETS), len(OFFSETS), PER_CELL).mean(-1)


def map_figure(shares: np.ndarray) -> Figure:
    """Heat maps over x and y, one per roll; the recorded outcomes of session B on that without roll."""
    figure = new_figure((2.4 * len(ROLLS) + 1.0, 3.5), 110)
    figure.set_layout_engine("constrained")
    panels = np.atleast_1d(figure.subplots(1, len(ROLLS), sharex=True, sharey=True))
    half = (OFFSETS[1] - OFFSETS[0]) / 2
    span, session = (OFFSETS[0] - half, OFFSETS[-1] + half), preset_of(MAP_PRESET)
    for panel, roll, share in zip(panels, ROLLS, shares, strict=True):
        image = panel.imshow(share, origin="lower", extent=(*span, *span), vmin=0, vmax=1, cmap="RdYlGn")
        panel.set(
            title=f"roll {roll:+g}°" if roll else "roll 0°", xlabel="x, mm", xticks=OFFSETS[1::2], yticks=OFFSETS[1::2]
        )
        if roll == 0:
            for cell in session.placements:
                off = cell in session.off_seat
                panel.plot(*cell, "x" if off else "o", color="black", markersize=5, markerfacecolor="none")
    panels[0].set_ylabel("y, mm")
    figure.colorbar(image, ax=panels.tolist(), label="share of trials that seat all four tabs", shrink=0.85)
    figure.suptitle(
        f"Success of the simulated session {MAP_PRESET} when the hand arrives displaced and turned"
        "\nmarks: the recorded session, o = seated, x = off-seat",
        fontsize=12,
    )
    return figure


def simulated_snaps(session: str) -> dict[str, Any]:
    """Snaps in the raw force of a session's seated trials."""
    params, scene = sessions.trials_of(preset_of(session), seed=SEED), get_scenario(session).scene()
    recorder = Recorder(scene, len(params.command_delay))
    return seated_snaps(native.simulate(scene, params, watch=recorder.watch), recorder)


def rates() -> dict[str, Any]:
    return {preset: seating(preset) for preset in ONE_ARM | HOOKED}


def mapped() -> dict[str, Any]:
    shares = success_map()
    save(map_figure(shares), pictures() / "success-map.png")
    return {
        "preset": MAP_PRESET,
        "trials_per_cell": PER_CELL,
        "x_and_y_mm": OFFSETS,
        "roll_degrees": ROLLS,
        "share_seated_by_roll_y_x": np.round(shares, 3).tolist(),
    }


def snapped() -> dict[str, Any]:
    """Snaps of the simulated sessions, and those in the recorded forces of seated trials, their filter inverted."""
    recordings = recorded()
    return {
        "simulated": {session: simulated_snaps(session) for session in ("A", "B", "hooked-A", "hooked-B")},
        "recorded": {session: sessions.recorded(recordings, session).snaps for session in ("A", "B")},
    }


PARTS: dict[str, Callable[[], dict[str, Any]]] = {"rates": rates, "map": mapped, "snaps": snapped}


def main(parts: tyro.conf.Positional[tuple[str, ...]] = tuple(PARTS)) -> None:
    result = record_of("sim_success").get("result", {})
    for name in parts:
        result[name] = PARTS[name]()
        write_result("sim_success", "python -m experiments.simulation.success", result, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
