"""Upper bound of label agreement between engines: C MuJoCo compared with itself after minimal perturbations.

Contact with friction amplifies any difference. The rows give the share of time with equal words when the female part is
displaced by a fraction of a micrometre, and when the state of the physics is rounded to single precision once per
control period. No engine in single precision can be expected to agree better than that.
Run: python -m experiments.simulation.parity_floor
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import tyro

from experiments._lib.results_io import write_result
from experiments.simulation.engines import PRESET, SEED, trials_of
from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.assembly.scene import Scene
from sim_mjx.engines import native
from sim_mjx.registry import get_scenario
from sim_mjx.validation.engine_parity import parity, reference

TRIALS, LONGEST = 64, 15.0  # s, which cuts every trial
SHIFTS = (1e-9, 1e-8, 1e-7, 1e-6)  # m, standard deviation of each coordinate


def shifted(scene: Scene, params: TrialParams, metres: float) -> Rollouts:
    """The same trials with the female part a little elsewhere."""
    step = np.random.default_rng(SEED).normal(size=np.shape(params.parts.position)) * metres
    return native.simulate(scene, replace(params, parts=replace(params.parts, position=params.parts.position + step)))


def rounded(scene: Scene, params: TrialParams) -> Rollouts:
    """The same trials with the state in single precision between control periods."""

    class Lanes(native._Lanes):
        def _step(self, pool: Any, live: Any, command: Any) -> Any:
            past = super()._step(pool, live, command)
            self.state[live, 1:] = self.state[live, 1:].astype(np.float32)  # the first is the time
            return past

    kept = native._Lanes
    try:
        native._Lanes = Lanes  # type: ignore[misc]
        return native.simulate(scene, params)
    finally:
        native._Lanes = kept  # type: ignore[misc]


def main() -> None:
    scene, params = get_scenario(PRESET).scene(), trials_of(TRIALS, LONGEST)
    expected, contact = reference(scene, params)
    rows = {f"part moved by {metres:g} m": shifted(scene, params, metres) for metres in SHIFTS}
    rows["state rounded to single precision every 5 ms"] = rounded(scene, params)
    result = {name: asdict(parity(expected, contact, found)) for name, found in rows.items()}
    command = "python -m experiments.simulation.parity_floor"
    write_result("parity_floor", command, {"preset": PRESET, "rows": result}, seed=SEED)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
