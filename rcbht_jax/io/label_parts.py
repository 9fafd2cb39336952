"""Label tracks as a table in parts: create, write each part, finish, read part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.values import expect
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.parts import Field, Layout, Part
from rcbht_jax.io.store_schema import HASH, LABELLED, LABELS, open_store, schema_in
from rcbht_jax.io.store_writer import seal_whole
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks

PART = 1024  # recordings in a part, unless the caller chooses
INTEGERS = {"label": "int8", "t0": "int32", "t1": "int32", "emit": "int32"}
FIELDS = {field.name: INTEGERS.get(field.name, "float") for field in fields(LabelTrack)}


def create(
    folder: Path, layout: Layout, sample: LabelTracks, attrs: Mapping[str, Any], *, created: str | None = None
) -> None:
    """Create label tracks, all of whose parts are missing.

    Args:
        folder: to create; in a store that is being written, :func:`require_group` comes first.
        layout: of the table.
        sample: some of the label tracks, ``[recording, axis, slot]``.
        attrs: how the labels are made: JSON values.
        created: creation date to store; default now.

    Raises:
        InputError: ``attrs`` are not JSON values.
    """
    date = datetime.now(UTC).isoformat(timespec="seconds") if created is None else created
    expect("The provenance", attrs, Mapping)
    group = zarr_io.create_group(folder, {**attrs, "rcbht_jax_version": rcbht_jax.__version__, "created": date})
    axes, real = np.shape(sample.llb.label)[1], str(np.asarray(sample.llb.avg).dtype)
    parts.create(group, layout, _fields(axes, real))


def require_group(path: Path) -> None:
    """Create the group of all label tracks of a store, if there is none."""
    with zarr_io.locked(path):
        if not (path / LABELS / zarr_io.META).exists():
            zarr_io.create_group(path / LABELS, {})


def write_part(folder: Path, number: int, tracks: LabelTracks) -> None:
    """Write one part: label tracks ``[row of the part, axis, slot]``, empty where there is no recording.

    Raises:
        InputError: a shape or dtype is wrong, or there is no such part.
    """
    part = part_of(folder, number, tracks)
    parts.write(part)
    parts.seal(part)


def part_of(folder: Path, number: int, tracks: LabelTracks) -> Part:
    """The part that :func:`write_part` writes."""
    group = zarr_io.open_group(folder)
    made, layout = _fields_in(group), parts.layout_of(group)
    rows = layout.span(number)
    values = {
        f"{layer}/{name}": array
        for layer in LAYERS
        for name, array in checked(getattr(tracks, layer), layer, rows.stop - rows.start).items()
    }
    return Part(folder, layout, number, made, values, tuple(made))


def finish(folder: Path, store: Path) -> None:
    """Complete label tracks, all of whose parts are written.

    Args:
        folder: of the label tracks.
        store: whose recordings they label, all of whose parts are written.

    Raises:
        InputError: a part is missing, or ``store`` is not a store.
    """
    group = zarr_io.open_group(folder, "r+")
    seal_whole(group, _header(group), {LABELLED: _digest_of(store)})


def check_part(folder: Path, number: int) -> None:
    """Read a part and compare it with its digest.

    Raises:
        InputError: it is missing or damaged.
    """
    group = zarr_io.open_group(folder)
    with zarr_io.reading(folder):
        stored = parts.digest(group, number)
    _read_part(folder, group, number, stored)


def read(folder: Path, rows: NDArray[np.int64]) -> Iterator[LabelTracks]:
    """The label tracks of each part that has any of the recordings, without empty rows; every part is verified.

    Args:
        folder: of the label tracks.
        rows: row of each recording, ascending.

    Raises:
        InputError: the label tracks are damaged.
    """
    group = zarr_io.open_group(folder)
    with zarr_io.reading(folder):
        layout = parts.layout_of(group)
        digests = [digest or "" for digest in parts.digests(group)]
        if parts.whole_digest(_header(group), digests) != group.attrs.get(HASH) or layout.rows <= rows[-1]:
            raise _damaged(folder)
    for number in range(len(layout)):
        span = layout.span(number)
        first, last = np.searchsorted(rows, [span.start, span.stop]).tolist()
        if first < last:
            yield taken(_read_part(folder, group, number, digests[number]), rows[first:last] - span.start)


def regroup(batches: Iterable[LabelTracks], sizes: Iterable[int]) -> Iterator[LabelTracks]:
    """Label tracks of consecutive recordings in batches of other sizes.

    Raises:
        InputError: there are more or fewer recordings than the sizes add up to.
    """
    source, waiting = iter(batches), list[LabelTracks]()
    for size in sizes:
        while sum(map(_count, waiting)) < size:
            batch = next(source, None)
            if batch is None:
                raise InputError(f"the labels end after {sum(map(_count, waiting))} of {size} recordings.")
            waiting.append(batch)
        whole = joined(waiting)
        yield taken(whole, slice(0, size))
        waiting = [taken(whole, slice(size, None))] if _count(whole) > size else []
    if waiting or next(source, None) is not None:
        raise InputError("there are labels of more recordings than expected.")


def spread(tracks: LabelTracks, rows: Int[np.ndarray, " recording"], count: int) -> LabelTracks:
    """Label tracks ``[row, axis, slot]`` of ``count`` rows, those of the recordings in ``rows``, the others empty."""
    if len(rows) == count:
        return tracks

    def one(values: NDArray[Any]) -> NDArray[Any]:
        out = np.zeros((count, *values.shape[1:]), values.dtype)
        out[rows] = values
        return out

    return _mapped(tracks, one)


def joined(batches: list[LabelTracks]) -> LabelTracks:
    """Label tracks, concatenated along recordings, as wide as the widest."""
    if len(batches) == 1:
        return batches[0]

    def one(*parts: NDArray[Any]) -> NDArray[Any]:
        width = max(np.shape(part)[2] for part in parts)
        return np.concatenate([np.pad(part, ((0, 0), (0, 0), (0, width - np.shape(part)[2]))) for part in parts])

    return jax.tree.map(one, *(replace(batch, info=None) for batch in batches))


def taken(tracks: LabelTracks, rows: slice | NDArray[np.int64]) -> LabelTracks:
    """The label tracks of some recordings."""
    return _mapped(tracks, lambda values: values[rows])


def checked(track: LabelTrack, layer: str, count: int) -> dict[str, Any]:
    """The fields of a layer as host arrays of agreeing shape.

    Raises:
        InputError: a shape or dtype is wrong.
    """
    arrays = {name: np.asarray(getattr(track, name)) for name in FIELDS}
    shape = arrays["label"].shape
    if len(shape) != 3 or shape[0] != count:
        raise InputError(f"{layer} labels have shape {shape}; expected [{count} recordings, axes, slots].")
    for name, expected in FIELDS.items():
        dtype = arrays[name].dtype
        matches = dtype in (np.float32, np.float64) if expected == "float" else dtype == expected
        if arrays[name].shape != shape or not matches:
            raise InputError(
                f"{layer} {name} is {dtype} of shape {arrays[name].shape}; expected {expected} of shape {shape}."
            )
    return arrays


def _fields(axes: int, real: str) -> dict[str, Field]:
    return {
        f"{layer}/{name}": Field(real if dtype == "float" else dtype, ("axis", "slot"), (axes, None))
        for layer in LAYERS
        for name, dtype in FIELDS.items()
    }


def _fields_in(group: zarr_io.Group) -> dict[str, Field]:
    with zarr_io.reading(zarr_io.path_of(group)):
        sample = [zarr_io.subgroup(group, layer) for layer in LAYERS][-1]["avg"]
        return _fields(sample.shape[1], str(sample.dtype))  # type: ignore[union-attr]


def _header(group: zarr_io.Group) -> list[str]:
    return sorted(f"{name} {made.dtype}" for name, made in _fields_in(group).items())


def _digest_of(store: Path) -> str:
    """The digest that a store has, or will have when it is finished."""
    group = open_store(store)
    if HASH in group.attrs:
        return str(group.attrs[HASH])
    return parts.whole_digest(schema_in(group).header, [digest or "" for digest in parts.digests(group)])


def _read_part(folder: Path, group: zarr_io.Group, number: int, digest: str | None) -> LabelTracks:
    made = _fields_in(group)
    with zarr_io.reading(folder):
        rows = parts.layout_of(group).span(number)
        values = {name: parts.read(group, name, rows, field) for name, field in made.items()}
        if parts.digest_of(values, made) != digest:
            raise _damaged(folder)
    layers = [LabelTrack(**{name: values[f"{layer}/{name}"] for name in FIELDS}) for layer in LAYERS]
    return LabelTracks(*layers)


def _damaged(folder: Path) -> InputError:
    return InputError(f"{folder} is damaged: its content does not match its checksum. Encode again.")


def _count(tracks: LabelTracks) -> int:
    return int(np.shape(tracks.llb.label)[0])


def _mapped(tracks: LabelTracks, change: Callable[[NDArray[Any]], NDArray[Any]]) -> LabelTracks:
    return jax.tree.map(lambda values: change(np.asarray(values)), replace(tracks, info=None))
