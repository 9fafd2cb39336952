"""Limits on what a bag unpacks to: chunks of ROS 1, files and messages of ROS 2."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_CHUNK, check_declared, check_file
from rcbht_jax.errors import InputError

with needs_extra("stream"):
    import lz4.frame  # comes with rosbags
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import reader as rosbag2

zstd: Any = vars(rosbag2)["zstd"]  # of Python, or the package that stands in for it
ZSTD = b"\x28\xb5\x2f\xfd"
_BLOCK = 2**20


@contextmanager
def unpacked_file(path: Path) -> Iterator[Path]:
    """A file of a ROS 2 bag as its reader will see it: unpacked, in a temporary folder, if all of it is packed."""
    size, total = check_file(path, empty=True), 0
    with path.open("rb") as file, TemporaryDirectory() as folder:
        if file.read(len(ZSTD)) != ZSTD:
            yield path
            return
        plain = Path(folder, path.stem)
        try:
            with zstd.open(path, "rb") as packed, plain.open("wb") as out:
                while block := packed.read(_BLOCK):
                    total += len(block)
                    check_declared(path, total, size)
                    out.write(block)
        except (zstd.ZstdError, EOFError) as error:
            raise InputError(f"{path} is not a readable bag: {str(error).rstrip('.')}.") from None
        yield plain


def take_packed(reader: Any) -> None:
    """Let a reader of a bag leave it to the caller to unpack messages that are packed one by one."""
    for one in (one.storage for one in reader.readers if hasattr(one, "storage")):
        if one.metadata.compression_mode == "message":
            one.metadata = one.metadata._replace(compression_mode=None)


def unpacked_message(data: bytes) -> bytes:
    """The content of a message of ROS 2, which may be packed, as the metadata of its bag say, if they are there.

    >>> unpacked_message(zstd.compress(b"abc")), unpacked_message(b"abc")
    (b'abc', b'abc')
    """
    if data[: len(ZSTD)] != ZSTD:  # nor does any message of ROS 2 begin so
        return data
    try:
        return _unpacked(unpack_zstd, data)
    except zstd.ZstdError as error:
        raise ValueError(str(error)) from None


def bound_chunks(reader: Any) -> None:
    """Let the readers of ROS 1 bags refuse a chunk that unpacks to more than ``MAX_CHUNK`` bytes."""
    table = {rosbag1.decompressors["bz2"]: unpack_bz2, rosbag1.decompressors["lz4"]: unpack_lz4}
    for one in reader.readers:
        for key, chunk in getattr(one, "chunks", {}).items():
            if unpack := table.get(chunk.decompressor):
                one.chunks[key] = chunk._replace(decompressor=lambda data, unpack=unpack: _unpacked(unpack, data))


def _unpacked(unpack: Callable[[bytes], bytes], data: bytes) -> bytes:
    unpacked = unpack(data)
    if len(unpacked) > MAX_CHUNK:
        raise ValueError(f"a chunk unpacks to more than {MAX_CHUNK} bytes")
    return unpacked


def unpack_bz2(data: bytes) -> bytes:
    """As much of a chunk as shows whether it is too large."""
    return bz2.BZ2Decompressor().decompress(data, MAX_CHUNK + 1)


def unpack_lz4(data: bytes) -> bytes:
    """As :func:`unpack_bz2`, of LZ4."""
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK + 1))


def unpack_zstd(data: bytes) -> bytes:
    """As :func:`unpack_bz2`, of Zstandard."""
    return bytes(zstd.ZstdDecompressor().decompress(data, MAX_CHUNK + 1))
