"""Kitting, two more questions: a Gaussian-process band as a monitor, and which type of anomaly it was on a new day.

The band (scikit-learn's GaussianProcessRegressor over time, channel by channel) is measured as the monitors of
experiments.external.kitting are, on the contact channels.

Types: the one method (experiments.external.method), as it was frozen, on anomalous executions of all skills; each day
is held out in turn. Type and day are confounded, so that folds across days ("random folds") measure the day and not the
type; they show by how much. Before an anomaly its type cannot be known: the rows of the samples until then are a
control. A type that occurred on one day only cannot be recognised when that day is held out; the rows "types of several
days" leave these out.

Run: python -m experiments.external.kitting_more --seed 0 (reads RCBHT_EXTERNAL)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from sklearn.model_selection import StratifiedKFold

from experiments._lib.benchmarks import rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import bootstrap
from experiments.external import kitting, method
from rcbht_jax._util.cells import number_of
from rcbht_jax.introspection.nominal_peers import GaussianProcessBand
from rcbht_jax.learning import metrics, validation
from rcbht_jax.learning.svm import Split
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

FOLDS = 5
ABOUT = {
    "band": "150 moments, squared exponential and noise, contact channels",
    "types": method.ABOUT,
    "choices made after looking": "none: band and types were measured once, as they are",
}


class Experiment:
    """The executions, read once."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    @cache  # noqa: B019 (one object lives as long as the program)
    def recordings(self) -> Recordings:
        return kitting.read_executions()

    def band(self) -> dict[str, Any]:
        executions = {skill: kitting.of_skill(self.recordings(), skill) for skill in kitting.skills(self.recordings())}
        columns = [kitting.CHANNELS.index(channel) for channel in kitting.SETS["contact"]]
        band = GaussianProcessBand(
            rate=1 / self.recordings().dt, score_rate=kitting.SCORE_RATE, memory=1 / kitting.SCORE_RATE,
            random_state=self.seed,
        )  # fmt: skip
        return kitting.measure(band, executions, columns, np.random.default_rng(self.seed))

    @cache  # noqa: B019
    def anomalies(self, several: bool, until_onset: bool) -> tuple[Recordings, LabelledIntervals]:
        """Anomalous executions of known type: whole, or until the anomaly."""
        every = self.recordings()
        kind, onset = every.columns["anomaly"].astype(str), np.array(list(map(number_of, every.columns["anomaly_rel"])))
        rows = np.flatnonzero((every.outcome != "success") & (kind != "") & (onset * 1 / every.dt >= method.SHORT * 2))
        if several:
            rows = rows[[len(np.unique(every.session[rows][kind[rows] == kind[row]])) > 1 for row in rows]]
        chosen = every.take(rows)
        if until_onset:
            length = np.minimum(np.floor(onset[rows] / every.dt), chosen.length).astype(np.int32)
            inside = np.arange(chosen.wrench.shape[1]) < length[:, None]
            chosen = replace(chosen, wrench=chosen.wrench * inside[..., None], length=length)
        return chosen, labelled_intervals(chosen, TaskSpec("anomaly", outcomes=()))

    def types(
        self, make: Callable[[Recordings, LabelledIntervals], validation.Estimator], several: bool = False,
        until_onset: bool = False, by_day: bool = True,
    ) -> dict[str, Any]:  # fmt: skip
        recordings, items = self.anomalies(several, until_onset)
        predicted = np.zeros(len(items.y), np.int64)
        for train, test in by_days(items) if by_day else random_folds(items, self.seed):
            predicted[test] = make(recordings, items)(train, test, self.seed)[0]
        right = predicted == items.y
        low, high = bootstrap(right, items.session, self.seed)
        return rounded({
            "accuracy": {"mean": float(right.mean()), "low": low, "high": high},
            "balanced_accuracy": {"mean": metrics.balanced_accuracy(items.y, predicted)},
            "executions": len(items.y),
            "types": dict(zip(items.classes, np.bincount(items.y).tolist(), strict=True)),
        })  # fmt: skip


def by_days(items: LabelledIntervals) -> list[Split]:
    """Each day held out in turn."""
    days = np.unique(items.session)
    return [(np.flatnonzero(items.session != day), np.flatnonzero(items.session == day)) for day in days]


def random_folds(items: LabelledIntervals, seed: int) -> list[Split]:
    return list(StratifiedKFold(FOLDS, shuffle=True, random_state=seed).split(items.y, items.y))


def ours(recordings: Recordings, items: LabelledIntervals) -> validation.Estimator:
    """The one method."""
    words, wrench = method.describe(recordings, items)
    return lambda train, test, seed: (method.believe(words, wrench, items.y, train, test, seed).argmax(1), {})


def skill_alone(recordings: Recordings, items: LabelledIntervals) -> validation.Estimator:
    """The commonest type of the skill, a baseline without any sensor."""
    skill = recordings.columns["skill"].astype(str)[items.intervals[0].recording]
    return validation.forest(np.stack([skill == name for name in np.unique(skill)], 1).astype(float), items.y)


def commonest(recordings: Recordings, items: LabelledIntervals) -> validation.Estimator:
    return validation.majority(items.y)


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Measure the band, and the types of anomalies across days."""
    experiment = Experiment(seed)
    types = experiment.types
    wanted: dict[str, Callable[[], Any]] = {
        "contact: Gaussian-process band": experiment.band,
        "types | words + wrench, a new day": partial(types, ours),
        "types | skill alone, a new day": partial(types, skill_alone),
        "types | majority, a new day": partial(types, commonest),
        "types | words + wrench until the anomaly, a new day": partial(types, ours, until_onset=True),
        "types of several days | words + wrench, a new day": partial(types, ours, several=True),
        "types of several days | skill alone, a new day": partial(types, skill_alone, several=True),
        "types of several days | majority, a new day": partial(types, commonest, several=True),
        "types of several days | words + wrench until the anomaly, a new day": partial(
            types, ours, several=True, until_onset=True
        ),
        "types of several days | words + wrench, random folds": partial(types, ours, several=True, by_day=False),
        "types of several days | words + wrench until the anomaly, random folds": partial(
            types, ours, several=True, until_onset=True, by_day=False
        ),
    }
    Rows("kitting_more", command_of(main, locals()), ABOUT, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
