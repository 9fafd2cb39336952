"""Chunks of ROS 1 bags that unpack to far more than they are: refused as a reader unpacks them."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from typing import Any

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_CHUNK

with needs_extra("stream"):
    import lz4.frame  # comes with rosbags
    from rosbags.rosbag1 import reader as rosbag1


def bound_chunks(reader: Any) -> None:
    """Let the readers of ROS 1 bags unpack no chunk to more than ``MAX_CHUNK`` bytes; a larger one is an error there.

    >>> bound_chunks(reader)  # doctest: +SKIP
    """
    table = {rosbag1.decompressors["bz2"]: _bz2, rosbag1.decompressors["lz4"]: _lz4}
    for one in reader.readers:
        for key, chunk in getattr(one, "chunks", {}).items():
            if unpack := table.get(chunk.decompressor):
                one.chunks[key] = chunk._replace(decompressor=lambda data, unpack=unpack: _unpacked(unpack, data))


def _unpacked(unpack: Callable[[bytes], bytes], data: bytes) -> bytes:
    unpacked = unpack(data)
    if len(unpacked) > MAX_CHUNK:
        raise ValueError(f"a chunk unpacks to more than {MAX_CHUNK} bytes")
    return unpacked


def _bz2(data: bytes) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, MAX_CHUNK + 1)


def _lz4(data: bytes) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK + 1))
