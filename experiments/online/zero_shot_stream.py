"""Sub-tasks of recorded streams by the frozen method, learned from simulated trials that no recording shaped.

The trials of ``experiments.classification.zero_shot``, tared by their first second as a robot tares before it starts,
train alone, or beside those of one recorded session; the recorded trials that do not train are streamed, with
beginnings given and detected, beside the baselines of ``experiments.online.causal`` on the same trials. Nothing is
chosen here: the method is the frozen one, the simulated trials are the first of the set.

Run: python -m experiments.online.zero_shot_stream FOLDER
FOLDER keeps the simulated set; it is made if it is missing. Finished rows are stored; the same command resumes an
interrupted run. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import tyro

from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments.classification.zero_shot import PRESET, Experiment
from experiments.online import causal

SIMULATED = "simulated"  # as the set of zero_shot names their session
TRIALS, SEED = 64, 0  # simulated trials, whose snapshots a machine with a radial kernel learns in minutes
SPLITS = {
    "simulated to A and B": (SIMULATED, "A+B"),
    "simulated and A to B": (f"{SIMULATED}+A", "B"),
    "simulated and B to A": (f"{SIMULATED}+B", "A"),
}


def stream_of(experiment: Experiment) -> causal.Stream:
    """Simulated and recorded trials as one set of streams."""
    data = experiment.recordings()
    simulated = np.cumsum(data.session == SIMULATED) <= TRIALS
    return causal.Stream(experiment.method, data.take(simulated | (data.session != SIMULATED)), outcomes=())


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    experiment = Experiment(folder)
    stream = cache(partial(stream_of, experiment))
    about = {
        "what": "states of recorded streams by the frozen method, trained on simulated trials fitted to none of them",
        "preset": PRESET,
        "simulated trials": TRIALS,
        "sha256 of the method": experiment.method.sha256,
        "belief of the method": experiment.method.streamed["belief"],
    }
    wanted = {name: partial(causal.row, stream, sessions, range(SEED, SEED + 1)) for name, sessions in SPLITS.items()}
    Rows("zero_shot_stream", "python -m experiments.online.zero_shot_stream FOLDER", about, SEED).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
