"""One set of parts for sessions A and B, identified from A and half of the grid of B; the rest and C are predicted.

CMA-ES over what all sessions share (the parts) and what each has of its own (place and stand). The cells of B's grid
are divided like a chess board. The search begins at the presets, or at the start of an earlier result (--first), and
resumes from its checkpoint. The committed result began at the best of 18 other generations, and is that of an earlier
``impratio`` and of 9 s of mating. With ``--stands`` the part stays as it is, and only what each session has of its own
is searched.
Run: python -m experiments.simulation.joint_fit --engine warp --population 128 --generations 25 --spread 0.06 --seed 2
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from jaxtyping import Int

from experiments._lib.benchmarks import recorded
from experiments._lib.joint_objective import JointObjective, Share
from experiments._lib.results_io import defaults_of, given, write_result
from rcbht_jax.types import Recordings
from sim_mjx.presets import HOOKED
from sim_mjx.randomization import overrides
from sim_mjx.validation import sessions, system_id
from sim_mjx.validation.system_id import Bound, Fit, Generation, Search, Values

SHARED = {
    "parts.tab_stiffness": Bound(7e3, 1.05e4, True),
    "parts.hook_overlap[0:2]": Bound(0.5e-3, 1.1e-3),
    "parts.hook_overlap[2:4]": Bound(0.5e-3, 1.1e-3),
    "parts.stop_play": Bound(0.05e-3, 0.8e-3),
    "parts.foot_reach": Bound(0.0, 8e-3),
    "parts.lip_impedance[0:2]": Bound(0.9, 0.998),
    "parts.lip_impedance[2:4]": Bound(0.9, 0.998),
    "parts.slot_play": Bound(0.5e-3, 2.5e-3),
    "parts.seat_depth": Bound(1.5e-3, 4.5e-3),
    "parts.foot_spread": Bound(0.5e-3, 16e-3),
    "parts.foot_offset[0]": Bound(-16e-3, 8e-3),
    "parts.foot_offset[1]": Bound(-16e-3, 8e-3),
    "parts.rear_rise[0]": Bound(-1.5e-3, 2e-3),
    "parts.rear_rise[1]": Bound(-1.5e-3, 2e-3),
    "parts.foot_contact[0]": Bound(0.005, 0.025, True),
    "parts.foot_contact[1]": Bound(0.6, 0.96),
    "parts.foot_contact[3]": Bound(0.2e-3, 2.5e-3, True),
    "parts.friction": Bound(0.2, 0.4),
}
# Of each session; places are counted from the preset's.
OWN = {
    **{f"parts.mount_stiffness[{axis}]": Bound(2e3, 1.6e4, True) for axis in range(3)},
    **{f"parts.mount_damping[{axis}]": Bound(5.0, 250.0, True) for axis in range(3)},
}
AROUND = {
    "parts.position[0]": 4e-3, "parts.position[1]": 4e-3, "parts.position[2]": 2.5e-3, "parts.roll": 0.04,
    "parts.tilt[0]": 0.06, "parts.tilt[1]": 0.06,
}  # fmt: skip
TRIALS = 3  # per candidate, of a session without a grid: they repeat one pose
SEEN = tuple(cell for cell in HOOKED["hooked-B"].placements if sum(cell) % 2 == 0)


def shares(recordings: Recordings, names: tuple[str, ...]) -> dict[str, Share]:
    """The trials to fit to: all of a session, but of B only the white cells."""
    out = {name: Share(sessions.recorded(recordings, name), (), TRIALS) for name in names if name != "hooked-B"}
    if "hooked-B" in names:
        rows = sessions.recorded_rows(recordings, "hooked-B")
        seen = rows[[cell in SEEN for cell in cells(recordings, rows)]]
        out["hooked-B"] = Share(sessions.recorded(recordings, "hooked-B", seen), SEEN, len(SEEN))
    return out


def search(
    names: tuple[str, ...],
    population: int,
    generations: int,
    spread: float,
    seed: int,
    first: Values | None = None,
    stands: bool = False,
) -> Search:
    """From the presets' present values, or from those of ``first`` where it has some; ``stands`` = the part is kept."""
    bounds, start = of_sessions(names, {} if stands else SHARED, OWN, AROUND)
    start |= {name: value for name, value in (first or {}).items() if name in bounds}
    start = within(bounds, start)
    return Search(bounds, population, generations, seed, start, spread, {"sessions": list(names)})


def cells(recordings: Recordings, rows: Int[np.ndarray, " row"]) -> list[tuple[int, int]]:
    """Deviations of recordings of a grid, mm, x and y."""
    millimetres = np.stack([recordings.columns[f"deviation_{axis}"][rows] for axis in "xy"], 1) * 1e3
    return [(int(x), int(y)) for x, y in np.round(millimetres)]


def within(bounds: dict[str, Bound], values: Values) -> Values:
    """Values of some parameters, at the nearer end of its range where one lies outside."""
    return {name: min(max(value, bounds[name].low), bounds[name].high) for name, value in values.items()}


def of_sessions(
    names: tuple[str, ...], shared: dict[str, Bound], own: dict[str, Bound], around: dict[str, float]
) -> tuple[dict[str, Bound], Values]:
    """Ranges and present values of what sessions share and what each has of its own.

    Args:
        names: of the sessions; what is shared begins at the first one's.
        shared: ranges. own: of each session. around: likewise, on both sides of the preset's value.
    """
    bounds, start = dict(shared), {name: present(names[0], name) for name in shared}
    for session in names:
        places = {name: Bound(present(session, name) - by, present(session, name) + by) for name, by in around.items()}
        for name, bound in (own | places).items():
            bounds[f"{session}:{name}"], start[f"{session}:{name}"] = bound, present(session, name)
    return bounds, start


def present(session: str, name: str) -> float:
    """Value of a parameter in a session's preset."""
    return overrides.value(HOOKED[session].parts, HOOKED[session].sensor, name)


def main(
    session: tuple[str, ...] = ("hooked-A", "hooked-B"),
    engine: Literal["native", "mjx", "warp"] = "native",
    population: int = 32,
    generations: int = 40,
    spread: float = 0.12,
    seed: int = 0,
    first: Path | None = None,
    checkpoint: Path = Path("joint_fit.json"),
    stands: bool = False,
) -> None:
    options = given(locals(), {name: one for name, one in defaults_of(main).items() if name != "checkpoint"})
    seen = shares(recorded(), session)
    start = time.perf_counter()

    def progress(generation: Generation, best: Fit) -> None:
        took = time.perf_counter() - start
        print(
            f"{took:.0f} s, generation {generation.number}: {generation.best:.3f}, median {generation.median:.3f}, "
            f"step {generation.step:.3f}, best of all {best.loss:.3f}",
            flush=True,
        )

    values = None if first is None else json.loads(first.read_text())["result"]["start"]
    how = search(tuple(seen), population, generations, spread, seed, values, stands)
    best = system_id.fit(
        JointObjective(HOOKED[session[0]].scene(), seen, engine, seed),
        how,
        checkpoint=checkpoint,
        progress=progress,
    )
    at_bound = [
        name for name, bound in how.bounds.items() if min(abs(best.values[name] - end) for end in bound[:2]) < 1e-9
    ]
    result = {
        "start": how.start, "values": best.values, "loss": best.loss, "generations": len(best.generations),
        "at_bound": at_bound,
        "simulations": len(best.generations) * population * sum(share.trials for share in seen.values()),
        "loss_by_generation": [round(generation.best, 4) for generation in best.generations],
    }  # fmt: skip
    name = "joint_fit_stands" if stands else "joint_fit"
    write_result(name, f"python -m experiments.simulation.joint_fit{options}", result, seed=seed, show=False)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
