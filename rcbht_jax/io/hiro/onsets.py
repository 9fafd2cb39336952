"""State start times: what a state file means for a record, and the harmonised rotation boundary.

Source: design page "hiro task", section "Signature metric"; "offline taxonomy", section 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

HARMONISED_TILT = 1.96  # degrees between hand and vertical at which insertion begins
FALLBACK_SHARE = 0.9  # of the way from contact to mating, where the hand never gets that upright
SINGLE_SAMPLE = 1.5  # time steps: a rotation shorter than this is one sample

Floats = NDArray[np.float64]


def onsets_from_marks(marks: Floats, time: Floats, dt: float) -> tuple[Floats, list[str]]:
    """The four state start times of one record.

    Args:
        marks: start times [k] of the state file, s, increasing.
        time: the record's time stamps [n], s.
        dt: seconds between samples.

    Returns:
        onset [4], s from the first sample, NaN where missing, and the notes. A mark after the last sample
        is missing (the clock of many simulated failures was not reset) and its value stays in the note; a
        mark on the last sample is kept and noted. A fifth mark is the record's end and is not used.

    Raises:
        InputError: more than five marks.
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


def needs_harmonising(onset: Floats, dt: float) -> bool:
    """Whether the recorded rotation state is a single sample, as in sessions B and C.

    Everywhere else (session A, the simulations) the recorded boundary stands; a missing one is not invented.
    """
    return bool(np.isfinite(onset[1:3]).all() and onset[2] - onset[1] < SINGLE_SAMPLE * dt)


def harmonised(onset: Floats, time: Floats, tilt: Floats) -> tuple[Floats, str]:
    """Move the rotation's end to the first time after contact at which the hand is nearly vertical.

    Args:
        onset: recorded start times [4], s from the first sample.
        time: time stamps [n] of the tilt, s from the first sample.
        tilt: angle [n] between hand and vertical, degrees.

    Returns:
        onset [4] with the harmonised third entry and a note: "harmonised" or, where the tilt never gets below
        the limit before mating, "harmonised-fallback" (0.9 of the way from contact to mating; NaN without
        mating).
    """
    out = onset.copy()
    before_mating = time < onset[3] if np.isfinite(onset[3]) else np.ones(len(time), bool)
    upright = np.flatnonzero((time > onset[1]) & before_mating & (tilt < HARMONISED_TILT))
    if len(upright):
        out[2] = time[upright[0]]
        return out, "harmonised"
    return fallback(onset)


def fallback(onset: Floats) -> tuple[Floats, str]:
    """The harmonised onset [4] where no tilt can be had: see :func:`harmonised`."""
    out = onset.copy()
    out[2] = onset[1] + FALLBACK_SHARE * (onset[3] - onset[1])
    return out, "harmonised-fallback"
