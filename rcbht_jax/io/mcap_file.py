"""MCAP files as records: limits, checksums, and recovery of damaged files. Rosbags reads the content.

An MCAP is the magic, records of one byte (kind), eight (length) and content, and the magic again. Messages are in
chunks, which an index at the end lists. Each chunk, all data, and the index may have a CRC-32.
"""

from __future__ import annotations

import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from rcbht_jax._util.optional import needs_extra
from rcbht_jax._util.untrusted import MAX_BAG_BYTES, MAX_CHANNELS, MAX_CHUNK, MAX_SCHEMA, check_declared, check_file
from rcbht_jax.errors import InputError
from rcbht_jax.io.bag_chunks import unpack_lz4, unpack_zstd

with needs_extra("stream"):
    from rosbags.rosbag2 import StoragePlugin, Writer

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, STATISTICS, DATA_END = 1, 2, 3, 4, 5, 6, 0x0B, 0x0F
_HEAD = 9  # bytes of kind and length
_BLOCK = 2**20
_LANGUAGES = ("ros2msg", "ros2idl", "omgidl")  # of definitions of messages of ROS 2
_IDL = f"{'=' * 80}\nIDL: "  # how definitions in this language begin, by which the writer knows them


class _Cut(Exception):
    """No whole record begins at ``at``."""

    def __init__(self, at: int) -> None:
        super().__init__()
        self.at = at


class _Chunk(NamedTuple):
    """A chunk, unpacked."""

    crc: int  # stored; 0 = none
    content: bytes


def seal(path: Path) -> None:
    """Write the checksums of a complete MCAP file, which rosbags leaves out."""
    with path.open("rb+") as file:
        for kind, at, length in _records(path, file):
            if kind == CHUNK:
                _patch(file, at + 24, zlib.crc32(_chunk(file, at, length).content))
            elif kind == DATA_END:
                _patch(file, at, _crc(file, 0, at - _HEAD))
            elif kind == FOOTER:
                (summary,) = _numbers(file, at, "<Q")
                _patch(file, at + 16, _crc(file, summary or at - _HEAD, at + 16))


@contextmanager
def sound(path: Path) -> Iterator[tuple[Path, list[str]]]:
    """A readable MCAP file and its problems: the file itself, or a copy, in a folder for temporary files.

    Of a damaged file, the copy holds the messages of every chunk that is complete and agrees with its checksum; of a
    file with other messages than those of ROS 2, it holds those of ROS 2.

    Raises:
        InputError: not a regular file, too large, or a chunk or record of it is; nothing is unpacked beyond that.
    """
    size = check_file(path, MAX_BAG_BYTES, empty=True)
    with path.open("rb") as file:
        # The reader reports a file that is no MCAP.
        problems, foreign = _problems(path, file, size) if file.read(len(MAGIC)) == MAGIC else ([], False)
        if not problems and not foreign:
            yield path, []
            return
        with tempfile.TemporaryDirectory() as folder:
            yield _copied(path, file, Path(folder)), problems


def _problems(path: Path, file: BinaryIO, size: int) -> tuple[list[str], bool]:
    """Problems of a file, in a few words each, and whether it is not of ROS 2 alone; needs the memory of one chunk."""
    problems: Counter[str] = Counter()
    kinds: Counter[int] = Counter()  # records outside and inside of chunks
    unpacked, foreign = 0, False
    stated: int | None = None
    try:
        for kind, at, length in _records(path, file):
            kinds[kind] += 1
            _check_schema(path, kind, length)
            if kind in (HEADER, SCHEMA):
                foreign |= _is_foreign(kind, _content(file, at, length))
            elif kind == CHUNK:
                if (found := _chunk_and_records(path, file, at, length)) is None:
                    problems["damaged chunks"] += 1
                    continue
                chunk, inside = found
                kinds.update(one for one, *_ in inside)
                foreign |= any(_is_foreign(one, chunk.content[at:][:size]) for one, at, size in inside if one == SCHEMA)
                unpacked += len(chunk.content)
                check_declared(path, min(unpacked, 2 * size), size)
                problems["chunks with a wrong checksum"] += chunk.crc not in (0, zlib.crc32(chunk.content))
            elif kind == DATA_END and length >= 4:
                problems["the data do not match their checksum"] += not _data_match(file, at)
            elif kind == STATISTICS and length >= 8:
                (stated,) = _numbers(file, at, "<Q")
            elif kind == FOOTER and length == 20:
                problems["the index does not match its checksum"] += not _index_matches(file, at)
            if kinds[SCHEMA] + kinds[CHANNEL] > MAX_CHANNELS:
                raise InputError(f"{path} describes more than {MAX_CHANNELS} channels; that is not a recording.")
    except _Cut:
        problems["the file is cut off, or damaged in the middle"] += 1
    if stated not in (None, kinds[MESSAGE]) and not problems.total():
        problems[f"{kinds[MESSAGE]} messages were found where {stated} were written"] += 1
    words = [f"{what}: {count}" if "chunks" in what else what for what, count in problems.items() if count]
    return words, foreign


def _is_foreign(kind: int, content: bytes) -> bool:
    """Whether a header or a schema is not of ROS 2; a damaged one is left to the reader."""
    try:
        return _texts(content, 1) != ["ros2"] if kind == HEADER else _texts(content[2:], 2)[1] not in ("", *_LANGUAGES)
    except (ValueError, struct.error):
        return False


def _chunk_and_records(
    path: Path, file: BinaryIO, at: int, length: int
) -> tuple[_Chunk, list[tuple[int, int, int]]] | None:
    """A chunk, and kind, place and length of its records; None = it is damaged."""
    try:
        chunk = _chunk(file, at, length)
        inside = list(_inside(chunk.content))
    except _TooLarge as error:
        raise InputError(f"{path} holds {error}; expected at most {MAX_CHUNK}. That is not a recording.") from None
    except ValueError:
        return None
    for kind, _, size in inside:
        _check_schema(path, kind, size)
    return chunk, inside


def _data_match(file: BinaryIO, at: int) -> bool:
    """Whether the data have the checksum, if any, that their end states, whose content is at ``at``."""
    (crc,) = _numbers(file, at, "<I")
    first = len(MAGIC) + _HEAD + _numbers(file, len(MAGIC) + 1, "<Q")[0]  # behind the header
    starts = (0, len(MAGIC), first)  # writers disagree on whether the magic and the header are data
    return not crc or any(_crc(file, start, at - _HEAD) == crc for start in starts)


def _index_matches(file: BinaryIO, at: int) -> bool:
    """Whether the index has the checksum, if any, that the footer states, whose content is at ``at``."""
    summary, _, crc = _numbers(file, at, "<QQI")
    begin = summary or at - _HEAD
    return begin <= at and (not crc or _crc(file, begin, at + 16) == crc)


def _copied(path: Path, file: BinaryIO, folder: Path) -> Path:
    """A file in a folder with the intact messages of a damaged one, by the writer, which makes a new index."""
    schemas: dict[int, list[str]] = {}  # name, encoding and definition
    connections: dict[int, Any] = {}
    made: dict[tuple[str, ...], Any] = {}  # several publishers of one topic become one
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for kind, content in _intact(path, file):
            if kind == MESSAGE:
                channel, _, time, _ = struct.unpack_from("<HIQQ", content)
                if channel in connections:
                    writer.write(connections[channel], time, content[22:])
                continue
            with suppress(ValueError, struct.error):  # a damaged description
                (number,) = struct.unpack_from("<H", content)
                if kind == SCHEMA:
                    schemas[number] = _texts(content[2:], 3)
                    continue
                topic, encoding = _texts(content[4:], 2)
                (schema,) = struct.unpack_from("<H", content, 2)
                name, language, text = schemas.get(schema, ["", "", ""])
                if encoding != "cdr" or language not in _LANGUAGES:
                    continue
                if language != "ros2msg" and not text.startswith(_IDL):
                    text = f"{_IDL}{name}\n{text}"
                key = topic, name
                made[key] = made.get(key) or writer.add_connection(topic, name, msgdef=text, rihs01="unknown")
                connections[number] = made[key]
    return folder / "bag" / "bag.mcap"


def _texts(content: bytes, count: int) -> list[str]:
    """The texts with which a record goes on, each after its length."""
    found, at = list[str](), 0
    for _ in range(count):
        (length,) = struct.unpack_from("<I", content, at)
        at += 4 + length
        found.append(content[at - length : at].decode())
    return found


def _intact(path: Path, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Kind and content of the schemas, channels and messages in what is intact of a file."""
    yield from _described(path, file)  # they are also in the first chunk, which may be lost
    try:
        for kind, at, length in _records(path, file):
            if kind == CHUNK:
                with suppress(ValueError):
                    chunk = _chunk(file, at, length)
                    if chunk.crc in (0, zlib.crc32(chunk.content)):
                        yield from _members(chunk.content)
            elif kind in (SCHEMA, CHANNEL) or (kind == MESSAGE and length >= 22):
                yield kind, _content(file, at, length)
            elif kind == DATA_END:
                return
    except _Cut as end:
        yield from _members(_beginning(file, end.at))


def _members(chunk: bytes) -> list[tuple[int, bytes]]:
    """Kind and content of the schemas, channels and messages of a chunk; ValueError: it does not consist of records."""
    records = [(kind, chunk[at : at + length]) for kind, at, length in _inside(chunk)]
    return [(kind, content) for kind, content in records if kind in (SCHEMA, CHANNEL, MESSAGE)]


def _beginning(file: BinaryIO, at: int) -> bytes:
    """The whole records at the beginning of the chunk in which a file was cut off, as far as they can be known."""
    size = file.seek(0, 2)
    if _content(file, size - len(MAGIC), len(MAGIC)) == MAGIC:
        return b""  # not cut: data are missing before this place, so that messages after it may be wrong
    content = _content(file, at, min(size - at, MAX_CHUNK))
    if len(content) < _HEAD + 40 or content[0] != CHUNK or content[_HEAD + 28 : _HEAD + 32] != bytes(4):
        return b""  # of compressed chunks nothing is read
    data, whole = content[_HEAD + 40 :], 0
    with suppress(ValueError):
        for _, start, length in _inside(data):
            whole = start + length
    return data[:whole]


def _check_schema(path: Path, kind: int, length: int) -> None:
    """Raise an error for a description of a message that would take minutes to parse."""
    if kind == SCHEMA and length > MAX_SCHEMA:
        raise InputError(f"{path} describes a message in {length} bytes; expected at most {MAX_SCHEMA}.")


def _described(path: Path, file: BinaryIO) -> list[tuple[int, bytes]]:
    """Kind and content of the schemas and channels in the index at the end, if there is one."""
    size = file.seek(0, 2)
    (begin,) = _numbers(file, max(size - 28, 0), "<Q")
    try:
        records = list(_records(path, file, begin)) if 0 < begin < size else []
    except (_Cut, InputError):  # it is no index
        return []
    return [(kind, _content(file, at, length)) for kind, at, length in records if kind in (SCHEMA, CHANNEL)]


def _records(path: Path, file: BinaryIO, at: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
    """Kind, place and length of the content of every record of a file from a place on, up to its footer.

    Raises:
        _Cut: what follows is no whole record.
        InputError: a record is too large.
    """
    size = file.seek(0, 2)
    while True:
        file.seek(at)
        head = file.read(_HEAD)
        if len(head) < _HEAD:
            raise _Cut(at)
        kind, length = struct.unpack("<BQ", head)
        if kind == 0 or at + _HEAD + length > size:
            raise _Cut(at)
        if length > MAX_CHUNK:
            raise InputError(f"{path} holds a record of {length} bytes; expected at most {MAX_CHUNK}.")
        yield kind, at + _HEAD, length
        at += _HEAD + length
        if kind == FOOTER:
            file.seek(at)
            if file.read(len(MAGIC) + 1) != MAGIC:
                raise _Cut(at)
            return


def _inside(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, place and length of the content of every record of a chunk.

    Raises:
        ValueError: it does not consist of records.
    """
    at = 0
    while at < len(content):
        if at + _HEAD > len(content):
            raise ValueError("a chunk ends within a record")
        kind, length = struct.unpack_from("<BQ", content, at)
        at += _HEAD
        if at + length > len(content) or kind in (0, CHUNK) or (kind == MESSAGE and length < 22):
            raise ValueError("a chunk does not consist of records")
        yield kind, at, length
        at += length


class _TooLarge(ValueError):
    """A chunk is larger than is allowed."""


def _chunk(file: BinaryIO, at: int, length: int) -> _Chunk:
    """Unpack a chunk, in bounded memory.

    Raises:
        ValueError: it is damaged, or declares, or unpacks to, more than ``MAX_CHUNK`` bytes.
    """
    content = _content(file, at, length)
    if length < 40:
        raise ValueError("a chunk is too short")
    _, _, declared, crc, named = struct.unpack_from("<QQQII", content)
    if declared > MAX_CHUNK:
        raise _TooLarge(f"a chunk of {declared} bytes")
    if named > 16 or 40 + named > length:
        raise ValueError("the compression of a chunk has no name")
    compression = content[32 : 32 + named]
    (packed,) = struct.unpack_from("<Q", content, 32 + named)
    data = content[40 + named : 40 + named + packed]
    if compression not in _UNPACK:
        raise ValueError("a chunk has an unknown compression")
    try:
        unpacked = _UNPACK[compression](data)
    except Exception as error:  # a damaged chunk fails in any way inside the libraries
        raise ValueError("a chunk cannot be unpacked") from error
    if len(unpacked) > MAX_CHUNK:
        raise _TooLarge(f"a chunk that unpacks to more than {MAX_CHUNK} bytes")
    if len(unpacked) != declared:
        raise ValueError("a chunk has another size than it declares")
    return _Chunk(crc, unpacked)


_UNPACK: dict[bytes, Callable[[bytes], bytes]] = {b"": bytes, b"lz4": unpack_lz4, b"zstd": unpack_zstd}


def _content(file: BinaryIO, at: int, length: int) -> bytes:
    file.seek(at)
    return file.read(length)


def _numbers(file: BinaryIO, at: int, form: str) -> tuple[int, ...]:
    content = _content(file, at, struct.calcsize(form))
    return struct.unpack(form, content) if len(content) == struct.calcsize(form) else (0,) * len(form[1:])


def _crc(file: BinaryIO, start: int, stop: int) -> int:
    """CRC-32 of a part of a file."""
    file.seek(start)
    crc, left = 0, stop - start
    while left > 0 and (block := file.read(min(left, _BLOCK))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    return crc


def _patch(file: BinaryIO, at: int, number: int) -> None:
    file.seek(at)
    file.write(struct.pack("<I", number))
