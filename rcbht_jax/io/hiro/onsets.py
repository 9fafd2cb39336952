"""Start times of the states: from the marks of a state file, and with the harmonised rotation boundary.

The harmonised boundary ends the rotation where the hand is nearly vertical, in every session alike; sessions B and C
logged a rotation of one sample.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from rcbht_jax.errors import InputError

HARMONISED_TILT = 1.96  # degrees between hand and vertical at which insertion begins
FALLBACK_SHARE = 0.9  # of the time from contact to mating, if the hand never becomes that upright
SINGLE_SAMPLE = 1.5  # time steps: a rotation shorter than this is one sample

Onset = Float[np.ndarray, "4"]  # s from the first sample: approach, rotation, insertion, mating; NaN = missing
Times = Float[np.ndarray, " sample"]


def onsets_from_marks(marks: Float64[np.ndarray, " mark"], time: Times, dt: float) -> tuple[Onset, list[str]]:
    """The start times of the four states of one record.

    Args:
        marks: start times in the state file, s, increasing.
        time: time stamps of the record, s.
        dt: s between samples.

    Returns:
        start times and notes. A mark after the last sample counts as missing (the clock of many simulated failures
        was not reset); its value stays in the note. A mark on the last sample is used and noted. A fifth mark is the
        end of the record and is not used.
    """
    onset = np.full(4, np.nan)
    if len(marks) == 0:
        return onset, ["state-times-empty"]
    if len(marks) > 5:
        raise InputError(f"{len(marks)} state times; expected at most five.")
    notes = []
    for state, mark in enumerate(marks[:4]):
        if mark > time[-1] + dt / 2:
            notes.append(f"onset-beyond-end:S{state}={mark:g}")
        elif mark < time[0] - dt / 2:
            notes.append(f"onset-before-start:S{state}={mark:g}")
        else:
            onset[state] = mark - time[0]
            if state and mark > time[-1] - dt / 2:
                notes.append(f"onset-at-end:S{state}")
    return onset, notes


def needs_harmonising(onset: Onset, dt: float) -> bool:
    """Whether the recorded rotation state is a single sample, as in sessions B and C.

    Elsewhere (session A, the simulations) the recorded boundary is used; a missing one stays missing.
    """
    return bool(np.isfinite(onset[1:3]).all() and onset[2] - onset[1] < SINGLE_SAMPLE * dt)


def harmonised(onset: Onset, time: Times, tilt: Times) -> tuple[Onset, str]:
    """Move the rotation's end to the first time after contact at which the hand is nearly vertical.

    Args:
        onset: recorded start times.
        time: time stamps of the tilt, s from the first sample.
        tilt: angle between hand and vertical, degrees.

    Returns:
        start times with the harmonised third entry and a note: "harmonised" or, if the tilt does not fall below the
        limit before mating, "harmonised-fallback" (0.9 of the time from contact to mating; NaN without mating).
    """
    out = onset.copy()
    before_mating = time < onset[3] if np.isfinite(onset[3]) else np.ones(len(time), bool)
    upright = np.flatnonzero((time > onset[1]) & before_mating & (tilt < HARMONISED_TILT))
    if len(upright):
        out[2] = time[upright[0]]
        return out, "harmonised"
    return fallback(onset)


def fallback(onset: Onset) -> tuple[Onset, str]:
    """The harmonised start times where no tilt is known: see :func:`harmonised`."""
    out = onset.copy()
    out[2] = onset[1] + FALLBACK_SHARE * (onset[3] - onset[1])
    return out, "harmonised-fallback"
