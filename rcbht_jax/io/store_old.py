"""Stores of version 1, of rcbht-jax 0.1: every array in one piece, with one digest for all.

They hold recordings of snap assemblies, with four start times of sub-tasks for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax.errors import InputError
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.label_parts import FIELDS, checked
from rcbht_jax.io.store_reader import padded_to
from rcbht_jax.io.store_schema import HASH
from rcbht_jax.labels import LAYERS
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

# In the order of the digest; values are dtypes.
VARIABLES = {
    "wrench": "float32", "length": "int32", "onset": "float64", "onset_harmonised": "float64", "deviation": "float64",
    "trial_name": "string", "arm": "string", "source": "string", "session": "string", "outcome": "string",
    "failure_type": "string", "note": "string",
}  # fmt: skip


def read(path: Path, group: zarr_io.Group) -> Recordings:
    """All recordings of a store, verified.

    Raises:
        InputError: an array is missing or has another dtype, or the content does not match its checksum.
    """
    padded_to(path, group)
    with zarr_io.reading(path):
        arrays = {name: zarr_io.read_array(group, name, dtype) for name, dtype in VARIABLES.items()}
        dt = float(zarr_io.read_array(group, "dt", "float64")[()])
        if content_hash([*arrays.values(), np.float64(dt)]) != group.attrs[HASH]:
            raise zarr_io.damaged(f"{path} is damaged: its content does not match its checksum.")
        wrench, length, trial = (arrays.pop(name) for name in ("wrench", "length", "trial_name"))
        return snap_recordings(wrench, length, dt, trial=trial, **arrays)


def read_simulation(path: Path, group: zarr_io.Group) -> dict[str, NDArray[Any]]:
    """The arrays ``[recording, ...]`` of the group ``simulation/``, verified.

    Raises:
        InputError: they do not match their checksum.
    """
    with zarr_io.reading(path):
        arrays = {
            name: zarr_io.read_array(group, name, None if array.dtype.kind in "biuf" else "string")
            for name, array in sorted(group.arrays())
        }
        expected = group.attrs[HASH]
    if content_hash(arrays.values()) != expected:
        raise InputError(
            f"{path} is damaged: its simulation does not match its checksum.", "Simulate or copy it again."
        )
    return arrays


def read_tracks(folder: Path, attrs: Mapping[str, Any], count: int) -> LabelTracks:
    """Label tracks of ``count`` recordings, verified.

    Raises:
        InputError: a layer is missing, an array has another dtype, or the content does not match its checksum.
    """
    group, layers = zarr_io.open_group(folder), list[LabelTrack]()
    dtypes = {name: None if dtype == "float" else dtype for name, dtype in FIELDS.items()}
    with zarr_io.reading(folder):
        for layer in LAYERS:
            sub = group[layer]
            if not isinstance(sub, zarr_io.Group):
                raise InputError(f"{folder} has no layer {layer}; it is incomplete. Encode again.")
            layers.append(LabelTrack(**{name: zarr_io.read_array(sub, name, dtype) for name, dtype in dtypes.items()}))
        arrays = [checked(track, layer, count) for track, layer in zip(layers, LAYERS, strict=True)]
    if content_hash(array for layer in arrays for array in layer.values()) != attrs[HASH]:
        raise InputError(f"{folder} is damaged: its content does not match its checksum. Encode again.")
    return LabelTracks(*layers)
