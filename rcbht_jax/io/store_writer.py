"""A store written in parts: create, write each part, finish.

Parts are blocks of consecutive recordings (:mod:`rcbht_jax.io.parts`). They may be written in any order, more than once
and by several processes; no more than one part is in memory. A row of length 0 keeps the place of a recording that
does not exist, such as a simulated trial that diverged; readers leave it out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.url_path import as_path
from rcbht_jax._util.values import expect
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import validate
from rcbht_jax.io.parts import Field, Part
from rcbht_jax.io.store_schema import (
    ANNOTATIONS,
    COLUMNS,
    FORMAT,
    FORMAT_VERSION,
    GAPS,
    HASH,
    SIMULATION,
    SUMMARIES,
    Schema,
    digested,
    open_store,
    schema_in,
    schema_of,
    values_of,
)
from rcbht_jax.io.summary import COUNTING, summary_of
from rcbht_jax.types import Recordings


def create(path: Path | str, schema: Schema, attrs: Mapping[str, Any], created: str) -> None:
    """Create a store, all of whose parts are missing.

    Args:
        path: folder to create.
        schema: of all parts.
        attrs: provenance, JSON values.
        created: creation date, or any text.

    Raises:
        InputError: ``attrs`` are not JSON values.
    """
    header = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": created,
        "dt": schema.dt,
        "axis_units": list(schema.units),
        "annotation_labels": {track: list(names) for track, names in schema.labels.items()},
    }
    expect("The provenance", attrs, Mapping)
    group = zarr_io.create_group(as_path(path), {**attrs, **header})
    for name in (COLUMNS, ANNOTATIONS):
        group.create_group(name)
    parts.create(group, schema.layout, schema.fields)
    zarr_io.create_array(group, SUMMARIES, (len(schema.layout),), "string", ("part",), {}, (1,))
    zarr_io.write_array(group, "dt", np.float64(schema.dt), (), "float64", {"units": "s"})
    zarr_io.write_array(group, "axis", np.array(schema.axes), ("axis",), "string", {})
    if schema.simulation:
        parts.create(group.create_group(SIMULATION), schema.layout, schema.simulation)


def write_part(
    path: Path | str, number: int, recordings: Recordings, simulation: Mapping[str, NDArray[Any]] | None = None
) -> None:
    """Write one part of a store and flush it to disk, with its labels, if these were written before.

    The last thing written is its digest, without which it counts as missing.

    Args, Raises: as of :func:`parts_of` and :func:`rcbht_jax.io.parts.put`.
    """
    path = as_path(path)
    parts.put(path, parts_of(path, number, recordings, simulation))


def parts_of(
    path: Path, number: int, recordings: Recordings, simulation: Mapping[str, NDArray[Any]] | None = None
) -> list[Part]:
    """One part of a store, to be written by :func:`rcbht_jax.io.parts.put`.

    Args:
        path: made by :func:`create`.
        number: of the part, from 0.
        recordings: its recordings; those of length 0 keep a place.
        simulation: its arrays for the group ``simulation/``.

    Raises:
        InputError: the recordings contradict themselves or the store.
    """
    validate(recordings, gaps=True)
    schema = schema_in(open_store(path))
    given = schema_of(recordings, simulation)
    if given.header != schema.header or given.simulation != schema.simulation:
        this, others = _difference(given, schema)
        raise InputError(f"Part {number} has {this}; all parts of {path} have {others}.")
    layout, single = schema.layout, parts.Layout(len(schema.layout), 1)
    summary = {SUMMARIES: np.array([json.dumps({"counting": COUNTING, **summary_of(recordings)})])}
    found = [Part(path, single, number, {SUMMARIES: Field("string")}, summary)]
    if schema.simulation and simulation is not None:
        made = schema.simulation
        found.append(Part(path / SIMULATION, layout, number, made, simulation, tuple(made)))
    values, hashed = values_of(recordings), tuple(digested(schema.fields))
    return [*found, Part(path, layout, number, schema.fields, values, hashed)]  # its digest last: the part counts then


def _difference(given: Schema, schema: Schema) -> tuple[str, str]:
    """What differs between two schemas, in words: of the first and of the second."""
    if given.header != schema.header:
        return str(given.header), str(schema.header)
    pair = given.simulation, schema.simulation
    name = next(name for name in sorted({*pair[0], *pair[1]}) if pair[0].get(name) != pair[1].get(name))
    fields = [one.get(name) for one in pair]
    words = [f"{SIMULATION}/{name}" + (f" of type {one.dtype} {[*one.shape]}" if one else "") for one in fields]
    return words[0] if fields[0] else f"no {words[0]}", words[1] if fields[1] else f"no {words[1]}"


def has_part(path: Path | str, number: int) -> bool:
    """Whether a part of a store is there, complete; :func:`rcbht_jax.io.store_reader.check_part` verifies it."""
    try:
        return parts.digest(open_store(as_path(path)), number) is not None
    except Exception:  # no store, or a damaged one, which can fail in any way inside zarr
        return False


def finish(path: Path | str, attrs: Mapping[str, Any] | None = None) -> None:
    """Complete a store, all of whose parts are written: its digest, the times, and the collected metadata.

    Args:
        path: of the store.
        attrs: further attributes, known only now.

    Raises:
        InputError: a part is missing, or there is no recording in any.
    """
    path = as_path(path)
    for leftover in path.rglob("*.partial"):  # of a process that was killed while it wrote a file
        if leftover.is_file():  # a column may have such a name
            leftover.unlink()
    schema = schema_in(open_store(path))
    group = zarr_io.open_group(path, "r+")
    with zarr_io.reading(path):
        length = zarr_io.read_array(group, "length", "int32")
    if not length.any():
        raise InputError(f"None of the {len(length)} rows of {path} is a recording; nothing to store.")
    time = np.arange(group["wrench"].shape[1]) * schema.dt  # type: ignore[union-attr]
    zarr_io.write_array(group, "time", time, ("time",), "float64", {"units": "s"})
    if schema.simulation:
        seal_whole(zarr_io.subgroup(group, SIMULATION), sorted(schema.simulation))
    seal_whole(group, schema.header, {**(attrs or {}), GAPS: np.flatnonzero(length == 0).tolist()})
    zarr_io.consolidate(path)


def seal_whole(group: zarr_io.Group, header: Any, attrs: Mapping[str, Any] | None = None) -> None:
    """Store the digest of a table all of whose parts are there.

    Raises:
        InputError: a part is missing.
    """
    found = parts.digests(group)
    there = [digest for digest in found if digest is not None]
    if len(there) < len(found):
        raise InputError(f"{len(found) - len(there)} of {len(found)} parts of {zarr_io.path_of(group)} are missing.")
    group.update_attributes({**(attrs or {}), HASH: parts.whole_digest(header, there)})
