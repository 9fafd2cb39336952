"""Bags whose chunks unpack to far more than they are: refused before, or as, a reader unpacks them."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError

with needs_extra("stream"):
    import lz4.frame  # comes with rosbags, as does zstd
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import storage_mcap

MAX_CHUNK = 2**26  # bytes; recorders write chunks of 1 to 4 MiB
_MCAP_CHUNK = 6


def check_mcap(path: Path) -> None:
    """Unpack every chunk of an MCAP file in bounded memory, without keeping it.

    >>> check_mcap(Path("run.mcap"))  # doctest: +SKIP

    Raises:
        InputError: a chunk declares, or unpacks to, more than ``MAX_CHUNK`` bytes.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(8)
        while len(head := file.read(9)) == 9:
            (length,) = struct.unpack("<Q", head[1:])
            end = file.tell() + length
            if end > size:
                return  # cut off; the reader says so
            if head[0] == _MCAP_CHUNK:
                _check_chunk(path, file, length)
            elif length > MAX_CHUNK:
                raise InputError(f"{path} holds a record of {length} bytes; expected at most {MAX_CHUNK}.")
            file.seek(end)


def _check_chunk(path: Path, file: BinaryIO, length: int) -> None:
    fixed = file.read(min(length, 32))
    if len(fixed) < 32:
        return
    declared, _, name = struct.unpack("<QII", fixed[16:])
    if declared > MAX_CHUNK or length > MAX_CHUNK:
        raise InputError(f"{path} holds a chunk of {max(declared, length)} bytes; expected at most {MAX_CHUNK}.")
    compression = file.read(min(name, 16))
    data = file.read(max(length - 32 - name, 0))[8:]
    try:
        _unpacked({b"lz4": _lz4, b"zstd": _zstd}.get(compression, bytes), data)
    except _TooLarge:
        text = f"{path} holds a chunk that unpacks to more than {MAX_CHUNK} bytes; that is not a recording."
        raise InputError(text) from None
    except Exception:  # damaged; the reader says so
        return


class _TooLarge(ValueError):
    """A chunk unpacks to more than is allowed."""

    def __init__(self) -> None:
        super().__init__(f"a chunk unpacks to more than {MAX_CHUNK} bytes")


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
        raise _TooLarge
    return unpacked


def _bz2(data: bytes) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, MAX_CHUNK + 1)


def _lz4(data: bytes) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK + 1))


def _zstd(data: bytes) -> bytes:
    zstd: Any = vars(storage_mcap)["zstd"]  # of Python 3.14, or a package that stands in for it
    return bytes(zstd.ZstdDecompressor().decompress(data, MAX_CHUNK + 1))
