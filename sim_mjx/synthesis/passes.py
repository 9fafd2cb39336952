"""When tabs pass their lips in simulated trials: the ground truth of snaps, as a track of annotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int, Int32

from rcbht_jax.annotations import Annotations
from sim_mjx.assembly.task import CONTROL_PERIOD

TRACK = "passing"  # of annotations


def passes_of(
    past: Bool[np.ndarray, "trial time tab"], length: Int[np.ndarray, " trial"]
) -> Int32[np.ndarray, "trial pass 3"]:
    """The passes of trials in order of time: tab, first sample beneath its lip, first sample out again.

    A tab that is pulled out may pass again; where it stays in, the trial's length takes the place of the first sample
    out. A tab that is in from the start has not passed. Zeros fill the rows of trials with fewer passes than others.

    Args:
        past: which tabs are past their lips, ``Rollouts.past``.
        length: samples of each trial.

    Example:
        >>> past = np.array([[[0, 0], [0, 1], [1, 1], [0, 1], [1, 1]]], bool)
        >>> passes_of(past, np.array([5])).tolist()
        [[[1, 1, 5], [0, 2, 3], [0, 4, 5]]]
    """
    trials, samples = np.nonzero(past[:, 1:] != past[:, :-1])[:2]
    found: list[list[tuple[int, int, int]]] = [[] for _ in past]
    for trial in np.unique(trials).tolist():
        changes = np.unique(samples[trials == trial]) + 1
        edges = [0, *changes[changes < length[trial]].tolist(), int(length[trial])]
        states = past[trial, edges[:-1]]  # from each edge to the next
        for at, tab in np.argwhere(states[1:] & ~states[:-1]).tolist():
            out = np.flatnonzero(~states[at + 1 :, tab])
            end = edges[at + 1 + int(out[0])] if len(out) else edges[-1]
            found[trial].append((tab, edges[at + 1], end))
    table = np.zeros((len(past), max(map(len, found), default=0), 3), np.int32)
    for row, passes in zip(table, found, strict=True):
        row[: len(passes)] = np.array(passes, np.int32).reshape(-1, 3)
    return table


def as_track(passes: Int[np.ndarray, "recording pass 3"], tabs: Sequence[str]) -> Annotations:
    """The passes as a track: of each tab, from its pass to when it comes out or the trial ends.

    Args:
        passes: of :func:`passes_of`.
        tabs: their names.

    Example:
        >>> as_track(np.array([[[1, 200, 300], [0, 0, 0]]]), ("front", "rear")).names().tolist()
        ['rear']
    """
    recording, place = np.nonzero(passes[..., 2])
    tab, start, end = passes[recording, place].T
    return Annotations(
        recording.astype(np.int32), np.zeros(len(tab), np.int16), tab.astype(np.int32), start * CONTROL_PERIOD,
        end * CONTROL_PERIOD, {TRACK: tuple(tabs)},
    )  # fmt: skip
