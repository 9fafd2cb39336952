"""Files of Zarr's chunks and shards of numbers, written directly.

The format is that of the Zarr 3 specification: little-endian bytes, Zstandard, CRC-32C; a shard holds its chunks one
after another and ends with an index of their places. Zarr's own pipeline handles each chunk in a task of one event
loop, which takes longer than compressing it, and threads wait for each other; here what takes time releases the lock.
"""

from __future__ import annotations

import itertools
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra

with needs_extra("store"):
    import google_crc32c
    from numcodecs.zstd import compress

LEVEL = 1  # of Zstandard: 3 takes five times as long for a wrench and saves nothing, -1 costs 6 % of its size
NONE = 2**64 - 1  # offset and size of a chunk that is all zeros


def write_chunk(file: Path, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Write an array as one chunk of a given shape, filled up with zeros; no file where all is zero."""
    _replace(file, _encoded(_grown(values, shape)))


def write_shards(
    folder: Path,
    prefix: tuple[int, ...],
    values: NDArray[Any],
    axis: int,
    chunk: tuple[int, ...],
    shard: tuple[int, ...],
) -> None:
    """Write an array as consecutive shards along one axis, and delete those that lie behind it.

    Args:
        folder: of the array's chunks ("c").
        prefix: place of the shards in the grid along the other axes: all but ``axis`` and what follows it.
        values: filled up with zeros to whole chunks.
        axis: along which there may be several shards.
        chunk: shape of the chunks. shard: of a shard, a multiple of it.
    """
    for number, start in enumerate(range(0, values.shape[axis], shard[axis])):
        part = values[(slice(None),) * axis + (slice(start, start + shard[axis]),)]
        rest = (0,) * (values.ndim - axis - 1)
        _replace(folder.joinpath(*map(str, (*prefix, number, *rest))), _shard(part, chunk, shard))
    _drop(folder.joinpath(*map(str, prefix)), -(-values.shape[axis] // shard[axis]), values.ndim - axis - 1)


def _drop(folder: Path, first: int, depth: int) -> None:
    """Delete the shards from a number on: those of values that were longer."""
    if not folder.is_dir():
        return
    for name in (one for one in os.listdir(folder) if one.isdecimal() and int(one) >= first):
        folder.joinpath(name, *["0"] * depth).unlink(missing_ok=True)


def _shard(values: NDArray[Any], chunk: tuple[int, ...], shard: tuple[int, ...]) -> bytes | None:
    """A shard's file, None if it would be empty."""
    grid = [whole // one for whole, one in zip(shard, chunk, strict=True)]
    index = np.full((*grid, 2), NONE, "<u8")
    pieces, offset = list[bytes](), 0
    for place, block in _blocks(values, chunk):
        piece = _encoded(_grown(block, chunk))
        if piece is not None:
            index[place] = offset, len(piece)
            pieces.append(piece)
            offset += len(piece)
    return b"".join([*pieces, _checked(index.tobytes())]) if pieces else None


def _blocks(values: NDArray[Any], chunk: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], NDArray[Any]]]:
    counts = [-(-size // one) for size, one in zip(values.shape, chunk, strict=True)]
    for place in itertools.product(*map(range, counts)):
        yield place, values[tuple(slice(n * one, (n + 1) * one) for n, one in zip(place, chunk, strict=True))]


def _grown(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    if values.shape == shape:
        return np.ascontiguousarray(values)
    out = np.zeros(shape, values.dtype)
    out[tuple(map(slice, values.shape))] = values
    return out


def _encoded(values: NDArray[Any]) -> bytes | None:
    """A chunk's bytes, None if it is all zeros."""
    raw = values.astype(values.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8)
    return _checked(compress(raw, LEVEL)) if raw.any() else None


def _checked(data: bytes) -> bytes:
    return data + google_crc32c.value(data).to_bytes(4, "little")


def _replace(file: Path, data: bytes | None) -> None:
    """Replace a file with this content atomically, or delete it if there is none."""
    if data is None:
        file.unlink(missing_ok=True)
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = file.with_name(f"{file.name}.{uuid.uuid4().hex}.partial")
    try:
        with draft.open("wb") as sink:
            sink.write(data)
            if hasattr(os, "posix_fadvise"):  # begins to write to the disk now: a later flush takes less time
                sink.flush()
                os.posix_fadvise(sink.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        os.replace(draft, file)
    finally:
        draft.unlink(missing_ok=True)
