"""How similar two sets of trials must be for a linear classifier not to separate them: the meaning of the gate's AUC.

One half of a session's recordings against the other, whose mean in every state and axis is moved, up or down by chance:
by a share of its standard deviation between trials, or by the same force everywhere (moments by as much at 20 mm). Then
simulated trials against the same trials with half the physics step, and against those of another seed.

Run: python -m experiments.simulation.separability (reads RCBHT_DATA)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import tyro
from jaxtyping import Float64

from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.results_io import write_result
from sim_mjx.engines import native
from sim_mjx.presets import ONE_ARM, PRESETS
from sim_mjx.validation import sessions
from sim_mjx.validation.gate import separability
from sim_mjx.validation.signature import Profiles

SEED, DRAWS = 0, 8  # signs of the moves
SHARES = (0.1, 0.2, 0.5, 1.0)  # of a standard deviation between trials
FORCES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # N
LEVER = 0.02  # m: moments are moved by the force at this distance
SIMULATED = ("A", "B", "openhrp", "hooked-A", "hooked-B")


def moved(one: Profiles, other: Profiles, size: Float64[np.ndarray, "4 6"]) -> Float64[np.ndarray, " draw"]:
    """AUC, by draw of signs, of one set against the other, each of whose cells is moved by ``size``, up or down."""
    rng = np.random.default_rng(SEED)
    signs = rng.choice([-1.0, 1.0], (DRAWS, *size.shape))
    return np.array([separability(one, other + (size * sign)[None, :, None]) for sign in signs])


def of_recordings(reference: Profiles) -> dict[str, Any]:
    """Effect on the AUC of moving one half, and the spread of the session's trials."""
    one, other = reference[::2], reference[1::2]
    spread = reference.mean(2).std(0, ddof=1)
    even = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])
    shares = {str(share): moved(one, other, share * spread) for share in SHARES}
    forces = {str(force): moved(one, other, np.tile(force * even, (len(spread), 1))) for force in FORCES}
    errors = [areas.std(ddof=1) / np.sqrt(DRAWS) for areas in (*shares.values(), *forces.values())]
    return {
        "recordings": len(reference),
        "spread of forces, N, least, median, most": np.quantile(spread[:, :3], (0, 0.5, 1)).tolist(),
        "not moved": separability(one, other),
        "moved by sd": {name: float(areas.mean()) for name, areas in shares.items()},
        "moved by N": {name: float(areas.mean()) for name, areas in forces.items()},
        "largest standard error of these means": max(errors),
    }


def of_simulation(name: str) -> dict[str, float]:
    """Simulated trials against themselves with half the step, and against another seed."""
    preset = PRESETS[name]
    scene, half = preset.scene(), preset.scene(finer=2)
    first, halved, again = (
        sessions.profiles(native.simulate(each, sessions.trials_of(preset, seed=seed, whole=False)))
        for each, seed in ((scene, SEED), (half, SEED), (scene, SEED + 1))
    )
    differences = np.abs(first.mean((0, 2)) - halved.mean((0, 2)))[:, :3]
    return {
        "half the step": separability(first, halved),
        "half the step, largest difference of a mean force, N": float(differences.max()),
        "another seed": separability(first, again),
    }


def main() -> None:
    """Measure the sessions and write the result."""
    recordings = recorded()
    asked = {name: preset.gate.auc for name, preset in ONE_ARM.items() if preset.gate}
    references = {name: sessions.recorded(recordings, name).profiles for name in ONE_ARM}
    result = {
        "asked": asked,
        "recordings": rounded({name: of_recordings(each) for name, each in references.items()}),
        "simulation": rounded({name: of_simulation(name) for name in SIMULATED}),
    }
    write_result("separability", "python -m experiments.simulation.separability", result, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main)
