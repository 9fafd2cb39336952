"""Recordings of snap assemblies with other marks or columns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED, state_tracks
from rcbht_jax.types import Recordings


def marked(recordings: Recordings, onset: Any = None, onset_harmonised: Any = None) -> Recordings:
    """With other starts of the sub-tasks, [recording, 4] s, as logged and as corrected; None = as they are."""
    logged = recordings.starts(RECORDED) if onset is None else np.asarray(onset)
    corrected = recordings.starts(HARMONISED) if onset_harmonised is None else np.asarray(onset_harmonised)
    return replace(recordings, annotations=state_tracks(logged, corrected, recordings.length * recordings.dt))


def with_columns(recordings: Recordings, **columns: Any) -> Recordings:
    return replace(recordings, columns={**recordings.columns, **columns})


def deviation(recordings: Recordings) -> np.ndarray:
    """[recording, 3] m, m, rad."""
    return np.stack([recordings.columns[f"deviation_{axis}"] for axis in ("x", "y", "roll")], 1)
