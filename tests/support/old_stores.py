"""A writer of stores of version 2, as the library was until version 3: every array padded and in one piece."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import Crc32cCodec, ZstdCodec

from rcbht_jax._util.digest import content_hash
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTracks, Recordings

TEXTS = ("trial", "arm", "source", "session", "outcome", "note")


def write_version_2(
    path: Path, recordings: Recordings, simulation: Mapping[str, NDArray[Any]], tracks: LabelTracks
) -> None:
    """A store with a simulation and the label tracks online-W5."""
    marks = recordings.annotations
    intervals: dict[str, Any] = {
        "recording": marks.recording,
        "track": np.array(marks.tracks, np.str_)[marks.track],
        "label": marks.names(),
        "start": marks.start,
        "end": marks.end,
    }
    arrays = {"wrench": recordings.wrench, "length": recordings.length}
    arrays |= {name: getattr(recordings, name) for name in TEXTS}
    names = np.array([*recordings.axes, *recordings.units, *sorted(recordings.columns)], np.str_)
    order = [[track, *labels] for track, labels in marks.labels.items()]
    texts = np.array([label for labels in order for label in [str(len(labels)), *labels]], np.str_)
    columns = [recordings.columns[name] for name in sorted(recordings.columns)]
    hashed = [*arrays.values(), np.float64(recordings.dt), names, texts, *intervals.values(), *columns]
    attrs = {
        "format": "rcbht-recordings",
        "format_version": 2,
        "rcbht_jax_version": "0.2.0",
        "created": "then",
        "dt": recordings.dt,
        "axis_units": list(recordings.units),
        "annotation_labels": {track: list(labels) for track, labels in marks.labels.items()},
        "content_sha256": content_hash(hashed),
    }
    group = zarr.create_group(path, zarr_format=3, attributes=attrs)
    for name, values in arrays.items():
        _array(group, name, values, ("trial", "time", "axis")[: values.ndim])
    _array(group, "dt", np.float64(recordings.dt), ())
    _array(group, "axis", np.array(recordings.axes), ("axis",))
    for folder, table in (("columns", recordings.columns), ("annotations", intervals)):
        sub = group.create_group(folder)
        for name, values in table.items():
            _array(sub, name, values, ("row",))
    digest = content_hash(simulation[name] for name in sorted(simulation))
    sub = group.create_group("simulation", attributes={"content_sha256": digest})
    for name, values in simulation.items():
        _array(sub, name, values, ("trial", *(f"{name}_{n}" for n in range(1, values.ndim))))
    layers = {layer: vars(getattr(tracks, layer)) for layer in LAYERS}
    digest = content_hash(values for layer in layers.values() for values in layer.values())
    sub = group.create_group("labels").create_group("online-W5", attributes={"window": 5, "content_sha256": digest})
    for layer, fields in layers.items():
        inner = sub.create_group(layer)
        for name, values in fields.items():
            _array(inner, name, values, ("trial", "axis", "slot"))


def _array(group: zarr.Group, name: str, values: Any, dimensions: tuple[str, ...]) -> None:
    text = values.dtype.kind == "U"
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=np.dtypes.StringDType() if text else values.dtype,
        chunks=tuple(max(1, size) for size in values.shape),
        compressors=[ZstdCodec(level=3), Crc32cCodec()],
        dimension_names=dimensions,
    )
    array[...] = values.astype(np.dtypes.StringDType()) if text else values
