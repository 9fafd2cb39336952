"""Arrays whose chunks unpack to no more than they can hold: an untrusted store may pack gigabytes into kilobytes.

Stores of all versions pack their chunks in one way: bytes or texts, Zstandard, CRC-32C, some within shards. Zarr
allocates as many bytes as a packed chunk declares; here the declared size is checked first.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_RATIO, SMALL
from rcbht_jax.errors import InputError

with needs_extra("store"):
    import zarr
    from zarr.abc.codec import Codec
    from zarr.codecs import BytesCodec, Crc32cCodec, ShardingCodec, VLenUTF8Codec, ZstdCodec
    from zarr.core.array_spec import ArraySpec
    from zarr.core.buffer import Buffer

_MAGIC, _HEADER = b"\x28\xb5\x2f\xfd", 18  # how a frame of Zstandard begins, and bytes until its content


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
    """Zstandard that refuses a chunk that is too large before it allocates memory for it."""

    def _decode_sync(self, chunk_bytes: Buffer, chunk_spec: ArraySpec) -> Buffer:
        dtype = chunk_spec.dtype.to_native_dtype()
        most = None if dtype.kind in "TUO" else math.prod(chunk_spec.shape) * dtype.itemsize
        unpacked_size(chunk_bytes[:_HEADER].to_bytes(), len(chunk_bytes), most)
        return super()._decode_sync(chunk_bytes, chunk_spec)


def unpacked_size(head: bytes, packed: int, most: int | None) -> int:
    """Bytes to which a chunk unpacks.

    Args:
        head: at least the first 18 bytes of the chunk. packed: all its bytes.
        most: bytes that its shape has; None = a text, which may have any length.

    Raises:
        ValueError: too many for its shape, or for a measured signal.
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
