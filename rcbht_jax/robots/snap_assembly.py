"""Annotations and columns of the snap assembly of Rojas et al. (2017): sub-tasks, and failures by their deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.annotations import Annotations
from rcbht_jax.types import Recordings

STATES = ("approach", "rotation", "insertion", "mating")  # sub-tasks, in order
MERGED_STATES = ("approach", "rotation+insertion", "mating")
# Tracks: start times as logged; with the corrected end of rotation; with rotation and insertion as one sub-task.
RECORDED, HARMONISED, MERGED = "states", "states-harmonised", "states-merged"
FRAMES = (
    "One-arm trials are in the robot's base frame (x forward, y left, z up), two-arm trials in the frame of each "
    "wrist; moments are about a point of the wrist."
)
DEVIATIONS = ("deviation_x", "deviation_y", "deviation_roll")  # columns: m, m, rad
# The sign patterns with at least nine trials in the full set (evaluation notes).
FAILURE_TYPES = (
    "+x", "+y", "-y", "+r", "-r", "+x+y", "+x-y", "+x+r", "+x-r", "+y+r", "-y+r", "+x+y+r", "+x-y+r",
)  # fmt: skip


def state_tracks(
    onset: Float[np.ndarray, "recording 4"],
    harmonised: Float[np.ndarray, "recording 4"],
    end: Float[np.ndarray, " recording"],
) -> Annotations:
    """The three tracks of sub-tasks.

    Args:
        onset: start of approach, rotation, insertion, mating as logged, s; NaN = missing.
        harmonised: as above with the corrected start of insertion.
        end: of the recordings, s.
    """
    return Annotations.join(
        [
            Annotations.from_starts(RECORDED, STATES, onset, end),
            Annotations.from_starts(HARMONISED, STATES, harmonised, end),
            Annotations.from_starts(MERGED, MERGED_STATES, onset[:, [0, 1, 3]], end),
        ]
    )


def snap_recordings(
    wrench: Float[np.ndarray, "recording time 6"],
    length: Int[np.ndarray, " recording"],
    dt: float,
    *,
    onset: Float[np.ndarray, "recording 4"],
    onset_harmonised: Float[np.ndarray, "recording 4"],
    failure_type: NDArray[np.str_],
    deviation: Float[np.ndarray, "recording 3"],
    **texts: Any,
) -> Recordings:
    """Recordings of snap assemblies.

    Args:
        wrench: N and Nm, zero beyond ``length``.
        length: samples.
        dt: s.
        onset: start of the sub-tasks as logged, s; NaN = missing.
        onset_harmonised: the same with the corrected start of insertion.
        failure_type: sign pattern such as "+x-y+r"; "" = none.
        deviation: x, y (m) and roll (rad) from the nominal pose; NaN = unknown.
        texts: trial, arm, source, session, outcome and note.
    """
    columns: Mapping[str, NDArray[Any]] = {
        "failure_type": failure_type, **dict(zip(DEVIATIONS, deviation.T, strict=True)),
    }  # fmt: skip
    marks = state_tracks(onset, onset_harmonised, length * dt)
    return Recordings(wrench, length, dt, annotations=marks, columns=columns, **texts)
