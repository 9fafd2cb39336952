"""Table I of the paper on our own labels: offline and online, on the authors' trials and on simulated ones.

Three scores per row and kind of labels: the paper's features (label sentences resampled to the longest of the set) with
the paper's protocol (rows shuffled freely, polynomial SVM, C = 1, gamma = 1 / features); the same features with trials
kept together and kernel and cost of the paper's grid selected inside the training folds; our words (histogram, n-grams,
attributes; neither duration nor absolute offset) selected in the same way; and duration alone on the same folds.
Success/failure is balanced: every repeat draws as many trials of the larger class as the smaller one has. Failures of
session C and successes of A and B are different sessions: see benchmarks.CONFOUNDS.

States use the recorded onsets, as the paper does, and for the real trials the harmonised ones as well. Offline labels
are those of the authors' taxonomy (rcbht_jax.reference), which uses the recorded onsets; online labels are those of the
streaming encoder (window 5), which does not.

Run: python -m experiments.classification.table1_ours FOLDER --repeats 10 --seed 0
FOLDER holds the simulated sets; missing ones are made.
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib import tasks
from experiments._lib.benchmarks import (
    FAILURES,
    FOLDS,
    REAL,
    REAL_FAILURES,
    SIM1,
    SIM2,
    of_sources,
    published_words,
    recorded,
    rounded,
)
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import of_splits
from experiments._lib.simulated import simulated
from experiments.classification.table1_published import FIXED, NESTED
from rcbht_jax.features import FeatureSpec, longest
from rcbht_jax.learning import validation
from rcbht_jax.learning.metrics import equal_items
from rcbht_jax.learning.svm import Grid, grouped_folds
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, extract_features, labelled_intervals
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis.plan import SynthesisConfig

SIMULATED = {"simulated B": "hooked-B", "simulated A": "hooked-A", "simulated two-arm": "two"}  # set -> preset
TRIALS, SHARE = 200, 0.5  # of each preset; without a fault
OUTCOME = TaskSpec("outcome", outcomes=())
WORDS = Grid(kernels=("linear", "rbf"), costs=(0.01, 0.1, 1.0, 10.0, 100.0), scalings=(True,))
LABELS = ("offline", "online")

Learn = Callable[[NDArray[np.int64]], validation.Estimator]  # from the rows of a repeat


@dataclass(frozen=True)
class Row:
    """The classes, the set, and the scores of the paper (min, mean, max)."""

    sources: tuple[str, ...]  # data sets of the authors, or one of SIMULATED
    task: TaskSpec
    paper: tuple[float, float, float] | None = None


def states(boundaries: str = "recorded", arms: str = "R") -> TaskSpec:
    return tasks.states(boundaries=boundaries, arms=arms)


ROWS = {
    "REAL success/failure": Row((REAL, REAL_FAILURES), OUTCOME, (0.83, 0.97, 1.0)),
    "SIM one-arm success/failure": Row((SIM1, FAILURES), OUTCOME, (1.0, 1.0, 1.0)),
    "REAL states": Row((REAL,), states(), (0.93, 0.97, 1.0)),
    "REAL states, harmonised marks": Row((REAL,), states("harmonised")),
    "SIM one-arm states": Row((SIM1,), states(), (0.84, 0.89, 0.94)),
    "SIM two-arm states": Row((SIM2,), states(arms="both"), (1.0, 1.0, 1.0)),
    **{f"{name} success/failure": Row((name,), OUTCOME) for name in SIMULATED},
    **{f"{name} states": Row((name,), states(arms="both" if "two" in name else "R")) for name in SIMULATED},
}


class Data:
    """Trials, labels and sentences, each made once and only when a row needs it."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed

    @cache  # noqa: B019 (one object lives as long as the program)
    def authors(self) -> Recordings:
        return recorded()

    @cache  # noqa: B019
    def recordings(self, sources: tuple[str, ...]) -> Recordings:
        if sources[0] not in SIMULATED:
            return of_sources(self.authors(), sources)
        preset, spec = SIMULATED[sources[0]], DomainRandomization(nominal_share=SHARE)
        job = SynthesisConfig(preset, TRIALS, self.seed, shard=64, spec=spec)
        return simulated(self.folder / f"table1-{preset}.zarr", job)

    @cache  # noqa: B019
    def tracks(self, sources: tuple[str, ...], labels: str) -> LabelTracks:
        trials = self.recordings(sources)
        return encode_dataset(trials) if labels == "offline" else published_words(trials)


def papers_features(tracks: LabelTracks, items: LabelledIntervals) -> NDArray[np.float32]:
    """The label codes of every axis and layer, resampled to the longest sentence of the set."""
    slots = np.max([longest(tracks, arm) for arm in items.intervals], axis=0)
    return extract_features(tracks, items, FeatureSpec(families=("sentence",), slots=tuple(slots.tolist()))).values


def drawn(items: LabelledIntervals, balanced: bool, seed: int) -> NDArray[np.int64]:
    """Rows of a repeat: all, or equally many of each class."""
    if not balanced:
        return np.arange(len(items.y))
    fewest = int(np.bincount(items.y).min())
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [rng.choice(np.flatnonzero(items.y == c), fewest, replace=False) for c in range(len(items.classes))]
    )


def independent(items: LabelledIntervals, balanced: bool, repeats: int, seed: int) -> float:
    """Number of items of classes of equal size that say as much as those of all repeats do."""
    rows = np.unique([drawn(items, balanced, one) for one in validation.repeat_seeds(seed, repeats)])
    return equal_items(np.bincount(items.y[rows])) if balanced else float(len(rows))


def score(
    items: LabelledIntervals, learn: Learn, balanced: bool, grouped: bool, repeats: int, seed: int
) -> dict[str, Any]:
    """Repeated folds, each repeat on its own rows."""
    runs = []
    for one in validation.repeat_seeds(seed, repeats):
        rows = drawn(items, balanced, one)
        y, trial = items.y[rows], items.trial[rows] if grouped else np.arange(len(rows))
        runs.append(validation.cross_validate(learn(rows), y, [grouped_folds(y, trial, FOLDS, one)], one).accuracy)
    scores = np.concatenate(runs)
    trials, count = len(np.unique(items.trial)), independent(items, balanced, repeats, seed)
    accuracy = of_splits(scores, 1 / (FOLDS - 1), trials, count)
    folds = [float(f(scores, axis=1).mean()) for f in (np.min, np.mean, np.max)]
    return {"accuracy": accuracy, "fold_min_mean_max": folds}


def measure(data: Data, row: Row, labels: str, repeats: int, seed: int) -> dict[str, Any]:
    """The scores of one row for one kind of labels."""
    items = labelled_intervals(data.recordings(row.sources), row.task)
    tracks = data.tracks(row.sources, labels)
    codes, words = papers_features(tracks, items), extract_features(tracks, items, FeatureSpec()).values
    balanced = row.task.task == "outcome"

    def svm(x: NDArray[np.float32], grid: Grid) -> Learn:
        return lambda rows: validation.nested_svm({"": x[rows]}, items.y[rows], items.trial[rows], grid)

    cells: dict[str, tuple[Learn, bool]] = {
        "paper's features, paper's protocol": (svm(codes, FIXED), False),
        "paper's features, nested, grouped": (svm(codes, NESTED), True),
        "words, nested, grouped": (svm(words, WORDS), True),
        "duration alone": (lambda rows: validation.forest(items.seconds[rows], items.y[rows]), True),
    }
    scores = {cell: score(items, learn, balanced, grouped, repeats, seed) for cell, (learn, grouped) in cells.items()}
    counts = dict(zip(items.classes, np.bincount(items.y).tolist(), strict=True))
    about = {"items": counts, "left out": items.dropped, "columns of the paper's features": codes.shape[1]}
    return {"paper": row.paper, **about, **rounded(scores)}


def main(folder: tyro.conf.Positional[Path], repeats: int = 10, seed: int = 0, only: Only = ALL_ROWS) -> None:
    about = {
        "what": "Table I on our labels; see the module's text for the protocols",
        "repeats": repeats,
        "folds": FOLDS,
        "simulated": {"presets": SIMULATED, "trials": TRIALS, "share without a fault": SHARE},
        "labels": {"offline": "authors' taxonomy", "online": "streaming encoder, window 5, preset thresholds"},
    }
    data = Data(folder, seed)
    wanted = {
        f"{name} | {labels}": partial(measure, data, row, labels, repeats, seed)
        for name, row in ROWS.items()
        for labels in LABELS
    }
    Rows("table1_ours", command_of(main, locals(), "FOLDER"), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
