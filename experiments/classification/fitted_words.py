"""Do better lines make better sentences? The fit rule and the paper's rule on the same folds, families and grids.

Sub-tasks are classified by plain words (histogram, n-grams, attributes) and by richer words, within sets and from one
session of the robot to another. Labels of the fit rule weigh as those of the paper's (by time and count), or by time
and change of value. Gradient limits are the preset's; in the rows with a choice, the inner folds choose between these
limits, a quarter and a sixteenth of them. Tolerances are learned without labels: of the robot from session A, of the
simulation from its own trials.

Run: python -m experiments.classification.fitted_words --repeats 2 --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import BENCHMARKS, REAL, SIM1, items_of, of_sources, published_words, recorded, svm_on
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.fit_words import FIT_RULE, THREE, WEIGHED, WINDOW, tolerances
from experiments.classification.grammar import DEVIATION, RANKS, counted
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import PLAIN, RICHER
from rcbht_jax.learning.tasks import LabelledIntervals, extract_features
from rcbht_jax.types import LabelTracks

SCALES = (1.0, 1 / 4, 1 / 16)
ACROSS = tuple(name for name, benchmark in BENCHMARKS.items() if benchmark.train_on)
CHOSEN = (*ACROSS, "SIM1 states")  # those in which the paper's words are not near 1
FINER = (2, 4, 8)


@dataclass(frozen=True)
class Sentence:
    """The features of one row."""

    rule: str
    families: tuple[str, ...]
    ranks: bool = True
    weighing: tuple[str, ...] = ()
    scales: tuple[float, ...] = (1.0,)
    tolerances: tuple[float, ...] = (1.0,)  # factors on the learned one, of encoders side by side

    @property
    def spec(self) -> FeatureSpec:
        return FeatureSpec(families=self.families, balance=True, weighing=self.weighing)


def _rows(kind: str, families: tuple[str, ...], ranks: bool = True) -> dict[str, Sentence]:
    paper = Sentence("paper", families, ranks)
    fit = replace(paper, rule="fit")
    weighed = replace(fit, weighing=WEIGHED)
    return {
        f"{kind}, paper": paper,
        f"{kind}, paper, choice of limits": replace(paper, scales=SCALES),
        f"{kind}, fit": fit,
        f"{kind}, fit, weighed": weighed,
        f"{kind}, fit, weighed, choice of limits": replace(weighed, scales=SCALES),
    }


SENTENCES = {
    **_rows("plain words, mean and deviation", PLAIN, ranks=False),
    **_rows("plain words", PLAIN),
    **_rows("richer words", RICHER),
    # Do the paper's words contain more than lines below the tolerance? Added after the rows above were seen.
    **{f"plain words, fit, tolerance / {part}": Sentence("fit", PLAIN, tolerances=(1 / part,)) for part in FINER},
    # Do coarse and fine lines complement each other? Two and three tolerances were tried, after all rows above.
    "plain words, fit, two tolerances": Sentence("fit", PLAIN, tolerances=THREE[:2]),
    "plain words, fit, three tolerances": Sentence("fit", PLAIN, tolerances=THREE),
    "plain words, fit, weighed, three tolerances": Sentence("fit", PLAIN, weighing=WEIGHED, tolerances=THREE),
    "richer words, fit, three tolerances": Sentence("fit", RICHER, tolerances=THREE),
}


class Experiment:
    """The recordings, labelled once by each rule."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed
        self.recordings = of_sources(recorded(), (REAL, SIM1))
        self.tolerance = {source: values.tolist() for source, values in tolerances(self.recordings).items()}

    @cache  # noqa: B019 (one object lives as long as the program)
    def tracks(self, rule: str, scale: float, factor: float) -> LabelTracks:
        data = self.recordings
        if rule == "paper":
            return published_words(data, WINDOW, scale)
        limits = np.asarray(preset().limits) * scale
        tolerance = factor * np.array([self.tolerance[source] for source in data.source.tolist()])
        wide = np.broadcast_to(limits, (len(data), *limits.shape))
        return encode_batch(FitConfig(WINDOW, data.dt), FitLimits(wide, tolerance), data.wrench, data.length)

    @cache  # noqa: B019
    def items(self, benchmark: str) -> LabelledIntervals:
        return items_of(self.recordings, BENCHMARKS[benchmark])

    def row(self, benchmark: str, name: str) -> dict[str, Any]:
        sentence, items, chosen = SENTENCES[name], self.items(benchmark), Counter[str]()
        features = {
            f"limits x {scale:g}": extract_features(
                {f"W5 x {factor:g}": self.tracks(sentence.rule, scale, factor) for factor in sentence.tolerances},
                items, sentence.spec,
            )
            for scale in sentence.scales
        }  # fmt: skip
        learner = counted(svm_on(features, sentence.spec, items, RANKS if sentence.ranks else DEVIATION), chosen)
        score = BENCHMARKS[benchmark].score(learner, items, self.repeats, self.seed)
        return {**score, "repeats": self.repeats, "chosen": dict(chosen.most_common())}

    def about(self) -> dict[str, Any]:
        return {
            "what": "accuracy of words of two rules, nested and grouped by trial",
            "fit rule": FIT_RULE,
            "tolerance": self.tolerance,
            "scales": SCALES,
            "weighed": WEIGHED,
            "repeats": self.repeats,
            "choices": (
                "families, weighing and scales were fixed before the first score of a fit row; the benchmarks were "
                "narrowed to these, and the rows of smaller and of several tolerances added, after scores had been seen"
            ),
            "benchmarks": {name: BENCHMARKS[name].about(self.items(name)) for name in CHOSEN},
        }


def main(repeats: int = 2, seed: int = 0, only: Only = ALL_ROWS) -> None:
    experiment = Experiment(repeats, seed)
    wanted = {
        f"{benchmark} | {name}": partial(experiment.row, benchmark, name) for benchmark in CHOSEN for name in SENTENCES
    }
    Rows("fit_classification", command_of(main, locals()), experiment.about(), seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
