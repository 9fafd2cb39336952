"""Simulated trials for the detection of faults: nominal ones, and each kind of fault at graded severities.

The grades run from a deviation with which the parts still seat to one with which they never do, so that some trials
lie at the boundary of success. Stores are kept in a folder and made once; an interrupted run goes on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rcbht_jax.data.store import read_recordings, read_simulation
from rcbht_jax.types import Recordings
from sim_mjx.randomize import Randomisation
from sim_mjx.synth import Synthesis, synthesise

# Kind -> what a grade is, and the fields of the distributions that each grade sets.
GRADES: dict[str, tuple[tuple[str, dict[str, float]], ...]] = {
    "jamming": tuple(
        (f"hooks of {hook:.2f} mm, friction x {rub:g}", {"jam_overlap": hook * 1e-3, "jam_friction": rub})
        for hook, rub in ((0.9, 1.5), (1.15, 2.2), (1.4, 3.0), (1.6, 3.5), (1.8, 4.5))
    ),
    "wedging": tuple(
        (f"turned {turn:g}, tilted {tilt:g} rad", {"wedge_roll": turn, "wedge_tilt": tilt})
        for turn, tilt in ((0.01, 0.005), (0.02, 0.01), (0.04, 0.02), (0.08, 0.04), (0.15, 0.1))
    ),
    "missing-tab": (("one tab of four", {}),),
    "moved-part": tuple((f"{away:g} mm", {"moved_by": away * 1e-3}) for away in (1, 2, 4, 8, 30)),
    "early-stop": tuple(
        (f"after {share:.0%} of the way to mating", {"stop_at": share}) for share in (0.3, 0.5, 0.7, 0.85, 0.97)
    ),
}
NOMINAL = "none"
_SHARD = 8


@dataclass(frozen=True)
class Trials:
    """Simulated trials with what was wrong with them, one row per trial."""

    recordings: Recordings
    kind: NDArray[np.str_]  # [trial] "none" or a fault
    grade: NDArray[np.int64]  # [trial] index into the kind's grades; 0 for nominal trials
    contact: NDArray[np.bool_]  # [trial] the parts touched: the robot came to the end of its approach


def spec_of(kind: str, grade: int) -> Randomisation:
    """The distributions of one kind and grade."""
    if kind == NOMINAL:
        return Randomisation(nominal_share=1.0)
    values: dict[str, Any] = {name: (value, value) for name, value in GRADES[kind][grade][1].items()}
    return replace(Randomisation(nominal_share=0.0, faults=(kind,)), **values)


def batches(nominal: int, per_kind: int) -> list[tuple[str, int, int]]:
    """Kind, grade and number of trials of every store."""
    faulty = [(kind, g, per_kind // len(grades)) for kind, grades in GRADES.items() for g in range(len(grades))]
    return [(NOMINAL, 0, nominal), *faulty]


def trials(folder: Path, preset: str, nominal: int, per_kind: int, seed: int) -> Trials:
    """Simulate what is not in the folder yet, and read it all."""
    folder.mkdir(parents=True, exist_ok=True)
    parts, kinds, grades, contact = [], [], [], []
    for number, (kind, grade, count) in enumerate(
        tqdm(batches(nominal, per_kind), desc=f"simulate {preset}", file=sys.stderr, disable=None)
    ):
        path = folder / f"{preset}-{kind}-{grade}-{count}-{seed}.zarr"
        if not path.exists():
            job = Synthesis(preset, count, 1000 * seed + number, shard=_SHARD, spec=spec_of(kind, grade))
            synthesise(path, job)
        one = read_recordings(path)
        parts.append(replace(one, trial=np.char.add(f"{kind}-{grade}-", one.trial.astype(str))))
        touched = np.isfinite(one.onset[:, 1])
        if kind == "moved-part" and GRADES[kind][grade][1]["moved_by"] > 0.02:
            touched &= False  # the part stands beyond the reach of the hand's
        contact.append(touched)
        kinds += [kind] * len(one)
        grades += [grade] * len(one)
    return Trials(joined(parts), np.array(kinds), np.array(grades, np.int64), np.concatenate(contact))


def joined(parts: list[Recordings]) -> Recordings:
    """Several data sets as one."""
    longest = max(part.wrench.shape[1] for part in parts)
    wide = [np.pad(part.wrench, ((0, 0), (0, longest - part.wrench.shape[1]), (0, 0))) for part in parts]
    rows = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in (
            "length", "onset", "onset_harmonised", "trial", "arm", "source", "session", "outcome", "failure_type",
            "deviation", "note",
        )
    }  # fmt: skip
    return Recordings(wrench=np.concatenate(wide), dt=parts[0].dt, **rows)


def truth(path: Path) -> dict[str, NDArray[Any]]:
    """What only the simulation knows about the trials of a store."""
    return read_simulation(path)
