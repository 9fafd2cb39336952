"""Early classification of robot execution failures: accuracy after the first samples, and rules of when to stop.

The one method is trained on the first 2 to 15 samples. Rules decide when its belief is acted on: the package's level of
certainty; ECONOMY-gamma and CALIMERA, whose weight of an error (and number of groups) is the one with the largest
harmonic mean on the training rows, by beliefs of classifiers not trained on them. TEASER is that of the library aeon,
on forests of statistics, with its own choice of the number of consecutive safe beliefs. Folds are those of
experiments.external.failures.

Run: python -m experiments.external.early --repeats 2 --seed 0
Reads RCBHT_EXTERNAL; the row of TEASER needs the library aeon (see make peers).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import StratifiedKFold

from experiments._lib import early
from experiments._lib.arrays import Ints
from experiments._lib.benchmarks import FOLDS, rounded, segments
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import of_splits
from experiments.external import failures, method
from rcbht_jax.learning import metrics

PREFIXES = (2, 3, 4, 5, 6, 8, 10, 12, 15)  # samples
LENGTH = PREFIXES[-1]
INNER_FOLDS = 3  # for beliefs about training rows
WEIGHTS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)  # of an error against a delay
GROUPS = (1, 2, 3, 5)
TREES = 50  # of TEASER's forests on statistics of the prefix
CERTAIN = metrics.CERTAINTY_LEVELS[0]
MEASURES = ("accuracy", "earliness", "harmonic_mean")

Rule = Callable[["Fold"], early.Rule]


class Fold:
    """Beliefs ``[prefix, row, class]`` about the test rows, and about training rows that were held out."""

    def __init__(self, experiment: Experiment, name: str, train: Ints, test: Ints, seed: int) -> None:
        y = experiment.source.data(name)[1].y
        self.train, self.test, self.seed = train, test, seed
        self.y_train, self.y_test = y[train], y[test]
        self.delay = np.array(PREFIXES) / LENGTH
        inner = failures.folds_of(StratifiedKFold(INNER_FOLDS, shuffle=True, random_state=seed), y[train])
        seen, held_out = [], np.zeros((len(PREFIXES), len(train), int(y.max()) + 1))
        for at, samples in enumerate(PREFIXES):
            believe = partial(experiment.believe, name, samples)
            seen.append(believe(train, test, seed))
            for a, b in inner:
                held_out[at, b] = believe(train[a], train[b], seed)
        self.seen, self.held_out = np.stack(seen), held_out


class Experiment:
    """The sets, and the beliefs about them, made once."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed
        self.source = failures.Experiment(repeats, seed)

    def believe(self, name: str, samples: int, train: Ints, test: Ints, seed: int) -> NDArray[np.float64]:
        """Probabilities of the one method after ``samples`` samples."""
        y = self.source.data(name)[1].y
        return method.believe(**self.source.described(name, samples), y=y, train=train, test=test, seed=seed)

    def splits(self, name: str) -> Iterator[tuple[Ints, Ints, int]]:
        """Training and test rows of every fold, and its seed, as in experiments.external.failures."""
        y = self.source.data(name)[1].y
        for repeat, folds in enumerate(failures.repeated_folds(y, self.repeats, self.seed)):
            for number, (train, test) in enumerate(folds):
                yield train, test, 1000 * (self.seed + repeat) + number

    @cache  # noqa: B019 (one object lives as long as the program)
    def folds(self, name: str) -> list[Fold]:
        return [Fold(self, name, *split) for split in self.splits(name)]

    def summary(self, name: str, scores: list[dict[str, float]]) -> dict[str, Any]:
        """Means with corrected intervals over folds."""
        records, out = len(self.source.data(name)[1].y), {}
        for measure in scores[0]:
            values = [score[measure] for score in scores]
            trials = 0 if measure == "earliness" else records  # a rule may judge all records after the same time
            out[measure] = of_splits(values, 1 / (FOLDS - 1), trials, records if measure == "accuracy" else 0)
        return rounded(out) | {"repeats": self.repeats}

    def prefix(self, name: str, at: int) -> dict[str, Any]:
        right = [(fold.seen[at].argmax(1) == fold.y_test).mean() for fold in self.folds(name)]
        return self.summary(name, [{"accuracy": float(score)} for score in right])

    def rule(self, name: str, make: Rule) -> dict[str, Any]:
        found = []
        for fold in self.folds(name):
            at = make(fold)(fold.seen)
            found.append(dict(zip(MEASURES, early.worth(fold.seen, fold.y_test, fold.delay, at), strict=True)))
        return self.summary(name, found)

    def teaser(self, name: str) -> dict[str, Any]:
        from aeon.classification.early_classification import TEASER
        from aeon.classification.feature_based import SummaryClassifier

        recordings, items = self.source.data(name)
        x = np.stack([part.T for part in segments(recordings, items)]).astype(np.float64)
        found = []
        for train, test, seed in self.splits(name):
            forest = SummaryClassifier(estimator=ExtraTreesClassifier(TREES), random_state=seed)
            points = [samples for samples in PREFIXES if samples > 2]  # three samples are its fewest
            teaser = TEASER(forest, classification_points=points, random_state=seed).fit(x[train], items.y[train])
            _, accuracy, earliness = teaser.score(x[test], items.y[test])
            mean = early.harmonic_mean(accuracy, earliness)
            found.append(dict(zip(MEASURES, (float(accuracy), float(earliness), mean), strict=True)))
        return self.summary(name, found)


def economy(fold: Fold) -> early.Rule:
    """ECONOMY with the weight and the number of groups that are best on the training rows."""
    return _best(fold, {
        (weight, groups): early.economy(fold.held_out, fold.y_train, fold.delay, weight, groups)
        for weight, groups in product(WEIGHTS, GROUPS)
    })  # fmt: skip


def calimera(fold: Fold) -> early.Rule:
    """CALIMERA with the weight that is best on the training rows."""
    return _best(fold, {weight: early.calimera(fold.held_out, fold.delay, weight) for weight in WEIGHTS})


def _best(fold: Fold, rules: dict[Any, early.Rule]) -> early.Rule:
    """The first of those with the largest harmonic mean."""
    return max(
        rules.values(),
        key=lambda rule: early.worth(fold.held_out, fold.y_train, fold.delay, rule(fold.held_out))[2],
    )


RULES: dict[str, Rule] = {
    "always the first two samples": lambda fold: early.certain(0.0),
    f"certain ({CERTAIN:g})": lambda fold: early.certain(CERTAIN),
    "ECONOMY": economy,
    "CALIMERA": calimera,
}


def main(repeats: int = 2, seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Score every prefix and every rule on every set of the folder."""
    experiment = Experiment(repeats, seed)
    about = {
        "folds": FOLDS, "repeats": repeats, "method": method.ABOUT, "prefixes": list(PREFIXES),
        "weights": list(WEIGHTS), "groups": list(GROUPS), "trees of TEASER": TREES,
        "note on TEASER": "aeon 1.6.0 learns what a safe belief is, at every prefix, from beliefs about whole series",
    }  # fmt: skip
    rows = Rows("external_early", command_of(main, locals()), about, seed)
    wanted: dict[str, Callable[[], Any]] = {}
    for name in failures.sets():
        for at, samples in enumerate(PREFIXES):
            wanted[f"{name} | first {samples} samples"] = partial(experiment.prefix, name, at)
        for title, make in RULES.items():
            wanted[f"{name} | {title}"] = partial(experiment.rule, name, make)
    wanted |= {f"{name} | TEASER": partial(experiment.teaser, name) for name in failures.sets()}
    rows.fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
