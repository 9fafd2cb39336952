"""Recorded trials as messages: from a store, or from one trial folder in HIRO's layout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro.trial import read_trial
from rcbht_jax.io.messages import Begin, Message, Reset, Sample
from rcbht_jax.io.store import read_recordings
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED

Starts = Literal["harmonised", "recorded", "none"]


def read_store(
    path: Path, trials: tuple[str, ...] = (), arm: str = "R", starts: Starts = "harmonised"
) -> Iterator[Message]:
    """Trials of a store one after the other, each after a reset.

    Args:
        path: store of recordings.
        trials: names; default all.
        arm: "R" or "L".
        starts: sub-tasks begin at the harmonised or the recorded starts, or not at all.

    Raises:
        InputError: ``path`` is not a store, or has no such trial or arm.
    """
    recordings = read_recordings(path)
    unknown = set(trials) - set(recordings.trial.tolist())
    if unknown:
        raise InputError(f"{path} has no trial {', '.join(sorted(unknown))}.")
    chosen = (recordings.arm == arm) & (np.isin(recordings.trial, trials) if trials else True)
    if not chosen.any():
        raise InputError(f"{path} has no recording of arm {arm} among the chosen trials.")
    onsets = recordings.starts(HARMONISED) if starts == "harmonised" else recordings.starts(RECORDED)
    for row in np.flatnonzero(chosen):
        wrench = recordings.wrench[row, : recordings.length[row]].astype(np.float64)
        time = np.arange(len(wrench)) * recordings.dt
        yield Reset()
        yield from _trial(time, wrench, onsets[row], recordings.dt, starts)


def read_folder(path: Path, arm: str = "R", starts: Starts = "harmonised") -> Iterator[Message]:
    """One trial folder in HIRO's layout (``R_Torques.dat`` and so on).

    Raises:
        InputError: the folder holds no readable trial of that arm.
    """
    problems: list[str] = []

    def report(where: Path, text: str) -> None:
        problems.append(f"{where}: {text}")

    records = [record for record in read_trial(path, path.parent.name, report, report) if record.arm == arm]
    if not records:
        raise InputError(problems[0] if problems else f"{path} has no arm {arm}.")
    record = records[0]
    table = record.table
    onset = record.onset_harmonised if starts == "harmonised" else record.onset
    yield from _trial(table.time, table.values.astype(np.float64), onset, float(np.median(np.diff(table.time))), starts)


def _trial(
    time: Float[np.ndarray, " time"],
    wrench: Float[np.ndarray, "time 6"],
    onset: Float[np.ndarray, " state"],
    dt: float,
    starts: Starts,
) -> Iterator[Message]:
    finite = onset[np.isfinite(onset)] if starts != "none" else onset[:0]
    begins = set(np.rint(finite / dt).astype(int).tolist()) - {0}
    for index, (stamp, row) in enumerate(zip(time.tolist(), wrench.tolist(), strict=True)):
        if index in begins:
            yield Begin()
        yield Sample(tuple(row), stamp)
