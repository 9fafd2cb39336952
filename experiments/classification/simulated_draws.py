"""How much scores from simulation to the robot depend on which trials were simulated: the same sets, drawn again.

The intervals of ``experiments.classification.zero_shot`` and ``experiments.classification.sim_to_real_fit`` are by
recorded trial: they hold for one simulated set. Here each row has another seed of the simulation, and nothing else is
different. The first draw has the seed of those experiments; contacts are chaotic, so that on a processor of another
kind it has other trials.

Run: python -m experiments.classification.simulated_draws FOLDER
FOLDER keeps the simulated sets; missing ones are made. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import tyro

from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.zero_shot_set import SEED as ZERO_SHOT_SEED
from experiments.classification import sim_to_real, zero_shot
from experiments.classification.sim_to_real_fit import FIT
from experiments.classification.sim_to_real_sets import SEED as SETS_SEED

DRAWS = 5
WORDS = ("paper", "fit", "fit, three tolerances")  # rows of sim_to_real_fit
BOTH = "+".join(sim_to_real.REAL)


def folder_of(folder: Path, draw: int) -> Path:
    """Where the sets of a draw are: those of the first are the sets of the other experiments."""
    return folder / f"draw-{draw}" if draw else folder


def zero_shot_scores(folder: Path, draw: int) -> dict[str, Any]:
    """Accuracy of the frozen method on recorded trials, by number of states."""
    experiment = zero_shot.Experiment(folder_of(folder, draw), ZERO_SHOT_SEED + draw)
    kinds = zero_shot.BOUNDARIES.items()
    return {states: experiment.row(kind, "frozen")[BOTH]["mean"] for kind, states in kinds}


def words_scores(folder: Path, name: str, draw: int) -> dict[str, Any]:
    """The same of words alone, learned from presets C and OpenHRP."""
    experiment = sim_to_real.Experiment(folder_of(folder, draw), SETS_SEED + draw)
    kinds = zero_shot.BOUNDARIES.items()
    return {states: experiment.measure(FIT[name], kind)[BOTH]["accuracy"] for kind, states in kinds}


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    about = {
        "what": "accuracy on recorded trials of A and B together, of learners that saw one draw of simulated trials",
        "seeds": {"zero shot": ZERO_SHOT_SEED, "words": SETS_SEED, "of further draws": "the next numbers"},
    }
    rows = Rows("simulated_draws", "python -m experiments.classification.simulated_draws FOLDER", about, ZERO_SHOT_SEED)
    wanted = {
        f"{name} | draw {draw}": partial(zero_shot_scores, folder, draw)
        if name == "zero shot"
        else partial(words_scores, folder, name, draw)
        for draw in range(DRAWS)
        for name in ("zero shot", *WORDS)
    }
    rows.fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
