"""Recorded trials as messages: from a store, or from one trial folder in HIRO's layout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rcbht_jax._util.arms import chosen_arm, title_of
from rcbht_jax.annotations import Annotations, corrected_variant
from rcbht_jax.errors import InputError
from rcbht_jax.io.hiro.trial import read_trial
from rcbht_jax.io.messages import Begin, Message, Reset, Sample
from rcbht_jax.robots.snap_assembly import state_tracks
from rcbht_jax.types import Recordings

NONE, RECORDED, USUAL = "none", "recorded", "harmonised"


def play(
    recordings: Recordings,
    trials: tuple[str, ...] = (),
    arm: str = "",
    starts: str = USUAL,
    name: str = "the data set",
    learnt: str = "",
) -> Iterator[Message]:
    """Trials of a data set one after the other, each after a reset.

    Args:
        recordings: the data set.
        trials: names; default all.
        arm: for example "left"; "" = the last by name, as the right one.
        starts: a sub-task begins with each interval of a track of annotations, see :func:`track_of_starts`; "none" =
            never.
        name: of the data set, for errors.
        learnt: track whose sub-tasks a model has learned.

    Raises:
        InputError: the data set has no such trial or arm, or no recording of this arm of one of the trials.
    """
    unknown = set(trials) - set(recordings.trial.tolist())
    if unknown:
        raise InputError(f"{name} has no trial {', '.join(sorted(unknown))}.")
    arm = chosen_arm(recordings.arm.tolist(), arm)
    chosen = (recordings.arm == arm) & (np.isin(recordings.trial, trials) if trials else True)
    if missing := set(trials) - set(recordings.trial[chosen].tolist()):
        raise InputError(f"{name} has no recording of {title_of(arm)} of the trial {', '.join(sorted(missing))}.")
    track = "" if starts == NONE else track_of_starts(recordings.annotations, starts, learnt)
    for row in np.flatnonzero(chosen).tolist():
        wrench = recordings.wrench[row, : recordings.length[row]].astype(np.float64)
        time = np.arange(len(wrench)) * recordings.dt
        yield Reset(str(recordings.trial[row]))
        begins = recordings.annotations.begins(row, len(wrench), recordings.dt, track) if track else {}
        yield from _trial(time, wrench, begins)


def track_of_starts(annotations: Annotations, starts: str = USUAL, learnt: str = "") -> str:
    """The track whose intervals begin the sub-tasks; "" = there is none.

    Args:
        annotations: of the data set.
        starts: a track; "recorded" = the learnt one, or the first if that is not there; "harmonised" = the corrected
            variant of this, where there is one.
        learnt: track whose sub-tasks a model has learned; "" = none.

    Raises:
        InputError: there is no such track.

    Example:
        >>> marks = Annotations.from_rows([(0, "tool", "light", 0.0, 1.0), (0, "phase", "push", 0.5, 1.0)])
        >>> track_of_starts(marks), track_of_starts(marks, learnt="phase"), track_of_starts(marks, "tool", "phase")
        ('tool', 'phase', 'tool')
    """
    if starts not in (USUAL, RECORDED):
        return annotations.choose(starts)
    wanted = (learnt, corrected_variant(learnt), *annotations.labels)
    track = next((name for name in wanted if name in annotations.labels), "")
    variant = corrected_variant(track)
    return variant if starts == USUAL and variant in annotations.labels else track


def read_folder(path: Path, arm: str = "", starts: str = USUAL, learnt: str = "") -> Iterator[Message]:
    """One trial folder in HIRO's layout (``R_Torques.dat`` and so on); ``starts`` and ``learnt`` as of :func:`play`.

    Raises:
        InputError: the folder holds no readable trial of that arm, or its import would have no such track.
    """
    problems: list[str] = []

    def report(where: Path, text: str) -> None:
        problems.append(f"{where}: {text}")

    found = read_trial(path, path.parent.name, report, report)  # the right arm first
    records = [record for record in found if arm in ("", record.arm)]
    if not records:
        raise InputError(problems[0] if problems else f"{path} has no arm {arm}.")
    record = records[0]
    table = record.table
    marks = state_tracks(record.onset[None], record.onset_harmonised[None], table.time[-1:])
    track = "" if starts == NONE else track_of_starts(marks, starts, learnt)
    begins = marks.begins(0, len(table.time), float(np.median(np.diff(table.time))), track) if track else {}
    yield from _trial(table.time, table.values.astype(np.float64), begins)


def _trial(
    time: Float[np.ndarray, " time"],
    wrench: Float[np.ndarray, "time axis"],
    begins: Mapping[int, str],
) -> Iterator[Message]:
    """Readings, and before those at which a sub-task begins its label; the first reading begins one by itself."""
    for index, (stamp, row) in enumerate(zip(time.tolist(), wrench.tolist(), strict=True)):
        if index and index in begins:
            yield Begin(begins[index])
        yield Sample(tuple(row), stamp)
