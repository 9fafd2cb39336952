"""Stores of versions 1 and 2: every array in one piece, padded to the longest recording, with one digest for all.

Version 1 holds recordings of snap assemblies, with four start times of sub-tasks for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import VARIABLES
from rcbht_jax.io.label_parts import FIELDS, checked
from rcbht_jax.io.store_reader import padded_to
from rcbht_jax.io.store_schema import HASH
from rcbht_jax.labels import LAYERS
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

# Variables in the order of the digest, and their dtypes.
FIRST_VARIABLES = {
    "wrench": "float32", "length": "int32", "onset": "float64", "onset_harmonised": "float64", "deviation": "float64",
    "trial_name": "string", "arm": "string", "source": "string", "session": "string", "outcome": "string",
    "failure_type": "string", "note": "string",
}  # fmt: skip
INTERVALS = {"recording": "int32", "track": "string", "label": "string", "start": "float64", "end": "float64"}


def read(path: Path, group: zarr_io.Group) -> Recordings:
    """All recordings of a store, verified.

    Raises:
        InputError: an array is missing or has another dtype, or the content does not match its checksum.
    """
    padded_to(path, group)
    with zarr_io.reading(path):
        recordings, digest = (_first if group.attrs["format_version"] == 1 else _second)(group)
        expected = group.attrs[HASH]
    if digest != expected:
        raise InputError(f"{path} is damaged: its content does not match its checksum. Import or copy it again.")
    return recordings


def read_simulation(path: Path, group: zarr_io.Group) -> dict[str, NDArray[Any]]:
    """The arrays ``[recording, ...]`` of the group ``simulation/``, verified.

    Raises:
        InputError: they do not match their checksum.
    """
    with zarr_io.reading(path):
        arrays = _arrays(group)
        expected = group.attrs[HASH]
    if content_hash(arrays.values()) != expected:
        raise InputError(f"{path} is damaged: its simulation does not match its checksum. Simulate or copy it again.")
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


def _first(group: zarr_io.Group) -> tuple[Recordings, str]:
    """Recordings and digest of a store of version 1."""
    arrays = {name: zarr_io.read_array(group, name, dtype) for name, dtype in FIRST_VARIABLES.items()}
    dt = float(zarr_io.read_array(group, "dt", "float64")[()])
    digest = content_hash([*arrays.values(), np.float64(dt)])
    wrench, length, trial = (arrays.pop(name) for name in ("wrench", "length", "trial_name"))
    return snap_recordings(wrench, length, dt, trial=trial, **arrays), digest


def _second(group: zarr_io.Group) -> tuple[Recordings, str]:
    """Recordings and digest of a store of version 2."""
    arrays = {variable: zarr_io.read_array(group, variable, dtype) for variable, dtype in VARIABLES.items()}
    columns = _arrays(zarr_io.subgroup(group, "columns"))
    sub = zarr_io.subgroup(group, "annotations")
    intervals = {name: zarr_io.read_array(sub, name, dtype) for name, dtype in INTERVALS.items()}
    try:
        marks = Annotations.from_table(intervals, dict(group.attrs["annotation_labels"]))  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(f"{zarr_io.path_of(group)} is damaged: {error} Import or copy it again.") from error
    recordings = Recordings(
        dt=float(zarr_io.read_array(group, "dt", "float64")[()]),
        annotations=marks,
        columns=columns,
        axes=tuple(zarr_io.read_array(group, "axis", "string").tolist()),
        units=tuple(map(str, group.attrs["axis_units"])),  # type: ignore[arg-type]
        **arrays,
    )
    return recordings, _hash(recordings, arrays, intervals)


def _arrays(group: zarr_io.Group) -> dict[str, NDArray[Any]]:
    """All arrays of a group, by name in order."""
    return {
        name: zarr_io.read_array(group, name, None if array.dtype.kind in "biuf" else "string")
        for name, array in sorted(group.arrays())
    }


def _hash(recordings: Recordings, arrays: Mapping[str, Any], intervals: Mapping[str, Any]) -> str:
    names = np.array([*recordings.axes, *recordings.units, *recordings.columns], np.str_)
    order = [[track, *labels] for track, labels in recordings.annotations.labels.items()]
    texts = np.array([label for labels in order for label in [str(len(labels)), *labels]], np.str_)
    columns = recordings.columns.values()
    return content_hash([*arrays.values(), np.float64(recordings.dt), names, texts, *intervals.values(), *columns])
