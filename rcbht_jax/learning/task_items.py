"""Where the items of a task lie: the intervals of a track whose ends are known, or whole recordings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import INTERVALS
from rcbht_jax.annotations import Annotations, nearest_samples
from rcbht_jax.errors import InputError
from rcbht_jax.features import Intervals
from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class Found:
    """Labelled intervals in samples, half-open."""

    rows: NDArray[np.int64]  # [item, arm] recording
    label: NDArray[np.str_]  # [item]
    start: NDArray[np.int64]  # [item, arm]
    end: NDArray[np.int64]  # [item, arm]

    def intervals(self, recordings: Recordings) -> tuple[Intervals, ...]:
        """The intervals of each arm."""
        return tuple(
            Intervals(rows, start, end, recordings.dt, str(recordings.arm[rows[0]]) if len(rows) else "")
            for rows, start, end in zip(self.rows.T, self.start.T, self.end.T, strict=True)
        )


def leave_out(dropped: Counter[str], reason: str, count: int) -> None:
    """Count what is left out, and why: trials, or intervals where the reason says so."""
    if count:
        dropped[reason] += count


def trials_in(recordings: Recordings, chosen: NDArray[np.bool_]) -> int:
    """How many trials the chosen recordings are of."""
    rows = np.flatnonzero(chosen).tolist()
    return len({(recordings.source[row], recordings.trial[row]) for row in rows})


def trial_names(recordings: Recordings, rows: NDArray[np.int64]) -> NDArray[np.str_]:
    """Names of trials ``[row]``; where two sources use one name, with the source before it."""
    source, trial = recordings.source[rows], recordings.trial[rows]
    full = np.char.add(np.char.add(source, "/"), trial)
    return trial if len(np.unique(full)) == len(np.unique(trial)) else full


def leave_out_sources(
    recordings: Recordings, wanted: NDArray[np.bool_], rows: NDArray[np.int64], dropped: Counter[str]
) -> None:
    """Name the sources of which all wanted recordings are left out, though the rows are of others."""
    for source in sorted(set(recordings.source[wanted].tolist()) - set(recordings.source[rows].tolist())):
        leave_out(dropped, f"all of the source {source}", trials_in(recordings, wanted & (recordings.source == source)))


def track_items(
    recordings: Recordings,
    rows: NDArray[np.int64],
    track: str,
    classes: tuple[str, ...],
    complete: bool,
    dropped: Counter[str],
) -> Found:
    """Intervals of a track whose ends are known, in the order of the trials ``[trial, arm]`` and of time."""
    marks = recordings.annotations.of(track)
    labels = np.array(marks.labels[track], np.str_)
    longest = int(recordings.length.max())
    start = nearest_samples(marks.start, longest, recordings.dt)
    end = np.nan_to_num(nearest_samples(marks.end, longest, recordings.dt), nan=-1.0)
    # What lasts beyond the record is cut off at its ends; an unknown end is before every start.
    start, end = np.maximum(start, 0.0), np.minimum(end, recordings.length[marks.recording])
    usable = end > start
    if complete:
        usable &= _complete(marks, usable, len(recordings))[marks.recording]
    if classes:
        usable &= np.isin(labels[marks.code], classes)
    chosen = np.flatnonzero(usable)
    bounds = np.searchsorted(marks.recording[chosen], np.arange(len(recordings) + 1))
    of_trials = [[chosen[bounds[row] : bounds[row + 1]] for row in arms] for arms in rows.tolist()]
    there = [arms for arms in of_trials if all(len(arm) for arm in arms)]
    reason = "a state is missing" if complete else f"no annotation of the track {track}"
    leave_out(dropped, reason, len(of_trials) - len(there))
    same = [arms for arms in there if all(np.array_equal(marks.code[arms[0]], marks.code[arm]) for arm in arms)]
    leave_out(dropped, "its arms are annotated differently", len(there) - len(same))
    items = np.array([item for arms in same for item in zip(*arms, strict=True)], np.int64).reshape(-1, rows.shape[1])
    left = np.isin(marks.recording, rows[:, 0]) & ~usable
    if not complete and not classes and left.any():
        leave_out(dropped, f"{INTERVALS}empty, outside the record or without a known end", int(left.sum()))
    return Found(
        marks.recording[items].astype(np.int64), labels[marks.code[items[:, 0]]],
        start[items].astype(np.int64), end[items].astype(np.int64),
    )  # fmt: skip


def _complete(marks: Annotations, usable: NDArray[np.bool_], recordings: int) -> NDArray[np.bool_]:
    """Recordings ``[recording]`` all of whose labels are there, follow each other and are usable."""
    (names,) = marks.labels.values()
    count = np.bincount(marks.recording[usable], minlength=recordings)
    ordered = (np.diff(marks.starts(next(iter(marks.labels)), recordings), axis=1) > 0).all(1)
    return np.asarray((count == len(names)) & ordered)


def whole_items(
    recordings: Recordings, rows: NDArray[np.int64], values: NDArray[np.str_], seconds: float, dropped: Counter[str]
) -> Found:
    """Whole records ``[trial, arm]``, or the same number of seconds of each; 0 = to their ends.

    Raises:
        InputError: the seconds are less than a sample.
    """
    end = recordings.length[rows].astype(np.int64)
    if seconds:
        samples = round(seconds / recordings.dt) if 0 < seconds < np.inf else 0
        if samples < 1:
            raise InputError(f"the first {seconds:g} s of each recording were asked for; expected a sample or more.")
        long = (end >= samples).all(1)
        leave_out(dropped, f"shorter than {seconds:g} s", int((~long).sum()))
        rows, values, end = rows[long], values[long], np.full_like(end[long], samples)
    return Found(rows, values, np.zeros_like(rows), end)
