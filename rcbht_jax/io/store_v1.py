"""Stores of version 1: recordings of snap assemblies, with four start times of sub-tasks for each."""

from __future__ import annotations

import numpy as np

from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings

with needs_extra("store"):
    import zarr

# Variables in the order of the digest, and their dtypes.
VARIABLES = {
    "wrench": "float32", "length": "int32", "onset": "float64", "onset_harmonised": "float64", "deviation": "float64",
    "trial_name": "string", "arm": "string", "source": "string", "session": "string", "outcome": "string",
    "failure_type": "string", "note": "string",
}  # fmt: skip


def read(group: zarr.Group) -> tuple[Recordings, str]:
    """Recordings and digest of a store.

    Raises:
        InputError: an array is missing or has another dtype.
    """
    arrays = {name: zarr_io.read_array(group, name, dtype) for name, dtype in VARIABLES.items()}
    dt = float(zarr_io.read_array(group, "dt", "float64")[()])
    digest = content_hash([*arrays.values(), np.float64(dt)])
    wrench, length, trial = (arrays.pop(name) for name in ("wrench", "length", "trial_name"))
    return snap_recordings(wrench, length, dt, trial=trial, **arrays), digest
