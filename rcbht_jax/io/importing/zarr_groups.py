"""Zarr groups of any program, such as the replay buffers of imitation learning: folders, or ``.zarr.zip``."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import require
from rcbht_jax._util.untrusted import MAX_JSON_BYTES, MAX_MEMBERS, check_declared, parse_json, read_bytes
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.arrays import reading
from rcbht_jax.io.importing.attributes import scaled, stated_units, units_of
from rcbht_jax.io.importing.isolated import apart, bytes_of
from rcbht_jax.io.importing.rows import MAX_GROUPS
from rcbht_jax.io.importing.table import Table, tables_of

ENDS = "episode_ends"  # array of one past the last row of each recording
METADATA = ("zarr.json", ".zarray", ".zattrs")
# Codecs that only move bytes; others may run code (pickle) or decode pictures.
CODECS = {
    "blosc", "zlib", "gzip", "bz2", "lzma", "lz4", "zstd", "delta", "shuffle", "crc32", "crc32c", "adler32", "bitround",
    "fixedscaleoffset", "quantize", "astype", "packbits", "vlen-utf8", "bytes", "transpose", "sharding_indexed",
}  # fmt: skip


@apart("zarr", "numcodecs")
def read_zarr(path: Path, name: str) -> Iterator[Table]:
    """Tables of a Zarr group of version 2 or 3: a recording for each episode, or as of any other file of arrays.

    Where an array ``episode_ends`` states the ends of recordings, all arrays as long as the last end are cut there, and
    those with a value for each recording are facts. Without one, :func:`~rcbht_jax.io.importing.table.tables_of` finds
    the recordings. Pictures are left out.

    >>> import zarr
    >>> group = zarr.open_group("buffer.zarr", mode="w")
    >>> for key, values in {"data/Fz": np.arange(5.0), "meta/episode_ends": np.array([2, 5])}.items():
    ...     _ = group.create_array(key, data=values)
    >>> [table.columns["Fz"].tolist() for table in read_zarr(Path("buffer.zarr"), "buffer.zarr")]
    [[0.0, 1.0], [2.0, 3.0, 4.0]]

    Raises:
        InputError: not a Zarr group, damaged, of arrays too large for it, or zarr is missing.
    """
    zarr = require("zarr", "store")
    with reading(path, "Zarr"):
        metadata = _metadata(path)
        chosen, others = _arrays(path, metadata)
        check_declared(path, sum(_bytes(metadata[key]) for key in chosen), bytes_of(path))
        store = (
            zarr.storage.ZipStore(path, mode="r") if path.is_file() else zarr.storage.LocalStore(path, read_only=True)
        )
        arrays = {key: np.asarray(zarr.open_array(store, path=key, mode="r")[...]) for key in chosen}
    about = {key: metadata[key].get("attributes", {}) for key in chosen}
    arrays = {key: scaled(array, about[key]) if array.dtype.kind in "fiu" else array for key, array in arrays.items()}
    stated = {key.removeprefix("data/"): texts for key in chosen if (texts := stated_units(about[key]))}
    groups = {key: one.get("attributes", {}) for key, one in metadata.items() if "shape" not in one}
    facts = {f"{key}/{own}".lstrip("/"): _array(value) for key, one in groups.items() for own, value in one.items()}
    arrays = {key: array for key, array in {**facts, **arrays}.items() if array.dtype.kind in "fiubU"}
    several = _episodes(path, arrays)
    for part, own in several.items() if several else [("", arrays)]:
        for table in tables_of(path, f"{name}#{part}" if part else name, own, part):
            units = units_of(table.columns, stated)
            yield replace(table, others=(*table.others, *others), units={**table.units, **units})


def _array(attribute: Any) -> NDArray[Any]:
    """An attribute as an array; of objects, which no recording holds, if it is none."""
    try:
        return np.asarray(attribute)
    except ValueError:  # lists of several lengths
        return np.asarray(None)


def _metadata(path: Path) -> dict[str, dict[str, Any]]:
    """The metadata of every array and of the group itself, "", by its path in the group."""
    found: dict[str, dict[str, Any]] = {}
    for file, content in _files(path):
        key, _, kind = file.rpartition("/")
        value = parse_json(content, finite=False)
        if not isinstance(value, dict):
            raise ValueError(f"{file} is not a JSON object")
        if kind == "zarr.json":
            found[key] = value
        else:
            found.setdefault(key, {}).update({"attributes": value} if kind == ".zattrs" else value)
        if len(found) > MAX_MEMBERS:
            raise InputError(f"{path} holds more than {MAX_MEMBERS} arrays; split it.")
    return found


def _files(path: Path) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files of metadata."""
    if path.is_file():
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if member.filename.rpartition("/")[2] in METADATA:
                    if member.file_size > MAX_JSON_BYTES:
                        raise InputError(f"{path}: {member.filename} has more than {MAX_JSON_BYTES} bytes.")
                    yield member.filename, archive.read(member)
        return
    for folder, _, files in os.walk(path):
        for name in sorted({*files} & {*METADATA}):
            file = Path(folder, name)
            yield file.relative_to(path).as_posix(), read_bytes(file, MAX_JSON_BYTES)


def _arrays(path: Path, metadata: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], tuple[str, ...]]:
    """The arrays that can be signals or facts, and those that are left out."""
    chosen, others = list[str](), list[str]()
    for key, about in metadata.items():
        if isinstance(shape := about.get("shape"), list):
            flat = len(shape) < 3 or (len(shape) == 3 and "u" not in str(about.get("dtype", about.get("data_type"))))
            (chosen if flat and _codecs(about) <= CODECS else others).append(key)
    if not chosen:
        raise InputError(f"{path} holds no array [time] or [time, axis].")
    return chosen, tuple(others)


def _codecs(about: Mapping[str, Any]) -> set[str]:
    """Names of the codecs of an array, those within others too."""
    found: set[str] = set()
    places = [about.get("compressor"), about.get("filters"), about.get("codecs")]
    while places:
        place = places.pop()
        if isinstance(place, list):
            places += place
        elif isinstance(place, dict):
            found.add(str(place.get("id", place.get("name"))).removeprefix("numcodecs."))
            if isinstance(inner := place.get("configuration"), dict):
                places += [inner.get("codecs"), inner.get("index_codecs")]
    return found


def _bytes(about: Mapping[str, Any]) -> int:
    kind = about.get("dtype", about.get("data_type"))
    try:
        size = np.dtype(kind).itemsize or 8
    except TypeError:  # text of any length
        size = 8
    total = size
    for count in about["shape"]:
        total *= int(count)
    return total


def _episodes(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, NDArray[Any]]]:
    """The arrays of each recording by its number; none where no array states the ends."""
    found = [array for key, array in arrays.items() if key.rpartition("/")[2] == ENDS]
    if len(found) != 1 or found[0].ndim != 1 or not found[0].size or found[0].dtype.kind not in "iu":
        return {}
    ends = found[0].astype(np.int64)
    if len(ends) > MAX_GROUPS or (np.diff(ends, prepend=0) <= 0).any():
        raise InputError(f"{path}: {ENDS} must be increasing ends of at most {MAX_GROUPS} recordings.")
    rows = {key.removeprefix("data/"): array for key, array in arrays.items() if array.shape[:1] == (ends[-1],)}
    facts = {key.removeprefix("meta/"): array for key, array in arrays.items() if array.shape == ends.shape}
    scalars = {key: array for key, array in arrays.items() if array.ndim == 0}
    cuts = zip(np.r_[0, ends[:-1]].tolist(), ends.tolist(), strict=True)
    return {
        str(number): {**scalars, **{key: array[first:end] for key, array in rows.items()},
                      **{key: array[number] for key, array in facts.items() if key != ENDS}}
        for number, (first, end) in enumerate(cuts)
    }  # fmt: skip
