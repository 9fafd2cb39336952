"""Sub-tasks of recorded streams by the frozen method, trained on simulated trials fitted to no recording.

The trials of ``experiments._lib.zero_shot_set``, tared by their first second as a robot tares before it starts, train
alone, or beside those of one recorded session; the recorded trials that do not train are streamed, with beginnings
given and detected, beside the baselines of ``experiments.online.causal`` on the same trials. The last rows show the
effect of the tare alone. Nothing is chosen here: the method is the frozen one, the simulated trials are the first of
the set.

Run: python -m experiments.online.zero_shot_stream FOLDER
FOLDER keeps the simulated set; it is made if it is missing. Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import tyro

from experiments._lib import frozen
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.zero_shot_set import PRESET, SIMULATED, simulated_and_recorded
from experiments.online import causal
from rcbht_jax.types import Recordings

TRIALS, SEED = 64, 0  # simulated trials, whose snapshots a machine with a radial kernel learns in minutes
SPLITS = {  # what trains, what is streamed
    "simulated to A and B": (SIMULATED, "A+B"),
    "simulated and A to B": (f"{SIMULATED}+A", "B"),
    "simulated and B to A": (f"{SIMULATED}+B", "A"),
    "A alone to B": ("A", "B"),
    "B alone to A": ("B", "A"),
}


def stream_of(method: frozen.FrozenMethod, read: Callable[[], Recordings], split: tuple[str, str]) -> causal.Stream:
    """The trials of a split as one set of streams."""
    data = read()
    wanted, simulated = np.isin(data.session, "+".join(split).split("+")), data.session == SIMULATED
    return causal.Stream(method, data.take(wanted & (~simulated | (np.cumsum(simulated) <= TRIALS))), outcomes=())


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    method = frozen.load()
    about = {
        "what": "states of recorded streams by the frozen method, trained on simulated trials fitted to none of them",
        "preset": PRESET,
        "simulated trials": TRIALS,
        "sha256 of the method": method.sha256,
        "belief of the method": method.streamed["belief"],
    }
    seeds, read = range(SEED, SEED + 1), cache(partial(simulated_and_recorded, folder))
    wanted = {
        name: partial(causal.row, partial(stream_of, method, read, split), split, seeds)
        for name, split in SPLITS.items()
    }
    Rows("zero_shot_stream", "python -m experiments.online.zero_shot_stream FOLDER", about, SEED).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
