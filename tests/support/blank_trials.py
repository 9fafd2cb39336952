"""Trials of four states of equal length that hold no signal: what is learned from them comes from elsewhere."""

from __future__ import annotations

import numpy as np

from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings


def blank_trials(trials: int, state: int, dt: float) -> Recordings:
    """Successes without a wrench; ``state`` samples in each state."""
    onset = np.tile(np.arange(4) * state * dt, (trials, 1))
    text = np.full(trials, "")
    return snap_recordings(
        wrench=np.zeros((trials, 4 * state, 6), np.float32), length=np.full(trials, 4 * state, np.int32), dt=dt,
        onset=onset, onset_harmonised=onset, trial=np.array([f"t{k:02d}" for k in range(trials)]),
        arm=np.full(trials, "R"), source=text, session=text, outcome=np.full(trials, "success"), failure_type=text,
        deviation=np.zeros((trials, 3)), note=text,
    )  # fmt: skip
