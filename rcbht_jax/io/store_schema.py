"""The schema of a store of version 3: its arrays, what its parts share, and how recordings become arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import wrench_digests
from rcbht_jax._util.untrusted import checked_number
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import VARIABLES
from rcbht_jax.io.parts import Field, Layout, dtype_of
from rcbht_jax.types import Recordings

FORMAT, FORMAT_VERSION = "rcbht-recordings", 3
SIMULATION, COLUMNS, ANNOTATIONS, LABELS = "simulation", "columns", "annotations", "labels"
HASH, WRENCH_HASH, GAPS = parts.HASH, "wrench_sha256", "gaps"  # gaps: rows that are no recording
LABELLED = "recordings_sha256"  # of label tracks: the digest of the store whose recordings they label
SUMMARIES = "part_summary"  # of each part: rcbht_jax.io.summary as JSON
PART_BYTES = 2**26  # of wrenches in one part, unless the caller chooses
MOST_ROWS = 4096  # in such a part

WRENCH = Field("float32", ("time", "axis"), (None, 0), 512)
MARKS = {
    "track": Field("int16", ("interval",), (None,), 32, {"comment": "index into annotation_labels, from 1; 0 = none"}),
    "label": Field("int32", ("interval",), (None,), 32, {"comment": "index into the track's labels, from 1"}),
    "start": Field("float64", ("interval",), (None,), 32, {"units": "s"}),
    "end": Field("float64", ("interval",), (None,), 32, {"units": "s"}),
}


@dataclass(frozen=True)
class Schema:
    """The properties that all parts of a store share."""

    layout: Layout
    dt: float  # s between samples
    axes: tuple[str, ...]
    units: tuple[str, ...]
    labels: Mapping[str, tuple[str, ...]]  # of each track of annotations
    columns: Mapping[str, str]  # dtypes
    simulation: Mapping[str, Field]  # empty = not simulated

    @property
    def fields(self) -> dict[str, Field]:
        """The arrays of the recordings, by name."""
        plain = {name: Field(dtype) for name, dtype in VARIABLES.items()}
        plain["length"] = Field("int32", attrs={"units": "samples"})
        plain["wrench"] = Field("float32", WRENCH.dimensions, (None, len(self.axes)), WRENCH.chunk)
        plain[WRENCH_HASH] = Field("uint8", ("byte",), (32,))
        columns = {f"{COLUMNS}/{name}": Field(dtype) for name, dtype in self.columns.items()}
        return plain | columns | {f"{ANNOTATIONS}/{name}": made for name, made in MARKS.items()}

    @property
    def header(self) -> list[Any]:
        """The properties of all recordings that belong to the digest."""
        labels = [[track, *names] for track, names in self.labels.items()]
        return [repr(float(self.dt)), *map(list, (self.axes, self.units, labels, sorted(self.columns.items())))]


def schema_of(
    recordings: Recordings,
    simulation: Mapping[str, NDArray[Any]] | None = None,
    rows: int | None = None,
    part: int | None = None,
) -> Schema:
    """The schema of a store of which these recordings are a part, or all.

    Args:
        recordings: any part.
        simulation: its arrays for the group ``simulation/``.
        rows: recordings of the whole store; default: these.
        part: recordings in a part; default: so many that no array of a part has more than about 64 MiB.
    """
    rows = len(recordings) if rows is None else rows
    if part is not None and not (isinstance(part, int) and part >= 1):
        raise InputError(f"A part has {part} recordings; expected a whole number, 1 or more.")
    if part is None:
        most = max(1, min(MOST_ROWS, PART_BYTES // max(1, recordings.wrench[0].nbytes, *_widths(recordings)), rows))
        part = 1 << (most - 1).bit_length() if most == rows else 1 << (most.bit_length() - 1)
    return Schema(
        Layout(rows, part), recordings.dt, recordings.axes, recordings.units,
        {track: tuple(names) for track, names in recordings.annotations.labels.items()},
        {name: dtype_of(values) for name, values in sorted(recordings.columns.items())},
        {
            name: Field(dtype_of(values), tuple(f"{name}_{n}" for n in range(1, values.ndim)), values.shape[1:])
            for name, values in sorted((simulation or {}).items())
        },
    )  # fmt: skip


def _widths(recordings: Recordings) -> Iterator[int]:
    """Bytes that one recording has at most in each array of texts."""
    texts = [np.asarray(getattr(recordings, name)) for name, dtype in VARIABLES.items() if dtype == "string"]
    texts += [values for values in recordings.columns.values() if values.dtype.kind == "U"]
    return (values.dtype.itemsize for values in texts)


def schema_in(group: zarr_io.Group) -> Schema:
    """The schema of a store of version 3.

    Raises:
        InputError: it is damaged.
    """
    with zarr_io.reading(zarr_io.path_of(group)):
        attrs: dict[str, Any] = dict(group.attrs)
        columns = parts.fields_in(zarr_io.subgroup(group, COLUMNS))
        zarr_io.subgroup(group, ANNOTATIONS)
        sub = group.get(SIMULATION)
        return Schema(
            parts.layout_of(group), checked_number(f"{zarr_io.path_of(group)}: dt", attrs["dt"]),
            tuple(zarr_io.read_array(group, "axis", "string").tolist()), tuple(map(str, attrs["axis_units"])),
            {track: tuple(map(str, names)) for track, names in attrs["annotation_labels"].items()},
            {name: made.dtype for name, made in columns.items()},
            parts.fields_in(sub) if isinstance(sub, zarr_io.Group) else {},
        )  # fmt: skip


def open_store(path: Path, *, collected: bool = False) -> zarr_io.Group:
    """Open the store's group for reading; ``collected`` as for :func:`rcbht_jax.io.zarr.open_group`.

    Raises:
        InputError: ``path`` does not exist or is not a store of this format and version.
    """
    group = zarr_io.open_group(path, collected=collected)
    if group.attrs.get("format") != FORMAT:
        raise InputError(f'{path} is not a store of recordings; expected one made by "rcbht import" or "simulate".')
    if group.attrs.get("format_version") not in (1, FORMAT_VERSION):
        raise InputError(
            f"{path} has format version {group.attrs.get('format_version')}; expected 1 or {FORMAT_VERSION}. "
            "Import it again with this version of rcbht."
        )
    return group


def in_parts(group: zarr_io.Group) -> bool:
    """Whether a store is written in parts, as all but those of version 1 are."""
    return group.attrs["format_version"] != 1


def values_of(recordings: Recordings) -> dict[str, NDArray[Any]]:
    """The arrays of the recordings as they are stored, by name."""
    values = {name: np.asarray(getattr(recordings, name)) for name in VARIABLES}
    values |= {f"{COLUMNS}/{name}": np.asarray(column) for name, column in recordings.columns.items()}
    values |= {
        f"{ANNOTATIONS}/{name}": marks for name, marks in _slots(recordings.annotations, len(recordings)).items()
    }
    return values | {WRENCH_HASH: wrench_digests(values["wrench"], values["length"])}


def digested(fields: Mapping[str, Field]) -> dict[str, Field]:
    """The fields that the digest of a part covers; wrenches have their own digests, so that rows can be read alone."""
    return {name: made for name, made in fields.items() if name != "wrench"}


def _slots(marks: Annotations, count: int) -> dict[str, NDArray[Any]]:
    """Annotations ``[recording, interval]``: codes from 1, so that 0 is a place without an interval."""
    order = np.lexsort((marks.start, marks.track, marks.recording))
    recording = marks.recording[order]
    place = np.arange(len(order)) - np.searchsorted(recording, recording)
    columns = {"track": marks.track + 1, "label": marks.code + 1, "start": marks.start, "end": marks.end}
    out = {}
    for name, values in columns.items():
        out[name] = np.zeros((count, int(place.max(initial=-1)) + 1), MARKS[name].dtype)
        out[name][recording, place] = values[order]
    return out
