"""Forward derivatives of six wrench statistics by ten parameters of the parts, compared with central differences.

In the smooth setting (see :mod:`sim_mjx.validation.sensitivity`) the hand follows the path of a nominal trial of
session B, from before touch to its third second of mating, in a fifth of the time. The statistics are the means of the
six axes while parts touch. Both are computed by MJX in double precision.
Run: python -m experiments.simulation.derivatives
"""

from __future__ import annotations

import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float

from experiments._lib.results_io import write_result
from rcbht_jax.labels import AXES
from rcbht_jax.types import Array
from sim_mjx.assembly.rollout import stack
from sim_mjx.assembly.scene import hooked
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets import HOOKED
from sim_mjx.validation import sensitivity, sessions
from sim_mjx.validation.driven import DrivenParams, driven, quicker_path

# Half the distance of the central differences: small enough that no contact begins in between.
STEPS = {
    "parts.friction": 1e-6, "parts.tab_stiffness": 2e-3, "parts.hook_overlap[0:2]": 1e-9,
    "parts.hook_overlap[2:4]": 1e-9, "parts.seat_depth": 1e-9, "parts.mount_stiffness[0]": 2e-3,
    "parts.mount_stiffness[2]": 2e-3, "parts.mount_damping[2]": 1e-3, "parts.position[0]": 1e-9,
    "parts.position[2]": 1e-9,
}  # fmt: skip
BEFORE, QUICKER = 0.4, 5.0  # s before touch; factor on the trial's speed
LIMIT = 1e-2  # of the difference, relative


def means(wrench: Float[Array, "trial time 6"]) -> Float[Array, "trial 6"]:
    """From touch on."""
    return jnp.mean(wrench[:, int(BEFORE / QUICKER / CONTROL_PERIOD) :], axis=1)


def main(seconds: float = 12.0) -> None:
    preset = HOOKED["hooked-B"]
    run = native.simulate(preset.scene(), sessions.trials_of(preset, 1, seed=0, longest=3.0))
    path = quicker_path(run.joints[0, : run.length[0]], run.onset[0, 1] - BEFORE, seconds, QUICKER)
    one = DrivenParams(preset.parts, preset.sensor, path, np.array(len(path), np.int32))
    scene = sensitivity.smooth(driven(hooked(impratio=preset.impratio)))
    with jax.enable_x64(True):
        start = time.perf_counter()
        tangents = [sensitivity.field_derivatives(scene, [one.parts], name, by) for name, by in STEPS.items()]
        value, forward = sensitivity.wrench_and_derivatives(scene, stack([one]), tangents, means)
        took = time.perf_counter() - start
        ends = [
            replace(one, parts=sensitivity.moved(one.parts, name, sign * by))
            for name, by in STEPS.items() for sign in (1, -1)
        ]  # fmt: skip
        found = sensitivity.values(scene, stack(ends), means).reshape(len(STEPS), 2, 6)
    central = (found[:, 0] - found[:, 1]) / (2 * np.array(list(STEPS.values())))[:, None]
    away = np.abs(forward[0].T - central) / np.maximum(np.abs(central), 1e-12)
    result = {
        "statistics": [f"mean {axis}" for axis in AXES], "values": value[0].tolist(), "periods": len(path),
        "parameters": {
            name: {"step": by, "forward": forward[0, :, i].tolist(), "central": central[i].tolist(),
                   "relative_difference": away[i].tolist()}
            for i, (name, by) in enumerate(STEPS.items())
        },
        "largest_relative_difference": float(away.max()), "limit": LIMIT, "holds": bool(away.max() <= LIMIT),
        "seconds_forward": round(took, 1),
    }  # fmt: skip
    write_result("derivatives", f"python -m experiments.simulation.derivatives --seconds {seconds:g}", result, seed=0)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
