"""Zero shot: the frozen method trained on simulated trials, of which nothing was fitted to a recorded session.

The trials are those of ``experiments._lib.zero_shot_set``. Kernel, cost and families are chosen inside the simulated
set. Of a recorded trial the mean of its first second is subtracted; nothing else is used before it is classified. The
settings were fixed before the first score; that mating must vary in length, and that a sensor needs noise, was known
from scores on the same recorded trials (docs/evaluation.md).

Run: python -m experiments.classification.zero_shot FOLDER
FOLDER keeps the simulated set; it is made if it is missing. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments._lib import frozen
from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import mistakes, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.intervals import by_trial
from experiments._lib.tasks import states
from experiments._lib.zero_shot_set import (
    PRESET,
    SEED,
    SESSIONS,
    SIMULATED,
    SPEC,
    TARE_SECONDS,
    TRIALS,
    simulated_and_recorded,
)
from rcbht_jax.learning import validation
from rcbht_jax.learning.tasks import LabelledIntervals, labelled_intervals
from rcbht_jax.types import Recordings

BOUNDARIES = {"merged": "three states", "harmonised": "four states"}
FEATURES = {"frozen": False, "frozen, relative": True}


class Experiment:
    """Simulated and recorded trials in one set."""

    def __init__(self, folder: Path, seed: int = SEED) -> None:
        self.folder, self.seed, self.method = folder, seed, frozen.load()

    @cache  # noqa: B019 (one object lives as long as the program)
    def recordings(self) -> Recordings:
        return simulated_and_recorded(self.folder, self.seed)

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

    def row(self, boundaries: str, name: str) -> dict[str, Any]:
        items = self.items(boundaries)
        train, test = (np.flatnonzero((items.session == SIMULATED) == side) for side in (True, False))
        predicted, choice = self.learner(name, items)(train, test, SEED)
        right = predicted == items.y[test]
        out: dict[str, Any] = {"training trials": len(np.unique(items.trial[train]))}
        for sessions in (*((one,) for one in SESSIONS), SESSIONS):
            mine = np.isin(items.session[test], sessions)
            tested = len(np.unique(items.trial[test][mine]))
            out["+".join(sessions)] = by_trial(float(right[mine].mean()), tested) | {"trials": tested}
        wrong = mistakes(items.classes, items.y[test], predicted)
        chosen = {key: choice[key] for key in ("features", "kernel", "cost") if key in choice}
        return rounded(out) | {"wrong": wrong, "chosen": chosen, "method": self.method.sha256}


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
    wanted = {
        f"{BOUNDARIES[kind]} | {name}": partial(experiment.row, kind, name) for kind in BOUNDARIES for name in names
    }
    rows.fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
