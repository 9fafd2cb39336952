"""Recorded trials as messages: from a store, or from one folder of the authors' layout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro.trial import read_trial
from rcbht_jax.io.messages import Begin, Message, Reset, Sample
from rcbht_jax.io.store import read_recordings

Starts = Literal["harmonised", "recorded", "none"]


def read_store(
    path: Path, trials: tuple[str, ...] = (), arm: str = "R", starts: Starts = "harmonised"
) -> Iterator[Message]:
    """Trials of a store one after the other, each begun by a reset; sub-tasks begin where the store says.

    Raises:
        InputError: no such store, or no such trial.
    """
    recordings = read_recordings(path)
    unknown = set(trials) - set(recordings.trial.tolist())
    if unknown:
        raise InputError(f"{path} has no trial {', '.join(sorted(unknown))}.")
    chosen = (recordings.arm == arm) & (np.isin(recordings.trial, trials) if trials else True)
    if not chosen.any():
        raise InputError(f"{path} has no recording of arm {arm} among the trials asked for.")
    onsets = recordings.onset_harmonised if starts == "harmonised" else recordings.onset
    for row in np.flatnonzero(chosen):
        wrench = recordings.wrench[row, : recordings.length[row]].astype(np.float64)
        time = np.arange(len(wrench)) * recordings.dt
        yield Reset()
        yield from _trial(time, wrench, onsets[row], recordings.dt, starts)


def read_folder(path: Path, arm: str = "R", starts: Starts = "harmonised") -> Iterator[Message]:
    """One trial of the authors' layout (``R_Torques.dat`` and so on).

    Raises:
        InputError: the folder holds no readable trial of that arm.
    """
    complaints: list[str] = []

    def complain(where: Path, text: str) -> None:
        complaints.append(f"{where}: {text}")

    records = [record for record in read_trial(path, path.parent.name, complain, complain) if record.arm == arm]
    if not records:
        raise InputError(complaints[0] if complaints else f"{path} has no arm {arm}.")
    record = records[0]
    table = record.table
    onset = record.onset_harmonised if starts == "harmonised" else record.onset
    yield from _trial(table.time, table.values.astype(np.float64), onset, float(np.median(np.diff(table.time))), starts)


def _trial(
    time: NDArray[np.floating], wrench: NDArray[np.floating], onset: NDArray[np.float64], dt: float, starts: Starts
) -> Iterator[Message]:
    known = onset[np.isfinite(onset)] if starts != "none" else onset[:0]
    begins = set(np.rint(known / dt).astype(int).tolist()) - {0}
    for index, (stamp, row) in enumerate(zip(time.tolist(), wrench.tolist(), strict=True)):
        if index in begins:
            yield Begin()
        yield Sample(tuple(row), stamp)
