"""The gate of simulated sessions, applied to the presets, to recordings, and to null models.

For every session the preset, and the one with hooks that catch or with rigid contacts; the same without tabs, with soft
springs, and with another session's parts; a constant for every state and axis; and the recorded mean with sensor noise.
As a control, one half of the recordings against the other. Null models must fail, recordings must pass. Intervals leave
out each trial once, recorded and simulated. Where a session has a grid of placements, the trials are counted that seat,
or do not, as recorded.
Run: python -m experiments.simulation.fidelity_gate [--session A B C openhrp hooked-A hooked-B hooked-C rigid-openhrp]
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.intervals import jackknife, of_auc
from experiments._lib.results_io import defaults_of, given, write_result
from rcbht_jax.learning.metrics import has_width
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import PartParams
from sim_mjx.presets import HOOKED, ONE_ARM
from sim_mjx.presets.openhrp import RIGID
from sim_mjx.presets.session import SessionPreset
from sim_mjx.validation import gate, sessions, signature
from sim_mjx.validation.dynamics import Dynamics
from sim_mjx.validation.fidelity import rerun, snap_shares
from sim_mjx.validation.gate import Check

SEED = 0
SESSIONS = ONE_ARM | HOOKED | {RIGID.name: RIGID}
OTHER = {"A": "B", "B": "A", "C": "A", "openhrp": "A"}  # whose parts a session is given
COVERAGE, W1, DTW = 0.64, 0.75, 0.67  # limits of the former gate: the similarity of session A to session B
MEASURES = ("coverage", "W1/sd", "DTW/sd", "spread", "AUC")  # those with an interval
SOFT = 0.01  # of the springs' stiffness


def parts_of(name: str, preset: SessionPreset) -> PartParams:
    """The parts of a null model, in the session's place."""
    parts = preset.parts
    if name == "no tabs":
        return parts.with_overlap(np.full(4, -1e-3))
    if name == "soft springs":
        return replace(parts, tab_stiffness=SOFT * np.asarray(parts.tab_stiffness))
    other = ONE_ARM[OTHER[preset.name]].parts
    return replace(other, position=parts.position, roll=parts.roll)


def of_session(preset: SessionPreset, recordings: Recordings) -> dict[str, Any]:
    """Every row of a session."""
    target = sessions.recorded(recordings, preset.name)
    reference = target.profiles
    out = {}
    models = ("the preset", "no tabs", "soft springs", "another session's parts")
    for name in models if preset.name in OTHER else models[:3]:  # those with hooks have the same parts
        model = preset if name == "the preset" else replace(preset, parts=parts_of(name, preset))
        run, events, found = rerun(model, seed=SEED)
        pair, shares = (target.dynamics, events), snap_shares(target, found)
        out[name] = row(preset, reference, sessions.profiles(run), pair, shares)
        out[name]["seated"] = float(run.seated.all(1).mean())
        if preset.placements:
            out[name]["outcomes as recorded"] = sessions.agreement(preset, run)
    rng = np.random.default_rng(SEED)
    mean = np.broadcast_to(reference.mean((0, 2), keepdims=True), reference.shape)
    out["a constant per state and axis"] = row(preset, reference, mean + 1e-9 * rng.normal(size=mean.shape))
    noise = rng.normal(size=reference.shape) * preset.sensor.noise
    out["recorded mean and noise"] = row(preset, reference, reference.mean(0) + noise)
    out["recordings: one half against the other"] = row(preset, reference[::2], reference[1::2])
    return out


def row(
    preset: SessionPreset,
    reference: np.ndarray,
    test: np.ndarray,
    events: tuple[Dynamics, Dynamics] | None = None,
    shares: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Measures of the gate, and the verdict of the former one."""
    if len(test) < gate.LEAST or preset.gate is None:
        return {"mated": len(test), "checks": {}, "passes": False, "passed before": False}
    found = gate.checks(preset.gate, reference, test, events, shares)
    before = {
        "coverage": Check(found["coverage"].value, low=COVERAGE),
        "W1/sd": Check(found["W1/sd"].value, high=W1),
        "DTW/sd": Check(found["DTW/sd"].value, high=DTW),
    }
    return {
        "mated": len(test),
        "checks": gate.as_json(found),
        "intervals": intervals(reference, test, found["AUC"].value),
        "passes": all(check.holds for check in found.values()),
        "passed before": all(check.holds for check in before.values()),
    }


def intervals(reference: np.ndarray, test: np.ndarray, area: float | None) -> dict[str, list[float]]:
    """95 % intervals of measures between two sets of trials: by jackknife, and Wilson's for the AUC of the fewer.

    What cannot vary, such as the spread of equal trials, has none.
    """

    def measures(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        score = signature.compare(one, other)
        return np.array([score.coverage, score.w1_over_sd, score.dtw_over_sd, gate.spread(one, other)])

    low, high = jackknife(measures, reference, test)
    ends = np.stack([np.maximum(low, 0.0), np.minimum(high, (1.0, *[np.inf] * 3))], 1)
    found = rounded([*ends.tolist(), list(of_auc(area or 0.0, [len(reference), len(test)]))])
    return {name: each for name, each in zip(MEASURES, found, strict=True) if has_width(*each)}


def main(session: tuple[str, ...] = tuple(SESSIONS)) -> None:
    recordings = recorded()
    result = {"rows": {name: of_session(SESSIONS[name], recordings) for name in session}}
    result["states"] = list(signature.STATES)
    command = "python -m experiments.simulation.fidelity_gate" + given(locals(), defaults_of(main))
    write_result("fidelity_gate", command, result, seed=SEED, show=False)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
