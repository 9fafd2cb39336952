"""Stores of version 2: every array in one piece, padded to the longest recording, with one digest for all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import VARIABLES
from rcbht_jax.types import Recordings

with needs_extra("store"):
    import zarr

INTERVALS = {"recording": "int32", "track": "string", "label": "string", "start": "float64", "end": "float64"}


def read(group: zarr.Group) -> tuple[Recordings, str]:
    """Recordings and digest of a store.

    Raises:
        InputError: an array is missing or has another dtype.
    """
    arrays = {variable: zarr_io.read_array(group, variable, dtype) for variable, dtype in VARIABLES.items()}
    columns = read_arrays(zarr_io.subgroup(group, "columns"))
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


def read_arrays(group: zarr.Group) -> dict[str, NDArray[Any]]:
    """All arrays of a group, by name; of versions 1 and 2."""
    return {
        name: zarr_io.read_array(group, name, None if array.dtype.kind in "biuf" else "string")
        for name, array in sorted(group.arrays())
    }


def arrays_hash(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Digest of the group ``simulation/`` of versions 1 and 2."""
    return content_hash(arrays[name] for name in sorted(arrays))


def tracks_hash(layers: Iterable[Mapping[str, NDArray[Any]]]) -> str:
    """Digest of label tracks of versions 1 and 2."""
    return content_hash(array for layer in layers for array in layer.values())


def _hash(recordings: Recordings, arrays: Mapping[str, Any], intervals: Mapping[str, Any]) -> str:
    names = np.array([*recordings.axes, *recordings.units, *sorted(recordings.columns)], np.str_)
    order = [[track, *labels] for track, labels in recordings.annotations.labels.items()]
    texts = np.array([label for labels in order for label in [str(len(labels)), *labels]], np.str_)
    columns = [recordings.columns[name] for name in sorted(recordings.columns)]
    return content_hash([*arrays.values(), np.float64(recordings.dt), names, texts, *intervals.values(), *columns])
