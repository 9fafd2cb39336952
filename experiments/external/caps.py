"""Segmentation of screwed caps: every sample of runs that did not train the model, from the wrench alone.

Runs of about 8 s at 40 Hz with six labels, made by hand. Peers use the same samples: one ensemble of trees on the
wrench without words and without the second ensemble, and, offline, changes found by ClaSP and CLaP with segments
labelled by the one method (experiments.external.change_points).

Run: python -m experiments.external.caps --seed 0
Reads RCBHT_EXTERNAL; the rows of ClaSP and CLaP need the libraries aeon and claspy (see make peers).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import LeaveOneOut

from experiments._lib.benchmarks import rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.other_robots import of_other_robot
from experiments.external import change_points
from experiments.external.change_points import DETECTORS, ORACLE
from rcbht_jax.features.trailing import trailing_statistics, with_norms
from rcbht_jax.introspection.segmentation import Protocol, segment
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.learning.segment_metrics import score_and_interval
from rcbht_jax.types import Recordings

WINDOWS = (0.1, 0.3, 1.0, 3.0)  # s, of the peer
TREES = 150
ABOUT = {
    "method": "WrenchSegmenter with its defaults",
    "intervals": "95 %, runs drawn with replacement; of one run that teaches, training and labelled runs apart",
    "looks before": (
        "eleven descriptions and sequence models were scored on these runs while the method was designed: windows, "
        "lags, running totals, hidden Markov models with durations, stacking and copies; numbers are optimistic by "
        "what that choice is worth"
    ),
}


class Experiment:
    """The runs, read once."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    @cache  # noqa: B019 (one object lives as long as the program)
    def recordings(self) -> Recordings:
        return of_other_robot("caps/runs_40hz", "caps_40hz")

    def truth(self) -> list[NDArray[np.int64]]:
        """The annotated code of every sample of each run."""
        data, track = self.recordings(), self.recordings().annotations.choose()
        return [data.annotations.of_samples(i, track, n, data.dt) for i, n in enumerate(data.length.tolist())]

    def ours(self, one_shot: bool = False, **options: Any) -> Any:
        protocol = Protocol(folds=0, one_shot=one_shot)
        return rounded(
            segment(self.recordings(), WrenchSegmenter(random_state=self.seed, **options), protocol).to_json()
        )

    def peer(self, one_shot: bool) -> Any:
        """Trees on windows that end at the sample."""
        data, y = self.recordings(), self.truth()
        lengths = data.length.tolist()
        signals = [with_norms(data.wrench[i, :n].astype(float), data.units) for i, n in enumerate(lengths)]
        x = [trailing_statistics(signal, data.dt, WINDOWS) for signal in signals]
        truth, predicted, drawn = [], [], []
        for train, test in LeaveOneOut().split(lengths):
            train, test = (test, train) if one_shot else (train, test)
            forest = ExtraTreesClassifier(TREES, min_samples_leaf=3, random_state=self.seed)
            forest.fit(np.concatenate([x[i] for i in train]), np.concatenate([y[i] for i in train]))
            truth += [y[i] for i in test]
            predicted += [forest.predict(x[i]) for i in test]
            drawn += [(train[0], i) if one_shot else (i,) for i in test]
        return _scored(truth, predicted, data.dt, np.array(drawn))

    def change_points(self, detector: str) -> dict[str, Any]:
        """Changes found without labels, segments labelled by the one method."""
        data = self.recordings()
        predicted, counts = change_points.scored(data, detector, self.seed)
        return _scored(self.truth(), predicted, data.dt, np.arange(len(data))) | counts


def _scored(truth: list[Any], predicted: list[Any], dt: float, groups: NDArray[Any]) -> dict[str, Any]:
    """Scores, and their intervals from runs drawn with replacement, as of Segmentation."""
    score, interval = score_and_interval(truth, predicted, dt, groups)
    ends = {name: [None if np.isnan(end) else end for end in pair] for name, pair in interval.items()}
    return rounded({"score": score.to_json(), "interval": ends})


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Label every run by models of the others, and by models of a single other run."""
    experiment = Experiment(seed)
    wanted: dict[str, Callable[[], Any]] = {
        "causal": experiment.ours,
        "causal, one run teaches": partial(experiment.ours, one_shot=True),
        "causal, without words": partial(experiment.ours, words=False),
        "offline": partial(experiment.ours, offline=True),
        "trees on the wrench": partial(experiment.peer, one_shot=False),
        "trees on the wrench, one run teaches": partial(experiment.peer, one_shot=True),
        **{f"{name}, offline": partial(experiment.change_points, name) for name in (*DETECTORS, ORACLE)},
    }
    Rows("external_caps", command_of(main, locals()), ABOUT, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
