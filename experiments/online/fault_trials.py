"""Simulated trials for the detection of faults: nominal ones, and each kind of fault at graded severities.

The grades run from a deviation with which the parts still seat to one with which they never do, so that some trials
lie at the boundary of success. Every record goes on for a while after the planned end of its trial, as by a logger
without knowledge of faults: after mating, and after an early stop, the robot keeps still. Such a tail is therefore no
sign of a fault. Stores are kept in a folder and made once; an interrupted run goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.simulated import simulated
from rcbht_jax.introspection.fault_monitor import NOMINAL
from rcbht_jax.io.store import read_simulation
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import TABS
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.plan import SynthesisConfig

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
REACH = 0.02  # m: a part that has moved farther stands beyond the reach of the hand's
TAIL = 3.0  # s, for which every record goes on after the planned end of its trial, the robot keeping still


@dataclass(frozen=True)
class Trials:
    """Simulated trials with what was wrong with them, one row per trial."""

    recordings: Recordings
    kind: NDArray[np.str_]  # [trial] "none" or a fault
    grade: NDArray[np.int64]  # [trial] index into the kind's grades; 0 for nominal trials
    contact: NDArray[np.bool_]  # [trial] the parts touched: the robot came to the end of its approach
    cause: NDArray[np.str_]  # [trial] the kind, with the tab that is missing
    stop: NDArray[np.float64]  # [trial] s, from then on the robot keeps still; beyond the record if it does not
    end: NDArray[np.float64]  # [trial] s, of the mating as planned: what is recorded later is the tail

    @property
    def nominal(self) -> NDArray[np.bool_]:
        """Trials without a fault that seated ``[trial]``."""
        return (self.kind == NOMINAL) & ~self.failed

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Trials that did not seat ``[trial]``."""
        return np.asarray(self.recordings.outcome == "failure")

    def take(self, rows: NDArray[Any]) -> Trials:
        """Some trials."""
        columns = {field.name: getattr(self, field.name)[rows] for field in fields(self) if field.name != "recordings"}
        return Trials(self.recordings.take(rows), **columns)

    @classmethod
    def join(cls, sets: Sequence[Trials]) -> Trials:
        """Several sets as one."""
        columns = {field.name: [getattr(one, field.name) for one in sets] for field in fields(cls)}
        recordings = Recordings.join(columns.pop("recordings"))
        return cls(recordings, **{name: np.concatenate(parts) for name, parts in columns.items()})


@dataclass(frozen=True)
class Lot:
    """The trials of one store."""

    name: str  # with which its file begins
    kind: str
    grade: int
    count: int
    spec: DomainRandomization


def spec_of(kind: str, grade: int) -> DomainRandomization:
    """The distributions of one kind and grade."""
    values = {} if kind == NOMINAL else GRADES[kind][grade][1]
    return drawn_from(kind, {name: (value, value) for name, value in values.items()})


def drawn_from(fault: str, ranges: dict[str, Any]) -> DomainRandomization:
    """The distributions of a fault, or of nominal trials."""
    if fault == NOMINAL:
        return DomainRandomization(nominal_share=1.0, logs_on=TAIL)
    return replace(DomainRandomization(nominal_share=0.0, faults=(fault,), logs_on=TAIL), **ranges)


def batches(nominal: tuple[int, ...], per_kind: int) -> list[tuple[str, int, int]]:
    """Kind, grade and number of trials of every store; nominal trials may come in several."""
    # a kind that has no grades is four kinds, any tab may be missing, and the hardest to see
    each = {kind: 6 * per_kind if len(grades) == 1 else per_kind // len(grades) for kind, grades in GRADES.items()}
    faulty = [(kind, g, each[kind]) for kind, grades in GRADES.items() for g in range(len(grades))]
    first, *more = [(NOMINAL, 0, count) for count in nominal]
    return [first, *faulty, *more]


def trials(folder: Path, preset: str, nominal: tuple[int, ...], per_kind: int, seed: int) -> Trials:
    """Simulate what is not in the folder yet, and read it all; each number of ``nominal`` trials is a store."""
    lots = [
        Lot(f"{preset}-{kind}-{grade}", kind, grade, count, spec_of(kind, grade))
        for kind, grade, count in batches(nominal, per_kind)
    ]
    return made(folder, preset, lots, seed)


def made(folder: Path, preset: str, lots: Sequence[Lot], seed: int, shard: int = 256) -> Trials:
    """The trials of several stores, of which those that are missing are simulated; an interrupted run goes on."""
    found = []
    for number, lot in enumerate(tqdm(lots, desc=f"simulate {preset}", file=sys.stderr, disable=None)):
        its = 1000 * seed + number
        job = SynthesisConfig(preset, lot.count, its, shard=shard, spec=lot.spec)
        found.append(_read(folder / f"{lot.name}-{lot.count}-{its}.zarr", job, lot))
    return Trials.join(found)


def missing_tab(truth: dict[str, NDArray[np.generic]]) -> NDArray[np.str_]:
    """The tab of each trial ``[trial]`` that has broken off, if one has: a hook is cut, a block is set back."""
    gone = truth["tab_cut"] if "tab_cut" in truth else -truth["hook_overlap"]
    return np.array(TABS)[gone.argmax(1)]


def _read(path: Path, job: SynthesisConfig, lot: Lot) -> Trials:
    """One store; where mating was not reached, its end is the planned one."""
    recordings = simulated(path, job)
    truth, session, count = read_simulation(path), preset_of(job.preset), len(recordings)
    recordings = replace(recordings, trial=np.char.add(f"{path.stem}-", recordings.trial.astype(str)))
    begun = recordings.starts(RECORDED)
    planned = truth["way_time"][:, -1] + session.mating_begins - session.task.way_time[-1]
    end = np.where(np.isfinite(begun[:, 3]), begun[:, 3], planned) + session.task.mating_time
    beyond = lot.spec.moved_by[0] > REACH and lot.kind == "moved-part"
    touched = np.isfinite(begun[:, 1]) & (not beyond)
    kind = np.full(count, lot.kind)
    cause = np.char.add("missing-tab ", missing_tab(truth)) if lot.kind == "missing-tab" else kind
    return Trials(recordings, kind, np.full(count, lot.grade), touched, cause, truth["stop"], end)
