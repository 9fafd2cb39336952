"""Robot execution failures (UCI; Seabra Lopes and Camarinha-Matos 1999): the one method, its parts, and peers.

Series of 15 samples from the detection of a failure; stratified folds, repeated. Copies in the data are kept, as other
publications have them: LP2 and LP4 hold one pair each. Every set that lies in the folder is scored.

Run: python -m experiments.external.failures --repeats 4 --seed 0
Reads RCBHT_EXTERNAL; the rows of MiniRocket, MultiRocketHydra and QUANT need the library aeon (see make peers).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import tyro
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.naive_bayes import GaussianNB

from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import FOLDS, rounded, segments
from experiments._lib.catalogue import EXTERNAL
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import of_folds
from experiments._lib.other_robots import of_other_robot
from experiments.external import method
from rcbht_jax.errors import InputError
from rcbht_jax.features.recipes import LEVELS
from rcbht_jax.learning import validation
from rcbht_jax.learning.svm import Split, grouped_folds
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

FOLDER = "robot_execution_failures"
MEMBERS = {"words": method.svm, "wrench": method.trees}


def sets() -> tuple[str, ...]:
    """The sets in the folder of recordings: lp1, lp2, ..."""
    found = tuple(sorted(path.stem for path in (EXTERNAL / FOLDER).glob("*.csv")))
    if not found:
        raise InputError(f"{EXTERNAL / FOLDER} holds no set such as lp1.csv.")
    return found


def folds_of(splitter: Any, y: method.Rows) -> list[Split]:
    """Training and test rows of each fold; a class with fewer items than folds is not tested in some of them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of classes with few items, and of groups that are not used
        return grouped_folds(y, np.arange(len(y)), splitter, 0)


def repeated_folds(y: method.Rows, repeats: int, seed: int) -> list[list[Split]]:
    """Stratified folds ``[repeat][fold]``."""
    seeds = validation.repeat_seeds(seed, repeats)
    return [folds_of(StratifiedGroupKFold(FOLDS, shuffle=True, random_state=one), y) for one in seeds]


Make = Callable[[str], validation.Estimator]


class Experiment:
    """The data sets, read once, and the functions that make each row."""

    def __init__(self, repeats: int, seed: int) -> None:
        self.repeats, self.seed = repeats, seed

    @cache  # noqa: B019 (one object lives as long as the program)
    def data(self, name: str, samples: int = 15) -> tuple[Recordings, LabelledIntervals]:
        """A set, or the first samples of its series."""
        recordings = of_other_robot(f"{FOLDER}/{name}.csv", "robot_execution_failures", keep_copies=True)
        cut = np.minimum(recordings.length, samples)
        recordings = replace(recordings, wrench=recordings.wrench[:, :samples], length=cut)
        return recordings, labelled_intervals(recordings, TaskSpec("class", outcomes=()))

    @cache  # noqa: B019
    def described(self, name: str, samples: int = 15) -> dict[str, Any]:
        return dict(zip(MEMBERS, method.describe(*self.data(name, samples)), strict=True))

    def three(self, name: str) -> validation.Estimator:
        """The combination that is best on HIRO where the SVMs have this package's probabilities."""
        recordings, items = self.data(name)
        words, wrench = method.describe(recordings, items, (*LEVELS, "edges"))
        return method.summed([(method.svm, words), (method.svm, wrench), (method.trees, wrench)], items.y)

    def summed(self, members: Iterable[str], name: str) -> validation.Estimator:
        x = self.described(name)
        return method.summed([(MEMBERS[member], x[member]) for member in members], self.data(name)[1].y)

    def of_training(self, members: Iterable[str], name: str) -> validation.Estimator:
        """Members whose words have thresholds from the training rows alone."""
        recordings, items = self.data(name)

        def predict(train: Any, test: Any, seed: int) -> Any:
            rest = recordings.take(items.intervals[0].recording[train])
            x = self.described(name) | {"words": method.describe_words(recordings, items, rest)}
            return method.summed([(MEMBERS[member], x[member]) for member in members], items.y)(train, test, seed)

        return predict

    def tuned(self, name: str) -> validation.Estimator:
        """The vote or one of its members, by three folds of the training rows."""
        y = self.data(name)[1].y
        ways = [self.summed(members, name) for members in (["words"], ["wrench"], MEMBERS)]

        def predict(train: Any, test: Any, seed: int) -> Any:
            folds = folds_of(StratifiedKFold(3, shuffle=True, random_state=seed), y[train])
            right = [sum((way(train[a], train[b], seed)[0] == y[train[b]]).sum() for a, b in folds) for way in ways]
            return ways[int(np.argmax(right))](train, test, seed)

        return predict

    def peer(self, kind: str, name: str) -> validation.Estimator:
        """A classifier of aeon on the series themselves."""
        recordings, items = self.data(name)
        x = np.stack([part.T for part in segments(recordings, items)])
        return raw.of_aeon(kind, x, items.y)

    def makers(self) -> dict[str, Make]:
        return {
            "words + wrench": partial(self.summed, MEMBERS),
            "words: SVM": partial(self.summed, ["words"]),
            "wrench: trees": partial(self.summed, ["wrench"]),
            "words + wrench, thresholds of the training rows": partial(self.of_training, MEMBERS),
            "words: SVM, thresholds of the training rows": partial(self.of_training, ["words"]),
            "richer words: SVM + wrench: SVM and trees": self.three,
            "tuned in the folds": self.tuned,
            "naive Bayes on the values": self.naive_bayes,
            "majority": lambda name: validation.majority(self.data(name)[1].y),
            "MiniRocket": partial(self.peer, "MiniRocketClassifier"),
            "MultiRocketHydra": partial(self.peer, "MultiRocketHydraClassifier"),
            "QUANT": partial(self.peer, "QUANTClassifier"),
        }

    def naive_bayes(self, name: str) -> validation.Estimator:
        recordings, items = self.data(name)
        x = np.stack([part.ravel() for part in segments(recordings, items)])
        return raw.estimator(x, items.y, lambda seed: GaussianNB())

    def row(self, name: str, title: str) -> Any:
        y = self.data(name)[1].y
        splits = repeated_folds(y, self.repeats, self.seed)
        made = validation.cross_validate(self.makers()[title](name), y, splits, self.seed)
        scores = of_folds(made, len(y))
        return rounded(validation.without_intervals(scores) if title == "majority" else scores) | {
            "repeats": self.repeats
        }


def main(repeats: int = 4, seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Score the method, its members and peers on every set of the folder."""
    experiment = Experiment(repeats, seed)
    about = {"folds": FOLDS, "repeats": repeats, "method": method.ABOUT}
    wanted = {
        f"{name} | {title}": partial(experiment.row, name, title) for title in experiment.makers() for name in sets()
    }
    Rows("external_failures", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
