"""Tables of the physics engines: parity, speed, synthesis."""

from __future__ import annotations

import json
from typing import Any

from experiments._lib.peer_rows import result
from experiments._lib.results_io import COMMITTED
from experiments.tables.cells import markdown

WORDS_SAME = "same primitive / composition / behaviour, % of time"


def _engine_runs(part: str) -> dict[str, Any]:
    """One part of the measurements on a GPU, by engine, and of those on a CPU where they have it."""
    gpu = json.loads((COMMITTED / "engines_gpu.json").read_text(encoding="utf-8"))  # two runs in one file
    found = {f"`{engine}`, one H200": gpu[engine][part] for engine in ("warp", "mjx") if part in gpu[engine]}
    cpu = result("engines")["mjx"]
    return found | ({"`mjx`, 2 CPU cores": cpu[part]} if part in cpu else {})


def parity(way: str) -> str:
    """The device engines against C MuJoCo."""
    lines = []
    for engine, found in _engine_runs("parity").items():
        wrench = [found[f"{what}_until_contact"] for what in ("force", "moment")]
        words = " / ".join(f"{100 * share:.1f}" for share in found["labels"].values())
        contact = f"{wrench[0]:.3f} N, {wrench[1]:.4f} Nm"
        rest = (f"{found['force_after_contact']:.3f} N", words, f"{100 * found['states']:.2f}")
        lines.append((engine, str(found["trials"]), contact, *rest, f"{100 * found['same_outcome']:.1f}"))
    head = ("engine", "trials", "largest difference until contact", "median force difference after it", WORDS_SAME)
    return markdown((*head, "same state, % of time", "same outcome, % of trials"), lines)


def parity_floor(way: str) -> str:
    """C MuJoCo against itself when next to nothing changes."""
    lines = []
    for change, found in result("parity_floor")["rows"].items():
        words = " / ".join(f"{100 * share:.1f}" for share in found["labels"].values())
        lines.append((change, f"{found['force_until_contact']:.3f} N", words))
    return markdown(("change", "largest difference until contact", WORDS_SAME), lines)


def solver(way: str) -> str:
    """How far the solver of the device engines must go."""
    lines = []
    for engine, rows in _engine_runs("solver").items():
        for row in sorted(rows, key=lambda row: -row["steps_per_s"]):
            middle, most = (row[f"{what}_force_difference_after_contact"] for what in ("median", "p99"))
            limits = "/".join(str(limit) for limit in row["solver"])
            lines.append((engine, limits, f"{middle:.4f} N", f"{most:.2f} N", f"{row['steps_per_s'] / 1e6:.2f}"))
    head = ("engine", "iterations / line search", "median force difference", "99 %", "million steps per second")
    return markdown(head, lines)


def speed(way: str) -> str:
    """Physics steps per second with everything inside, by engine and batch."""
    lines = []
    for kind in ("speed", "sweep"):
        for engine, found in _engine_runs(kind).items():
            for run in found if isinstance(found, list) else [found]:
                millions, memory = run["steps_per_s"] / 1e6, run["memory_peak_GB"]
                lines.append(
                    (engine, f"{run['batch']:,}", f"{millions:.2f}", f"{run['compile_s']:.0f}", f"{memory:.1f}")
                )
    return markdown(("engine", "trials at once", "million steps per second", "compilation, s", "memory, GB"), lines)


def synthesis(way: str) -> str:
    """A store of labelled trials from a GPU, from the command to the last byte."""
    lines = []
    for engine, run in _engine_runs("synthesis").items():
        parts = run["seconds_by_part"]
        seconds = (run["seconds"], run["with_compilation_s"], parts["run"], parts["encode_on_device"])
        counts = (f"{run['trials']:,}", f"{run['physics_steps_per_trial']:,}")
        rest = (f"{run['store_GB']:.1f}", str(run["diverged"]))
        lines.append((engine, *counts, *(f"{value:.0f}" for value in seconds), *rest))
    head = ("engine", "trials", "physics steps each", "seconds", "with compilation", "of them physics", "labels")
    return markdown((*head, "store, GB", "diverged, left out"), lines)


TABLES = {
    "parity": parity,
    "parity-floor": parity_floor,
    "solver": solver,
    "speed": speed,
    "synthesis": synthesis,
}
