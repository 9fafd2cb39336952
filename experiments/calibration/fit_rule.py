"""Is a calibrated fit rule better than its defaults? Limits from session A of the robot, scores on session B.

The defaults are the preset's limits with the automatic tolerance of session A. Each method of ``rcbht calibrate --rule
fit`` begins with them and uses session A alone, with harmonised states. An SVM that is trained and selected on session
A then classifies sub-tasks by plain words (histogram, n-grams, attributes), as ranks. Settings and rows were
fixed before the first score.

Run: python -m experiments.calibration.fit_rule --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import BENCHMARKS, REAL, items_of, of_sources, recorded, svm_on
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.fit_words import FIT_RULE
from experiments.classification.grammar import RANKS
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data
from rcbht_jax.calibration.rest import rest_not_constant, rest_thresholds
from rcbht_jax.calibration.rest_runs import RestRuns, fit_rest_limits
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyLimits, checked_limits
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import PLAIN
from rcbht_jax.labels import Primitive
from rcbht_jax.learning.tasks import extract_features, labelled_intervals
from rcbht_jax.types import Recordings

WINDOW, SIDE = 5, "A"
BENCHMARK = "REAL states, A to B"
SCORED = (BENCHMARK, "REAL merged states, A to B")
METHODS = ("default", "rest", "search")
CANDIDATES = 256
GROUPS = (0, 0, 0, 1, 1, 1)  # forces and moments
WORDS = FeatureSpec(families=PLAIN, balance=True)


class Experiment:
    """The recordings of the robot, and the limits that are calibrated on one session of them."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.recordings = of_sources(recorded(), (REAL,))
        self.config = FitConfig(WINDOW, self.recordings.dt)
        self.found: dict[str, AnyLimits] = {}

    @cached_property
    def data(self) -> CalibrationData:
        """The sentences of the training session."""
        training = self.recordings.take(np.flatnonzero(self.recordings.session == SIDE))
        return calibration_data(training, labelled_intervals(training, BENCHMARKS[BENCHMARK].task), self.config)

    @cached_property
    def training(self) -> Recordings:
        """The recordings that these sentences are in."""
        return self.recordings.take(np.flatnonzero(np.isin(self.recordings.trial, self.data.trial)))

    @cached_property
    def rest(self) -> RestRuns:
        """Runs at rest, for the penalty."""
        return RestRuns.of(self.training, self.config)

    def limits(self, method: str) -> AnyLimits:
        """Those of a method, found once."""
        if method not in self.found:
            self.found[method] = getattr(self, f"_{method}")()
        return self.found[method]

    def _default(self) -> AnyLimits:
        tolerance = auto_tolerance(self.training.wrench, self.training.length, self.config.needed)
        return FitLimits(np.asarray(preset().limits), tolerance)

    def _rest(self) -> AnyLimits:
        return fit_rest_limits(self.training, self.config).limits

    def _search(self) -> AnyLimits:
        space = SearchSpace(self.limits("default"), GROUPS)
        options = SearchOptions(space=space, candidates=CANDIDATES, seed=self.seed)
        return search(self.data, self.config, options, rest=self.rest).thresholds

    def calibrated(self, method: str) -> dict[str, Any]:
        """Limits of a method, and their scores on the session that chose them."""
        limits, data = self.limits(method), self.training
        stacked = checked_limits(self.config, limits)
        tracks = encode_batch(self.config, limits, data.wrench, data.length)
        rest = rest_thresholds(data, WINDOW, "fit").rest
        moving = rest_not_constant(tracks.primitive, rest, WINDOW, Primitive.CONS)
        one = FitLimits(stacked[None, :, :4], stacked[None, :, 4])
        words = int((np.asarray(tracks.primitive.label) > 0).sum())
        return {
            "limits": stacked[:, :4].tolist(),
            "tolerance": stacked[:, 4].tolist(),
            "share of rest that is constant, worst axis": round(1 - float(moving.max()), 4),
            "primitives per trial": round(words / len(data), 1),
            "fit inside": round(float(score_candidates(self.data, self.config, one)[0, 1]), 4),
        }

    def scored(self, benchmark: str, method: str) -> dict[str, Any]:
        """Accuracy on the other session."""
        items = items_of(self.recordings, BENCHMARKS[benchmark])
        limits, data = self.limits(method), self.recordings
        tracks = encode_batch(self.config, limits, data.wrench, data.length)
        features = extract_features({"W5": tracks}, items, WORDS)
        return BENCHMARKS[benchmark].score(svm_on({"x": features}, WORDS, items, RANKS), items, 1, self.seed)

    def about(self) -> dict[str, Any]:
        return {
            "what": "accuracy of words of the fit rule with limits and tolerances of each method",
            "calibrated on": f"session {SIDE}, harmonised states",
            "fit rule": FIT_RULE,
            "trials": len(self.data),
            "candidates": CANDIDATES,
            "choices": (
                "rows and settings were fixed before the first score; what rest takes for noise was changed after its "
                "tolerances on session A had been seen (with second differences they were about a fiftieth of the "
                "default)"
            ),
            "benchmarks": {
                name: BENCHMARKS[name].about(items_of(self.recordings, BENCHMARKS[name])) for name in SCORED
            },
        }


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(seed)
    rows = Rows("fit_calibration", command_of(main, locals()), experiment.about(), seed)
    wanted = {}
    for method in METHODS:
        wanted[f"limits | {method}"] = partial(experiment.calibrated, method)
        wanted |= {f"{name} | {method}": partial(experiment.scored, name, method) for name in SCORED}
    rows.fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
