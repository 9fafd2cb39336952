"""Chunks of numbers in local files, read directly: the counterpart of :mod:`rcbht_jax.io.chunk_files`.

Zarr hands each chunk to a task of one event loop, which takes longer than unpacking it. Object stores, texts and arrays
that another program laid out are read by Zarr.

Either way, chunks unpack to no more than they can hold: an untrusted store may pack gigabytes into kilobytes. Stores of
all versions pack their chunks in one way: bytes or texts, Zstandard, CRC-32C, some within shards. Zarr allocates as
many bytes as a packed chunk declares, and as many texts; here both are checked first.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_RATIO, SMALL, check_file
from rcbht_jax.errors import InputError
from rcbht_jax.io.chunk_files import NONE

with needs_extra("store"):
    import google_crc32c
    import zarr
    from numcodecs.zstd import decompress
    from zarr.abc.codec import Codec
    from zarr.codecs import BytesCodec, Crc32cCodec, ShardingCodec, VLenUTF8Codec, ZstdCodec
    from zarr.core.array_spec import ArraySpec
    from zarr.core.buffer import Buffer
    from zarr.storage import LocalStore

_CHECKSUM = 4  # bytes of a CRC-32C
_MAGIC, _HEADER = b"\x28\xb5\x2f\xfd", 18  # how a frame of Zstandard begins, and bytes until its content
_COUNT = 4  # bytes of the number of texts, and of the length of each, in a chunk of texts
_PLACE = 16  # bytes of a chunk's offset and size in the index of a shard


@dataclass(frozen=True)
class Chunks:
    """Where the chunks of an array are, and of what shape.

    Attributes:
        folder: of the array's chunks ("c").
        dtype: of the numbers.
        chunk: shape of a chunk. shard: of a file of several chunks, a multiple of it; of one chunk without an index,
            None.
    """

    folder: Path
    dtype: np.dtype[Any]
    chunk: tuple[int, ...]
    shard: tuple[int, ...] | None


def chunks_of(array: zarr.Array[Any]) -> Chunks | None:
    """The chunks of an array of which :func:`read` can read them, None if Zarr must.

    Args:
        array: packed as :func:`bounded` accepts.
    """
    files, metadata = array.store_path.store, array.metadata.to_dict()
    if not isinstance(files, LocalStore) or array.dtype.kind not in "biuf" or not array.ndim or metadata["fill_value"]:
        return None
    codecs: Any = metadata["codecs"]
    if array.shards is not None:
        if codecs[0]["configuration"].get("index_location", "end") != "end":
            return None
        codecs = codecs[0]["configuration"]["codecs"]
    if codecs[0].get("configuration", {}).get("endian", "little") != "little":
        return None
    keys: Any = metadata["chunk_key_encoding"]
    if keys["name"] != "default" or keys.get("configuration", {}).get("separator", "/") != "/":
        return None
    return Chunks(files.root / array.store_path.path / "c", array.dtype, array.chunks, array.shards)


def read(chunks: Chunks, rows: NDArray[np.int64], stops: tuple[int, ...]) -> NDArray[Any]:
    """Some rows of an array, up to ``stops`` along its other dimensions; zeros where there is no chunk.

    Raises:
        ValueError: a file or a chunk is damaged, or unpacks to another size than its shape.
    """
    out = np.zeros((len(rows), *stops), chunks.dtype)
    shard = chunks.shard or chunks.chunk
    for number, mine, within in _grouped(rows, shard[0]):
        for place in _grid(stops, shard[1:]):
            _read_file(chunks, (number, *place), within, mine, _window(out, place, shard[1:]))
    return out


def _grouped(rows: NDArray[np.int64], size: int) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.int64]]]:
    """Blocks of so many rows that hold any of the rows: number, places of these rows, and rows within the block."""
    numbers = rows // size
    order = np.argsort(numbers, kind="stable")
    found, first = np.unique(numbers[order], return_index=True)
    for number, mine in zip(found.tolist(), np.split(order, first[1:]), strict=False):  # of no row: one split, no block
        yield number, mine, rows[mine] - number * size


def _grid(stops: tuple[int, ...], sizes: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Places of the blocks of a size, as far as they are used."""
    return itertools.product(*(range(-(-stop // size)) for stop, size in zip(stops, sizes, strict=True)))


def _window(out: NDArray[Any], place: tuple[int, ...], sizes: tuple[int, ...]) -> NDArray[Any]:
    """What an array holds of a block, all of whose rows it may have."""
    return out[(slice(None), *(slice(n * size, (n + 1) * size) for n, size in zip(place, sizes, strict=True)))]


def _read_file(
    chunks: Chunks, place: tuple[int, ...], within: NDArray[np.int64], to: NDArray[np.int64], out: NDArray[Any]
) -> None:
    """Copy the rows ``within`` a file to the rows ``to`` of ``out``."""
    file = chunks.folder.joinpath(*map(str, place))
    if not file.exists():
        return
    size = check_file(file)
    with file.open("rb", buffering=0) as source:
        index = _index(source.fileno(), size, chunks)
        for number, mine, taken in _grouped(within, chunks.chunk[0]):
            for inner in _grid(out.shape[1:], chunks.chunk[1:]):
                offset, length = map(int, index[(number, *inner)])
                if (offset, length) != (NONE, NONE):
                    block = _unpacked(_bytes(source.fileno(), offset, length, size), chunks)
                    window = _window(out, inner, chunks.chunk[1:])
                    window[to[mine]] = block[(slice(None), *map(slice, window.shape[1:]))][taken]


def _index(file: int, size: int, chunks: Chunks) -> NDArray[np.uint64]:
    """Offset and size of each chunk of a file ``[..., 2]``."""
    if chunks.shard is None:
        return np.array([0, size], np.uint64).reshape(*[1] * len(chunks.chunk), 2)
    grid = [whole // one for whole, one in zip(chunks.shard, chunks.chunk, strict=True)]
    length = _PLACE * math.prod(grid) + _CHECKSUM
    raw = _verified(_bytes(file, size - length, length, size))
    return np.frombuffer(raw, "<u8").reshape(*grid, 2)


def _bytes(file: int, offset: int, length: int, size: int) -> bytes:
    if offset < 0 or length <= _CHECKSUM or offset + length > size:
        raise ValueError(f"a chunk of {length} bytes at {offset} is not within the {size} bytes of its file")
    data = os.pread(file, length, offset)
    if len(data) != length:
        raise ValueError(f"a chunk ends after {len(data)} of {length} bytes")
    return data


def _verified(data: bytes) -> bytes:
    """What is before a checksum."""
    content = data[:-_CHECKSUM]
    if google_crc32c.value(content) != int.from_bytes(data[-_CHECKSUM:], "little"):
        raise ValueError("a chunk does not match its checksum")
    return content


def _unpacked(data: bytes, chunks: Chunks) -> NDArray[Any]:
    """The numbers of a chunk; refused before memory is allocated for more than its shape."""
    packed, wanted = _verified(data), math.prod(chunks.chunk) * chunks.dtype.itemsize
    size = _unpacked_size(data[:_HEADER], len(packed), wanted)
    if size != wanted:
        raise ValueError(f"a chunk declares {size} bytes unpacked; expected the {wanted} of its shape")
    out = np.empty(chunks.chunk, chunks.dtype)
    decompress(packed, out.reshape(-1).view(np.uint8))
    return out


def bounded(array: zarr.Array[Any]) -> zarr.Array[Any]:
    """The same array, whose chunks may unpack neither to more bytes than their shape has, nor than measured signals do.

    Raises:
        InputError: its chunks are packed in a way that no version of this program uses.
    """
    metadata: Any = array.metadata
    match metadata.codecs:
        case (ShardingCodec(index_codecs=(BytesCodec(), Crc32cCodec())) as shards,):
            codecs: tuple[Codec, ...] = (replace(shards, codecs=_bounded(shards.codecs, array)),)
        case plain:
            codecs = _bounded(plain, array)
    return zarr.Array(zarr.AsyncArray(replace(metadata, codecs=codecs), array.store_path))


def _bounded(codecs: tuple[Codec, ...], array: zarr.Array[Any]) -> tuple[Codec, ...]:
    match codecs:
        case (BytesCodec() | VLenUTF8Codec() as first, ZstdCodec() as packed, Crc32cCodec() as last):
            return first, _Zstd(level=packed.level, checksum=packed.checksum), last
    raise InputError(f"{array.store_path} is packed in an unknown way. Import it again from its source.")


class _Zstd(ZstdCodec):
    """Zstandard that refuses a chunk that declares too much, before memory is allocated for its bytes or its texts."""

    def _decode_sync(self, chunk_bytes: Buffer, chunk_spec: ArraySpec) -> Buffer:
        dtype, count = chunk_spec.dtype.to_native_dtype(), math.prod(chunk_spec.shape)
        texts = dtype.kind in "TO"  # of varying length
        _unpacked_size(chunk_bytes[:_HEADER].to_bytes(), len(chunk_bytes), None if texts else count * dtype.itemsize)
        unpacked = super()._decode_sync(chunk_bytes, chunk_spec)
        if texts:
            _check_texts(unpacked[:_COUNT].to_bytes(), len(unpacked), count)
        return unpacked


def _check_texts(head: bytes, size: int, wanted: int) -> None:
    """Raise an error for a chunk of another number of texts than its shape has, or than its bytes can hold."""
    count = int.from_bytes(head, "little")
    if count != wanted or _COUNT * (1 + count) > size:  # the length of each stands before it
        raise ValueError(f"a chunk of {size} bytes declares {count} texts; expected the {wanted} of its shape")


def _unpacked_size(head: bytes, packed: int, most: int | None) -> int:
    """Bytes to which a chunk of ``packed`` bytes unpacks, by its first 18; ValueError: too many.

    Its shape has ``most`` bytes; None = a text, which may have any length.
    """
    limit = max(SMALL, MAX_RATIO * packed)
    limit = limit if most is None else min(limit, most)
    size = content_size(head)
    if size is None or size > limit:
        raise ValueError(f"a chunk of {packed} bytes declares {size} unpacked; expected at most {limit}")
    return size


def content_size(frame: bytes) -> int | None:
    """Bytes that a frame of Zstandard declares to unpack to; None = none declared, or no frame (RFC 8878).

    >>> from numcodecs.zstd import compress
    >>> content_size(compress(bytes(1000))), content_size(b"abc")
    (1000, None)
    """
    if frame[:4] != _MAGIC or len(frame) < 5:
        return None
    flags = frame[4]
    single, width = flags >> 5 & 1, 1 << (flags >> 6)
    if width == 1 and not single:
        return None
    start = 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]  # behind the size of the window and the number of a dictionary
    return int.from_bytes(frame[start : start + width], "little") + (256 if width == 2 else 0)
