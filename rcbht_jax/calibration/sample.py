"""Recordings to calibrate on: all of a store, or of a large one some trials spread evenly over those of a task."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import data_hash
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import count_recordings, longest_of, read_batches, read_recordings, read_rows, read_table
from rcbht_jax.learning.tasks import TaskSpec, chosen_recordings
from rcbht_jax.types import Recordings

SAMPLE_BYTES = 2**27  # of padded wrenches; calibrating on them takes ten times as much


@dataclass(frozen=True)
class Sample:
    """The recordings of a store that a calibration uses.

    Attributes:
        recordings: all of the store, or of a large one those of some trials.
        trials: how many trials the store has for the task; None = all of them are here.
        data_hash: of the whole store.
    """

    recordings: Recordings
    trials: int | None
    data_hash: str


def read_sample(path: Path, spec: TaskSpec) -> Sample:
    """Read all of a store, or of one larger than ``SAMPLE_BYTES`` as many whole trials of a task as fit.

    Raises:
        InputError: ``path`` is not a store or is damaged, or no recording passes the filters.
    """
    longest = longest_of(path)
    table = read_table(path)
    row = 4 * len(table.axes) * longest
    if count_recordings(path) * row <= SAMPLE_BYTES:
        recordings = read_recordings(path)
        return Sample(recordings, None, data_hash(recordings))
    chosen = np.flatnonzero(chosen_recordings(table, spec))
    if not len(chosen):
        raise InputError(
            f"No recording of {path} has the chosen source, session and outcome; choose others, or leave a filter out."
        )
    trial = _trials(table, chosen)
    arms = int(np.bincount(trial).max())
    room = max(1, SAMPLE_BYTES // (row * arms))
    kept = np.unique(np.linspace(0, trial.max(), min(room, trial.max() + 1)).round().astype(np.int64))
    digest = data_hash(table, (batch.wrench for batch in read_batches(path)), longest)
    trials = int(trial.max()) + 1
    return Sample(read_rows(path, chosen[np.isin(trial, kept)]), None if len(kept) == trials else trials, digest)


def _trials(table: Recordings, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the trial of each row, in the order of the store; arms of a trial share it."""
    numbers: dict[tuple[str, str], int] = {}
    pairs = zip(table.source[rows].tolist(), table.trial[rows].tolist(), strict=True)
    return np.array([numbers.setdefault(pair, len(numbers)) for pair in pairs], np.int64)
