"""Four states from the words of both arms: the recorded two-arm set, the simulated ones, and transfer between them.

Run: python -m experiments.classification.two_arm_states
Reads the authors' two-arm trials (RCBHT_DATA); simulates mildly randomised trials with the native engine.
"""

from __future__ import annotations

from typing import Any

from experiments._lib import tasks
from experiments._lib.benchmarks import SIM2, published_words, rounded
from experiments._lib.catalogue import DATA
from experiments._lib.intervals import with_width
from experiments._lib.results_io import write_result
from experiments.classification.two_arm import as_recordings, simulated
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.recipes import LEVELS, PLAIN
from rcbht_jax.io.hiro.importer import read_hiro
from rcbht_jax.learning.evaluation import EvaluationProtocol, evaluate
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import TaskSpec
from rcbht_jax.types import Recordings
from sim_mjx.presets import TWO_ARM
from sim_mjx.randomization.trials import DomainRandomization

SEED = 0
TRIALS = 40  # of each preset
COSTS = (0.01, 0.1, 1.0, 10.0, 100.0)
GRID = Grid(kernels=("linear",), costs=COSTS)
RANKS = Grid(kernels=("linear",), costs=COSTS, scalings=(True,), ranks=True)
WORDS = ("sentence", *PLAIN)
KINDS = {
    "words": (FeatureSpec(families=WORDS), GRID),
    "words and duration": (FeatureSpec(families=(*WORDS, "duration")), GRID),
    "richer words and levels": (FeatureSpec(families=LEVELS, balance=True), RANKS),
}


def states(recorded: Recordings, sets: dict[str, Recordings]) -> dict[str, Any]:
    """Accuracy on four states from both arms' grammars; recorded boundaries, SVM, window 5."""
    out: dict[str, Any] = {}
    for name, simulated_set in sets.items():
        both = Recordings.join([recorded, simulated_set])
        tracks = published_words(both)
        forth = {"train_on": (name,), "test_on": ("SIM2",)}
        back = {"train_on": ("SIM2",), "test_on": (name,)}
        ways: dict[str, tuple[TaskSpec, dict[str, Any]]] = {
            "recorded, cross-validated": (tasks.states(arms="both", sessions=("SIM2",)), {}),
            f"{name}, cross-validated": (tasks.states(arms="both", sessions=(name,)), {}),
            f"trained on {name}, tested on recorded": (tasks.states(arms="both"), forth),
            f"trained on recorded, tested on {name}": (tasks.states(arms="both"), back),
        }
        for title, (task, split) in ways.items():
            if title in out:
                continue
            evaluations = {
                kind: evaluate(both, tracks, task, spec, EvaluationProtocol(5, 3, SEED, grid, **split))
                for kind, (spec, grid) in KINDS.items()
            }
            trials = evaluations["words"].trials
            scores = {kind: one.score for kind, one in evaluations.items()}
            scores["duration alone"] = evaluations["words"].duration_baseline
            by = {"interval by": "Wilson, by trial"} if split else {}  # of one split, whose tested trials are fewer
            row = {kind: rounded(with_width(score["accuracy"] | by, trials)) for kind, score in scores.items()}
            out[title] = row | {"trials": trials}
    return out


def main() -> None:
    recorded, _ = read_hiro(DATA / SIM2)
    mild = DomainRandomization(nominal_share=1.0)
    sets = {name: as_recordings(simulated(name, TRIALS, mild)[0], name) for name in TWO_ARM}
    note = (
        "accuracy; W=5, preset thresholds, linear SVM chosen within training folds, recorded boundaries, both arms; "
        "words = sentence, histogram, ngram and attributes; richer words by ranks, levels as heavy as all others; "
        "95 % intervals: corrected over folds, or Wilson's by trial, where these have no width and between sets"
    )
    result = {"measure": note, **states(recorded, sets)}
    write_result("two_arm_states", "python -m experiments.classification.two_arm_states", result, seed=SEED)


if __name__ == "__main__":
    main()
