"""Zero shot: the frozen method trained on simulated trials, of which nothing was fitted to a recorded session.

One part, that of the OpenHRP preset, which was fitted to the authors' own simulation; a sensor such as data sheets
describe (unit gain, a low pass of 10 Hz, noise of a twentieth of a percent of 200 N and 10 Nm, moments about a point
5 cm from the wrist); widely randomised placement, parts, gains, set-points, speed, noise and drift. Kernel, cost and
families are chosen inside the simulated set. Of a recorded trial the mean of its first second is subtracted; nothing
else is used before it is classified. The settings below were fixed before the first score; that mating must vary in
length, and that a sensor needs noise, was known from scores on the same recorded trials (docs/evaluation.md).

Run: python -m experiments.classification.zero_shot FOLDER
FOLDER keeps the simulated set; it is made if it is missing. Reads the recorded trials (RCBHT_DATA).
Finished rows are stored; the same command resumes an interrupted run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments._lib import frozen
from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import recorded, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.intervals import by_trial
from experiments._lib.tasks import states
from experiments.classification.sim_to_real_sets import TARE_SECONDS, WIDE
from rcbht_jax.io.store import read_recordings
from rcbht_jax.io.tare import tare
from rcbht_jax.learning import validation
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.types import Recordings
from sim_mjx.synthesis import pipeline
from sim_mjx.synthesis.plan import SynthesisConfig

SEED, TRIALS, PRESET = 40, 256, "openhrp"
BOUNDARIES = {"merged": "three states", "harmonised": "four states"}
SESSIONS = ("A", "B")
WORN = "A"  # a session's sensor has to be named for noise and drift to vary; every number of it is replaced below
SENSOR = (
    ("sensor.a", 0.73), ("sensor.b", 0.27), ("sensor.c", 1.0), ("sensor.d", 0.0),  # 10 Hz at 200 Hz, unit gain
    ("sensor.delay", 5.0), ("sensor.tared", 1.0),
    ("sensor.noise[0:3]", 0.1), ("sensor.noise[3:6]", 0.005), ("sensor.step[0:3]", 0.02), ("sensor.step[3:6]", 0.001),
    ("sensor.bias", 0.0), ("sensor.reference[0]", -0.05), ("sensor.reference[1:3]", 0.0),
)  # fmt: skip
SPEC = replace(WIDE, mating=(0.5, 30.0), sensor=WORN, physical=SENSOR)
FEATURES = {"frozen": False, "frozen, relative": True}


class Experiment:
    """Simulated and recorded trials in one set."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.method = folder, frozen.load()

    @cache  # noqa: B019 (one object lives as long as the program)
    def recordings(self) -> Recordings:
        target = self.folder / f"zero-shot-{TRIALS}.zarr"
        if not target.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            pipeline.synthesise(target, SynthesisConfig(PRESET, TRIALS, SEED, shard=64, spec=SPEC))
        known, made = recorded(), read_recordings(target)
        real = known.take(np.isin(known.session, SESSIONS))
        made = replace(made, session=np.full(len(made), "simulated"))
        return tare(Recordings.join([made, real]), round(TARE_SECONDS / real.dt))

    @cache  # noqa: B019
    def grammars(self) -> frozen.Grammars:
        return self.method.grammars(self.recordings())

    @cache  # noqa: B019
    def items(self, boundaries: str) -> LabelledIntervals:
        return labelled_intervals(self.recordings(), replace(states(outcomes=()), boundaries=boundaries))

    def learner(self, name: str, items: LabelledIntervals) -> validation.Estimator:
        if name == "duration alone":
            return validation.forest(items.seconds, items.y)
        if name not in FEATURES:
            return raw.forest(raw.statistics(segments(self.recordings(), items)), items.y)
        return self.method.learner(self.grammars(), items, FEATURES[name])

    def row(self, boundaries: str, name: str) -> Callable[[], Any]:
        def make() -> Any:
            items = self.items(boundaries)
            train, test = (np.flatnonzero((items.session == "simulated") == side) for side in (True, False))
            predicted, choice = self.learner(name, items)(train, test, SEED)
            right = predicted == items.y[test]
            out: dict[str, Any] = {"training trials": len(np.unique(items.trial[train]))}
            for sessions in (*((one,) for one in SESSIONS), SESSIONS):
                mine = np.isin(items.session[test], sessions)
                tested = len(np.unique(items.trial[test][mine]))
                out["+".join(sessions)] = by_trial(float(right[mine].mean()), tested) | {"trials": tested}
            wrong = Counter(
                f"{items.classes[true]} as {items.classes[said]}"
                for true, said in zip(items.y[test][~right].tolist(), predicted[~right].tolist(), strict=True)
            )
            chosen = {key: choice[key] for key in ("features", "kernel", "cost") if key in choice}
            return rounded(out) | {"wrong": dict(wrong), "chosen": chosen, "method": self.method.sha256}

        return make


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    experiment = Experiment(folder)
    about = {
        "what": "states of recorded trials by the frozen method, trained on simulated trials fitted to none of them",
        "used of a recorded trial": f"the mean of its first {TARE_SECONDS:g} s, which is subtracted",
        "preset": PRESET,
        "simulated trials": TRIALS,
        "randomisation": asdict(SPEC),
        "sha256 of the method": experiment.method.sha256,
    }
    names = (*FEATURES, "duration alone", "statistics + random forest")
    rows = Rows("zero_shot", "python -m experiments.classification.zero_shot FOLDER", about, SEED)
    wanted = {f"{BOUNDARIES[kind]} | {name}": experiment.row(kind, name) for kind in BOUNDARIES for name in names}
    rows.fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
