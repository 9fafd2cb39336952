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
from typing import BinaryIO, NamedTuple

from rcbht_jax._util.untrusted import MAX_BAG_BYTES, MAX_CHANNELS, MAX_CHUNK, MAX_SCHEMA, check_declared, check_file
from rcbht_jax.errors import InputError
from rcbht_jax.io.bag_chunks import unpack_lz4, unpack_zstd

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 2, 3, 4, 5, 6, 7, 8, 0x0B, 0x0F
_HEAD = 9  # bytes of kind and length
_BLOCK = 2**20


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
    """Write the checksums of a complete MCAP file, which rosbags leaves out.

    >>> seal(Path("run.mcap"))  # doctest: +SKIP
    """
    with path.open("rb+") as file:
        places: list[tuple[int, int]] = []
        for kind, at, length in _records(path, file):
            if kind == CHUNK:
                places.append((at + 24, zlib.crc32(_chunk(file, at, length).content)))
            elif kind == DATA_END:
                _patch(file, places)
                _patch(file, [(at, _crc(file, 0, at - _HEAD))])
            elif kind == FOOTER:
                (summary,) = _numbers(file, at, "<Q")
                _patch(file, [(at + 16, _crc(file, summary or at - _HEAD, at + 16))])


@contextmanager
def sound(path: Path) -> Iterator[tuple[Path, list[str]]]:
    """A readable MCAP file and its problems: the file itself, or a copy of the intact parts of a damaged one.

    The copy, in a folder for temporary files, holds every chunk that is complete and agrees with its checksum.

    >>> with sound(Path("run.mcap")) as (path, problems):  # doctest: +SKIP
    ...     print(problems)

    Raises:
        InputError: not a regular file, too large, or a chunk or record of it is; nothing is unpacked beyond that.
    """
    size = check_file(path, MAX_BAG_BYTES, empty=True)
    with path.open("rb") as file:
        # The reader reports a file that is no MCAP.
        problems = _problems(path, file, size) if file.read(len(MAGIC)) == MAGIC else []
        if not problems:
            yield path, []
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder, path.name)
            with copy.open("wb") as out:
                _copy_whole(path, file, out)
            yield copy, problems


def _problems(path: Path, file: BinaryIO, size: int) -> list[str]:
    """Problems of a file, in a few words each; needs the memory of one chunk."""
    problems: Counter[str] = Counter()
    kinds: Counter[int] = Counter()  # records outside and inside of chunks
    unpacked = 0
    stated: int | None = None
    try:
        for kind, at, length in _records(path, file):
            kinds[kind] += 1
            _check_schema(path, kind, length)
            if kind == CHUNK:
                if (found := _chunk_and_kinds(path, file, at, length)) is None:
                    problems["damaged chunks"] += 1
                    continue
                chunk, inside = found
                kinds += inside
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
    return [f"{what}: {count}" if "chunks" in what else what for what, count in problems.items() if count]


def _chunk_and_kinds(path: Path, file: BinaryIO, at: int, length: int) -> tuple[_Chunk, Counter[int]] | None:
    """A chunk, and how many records of each kind it holds; None = it is damaged.

    Raises:
        InputError: it, or the description of a message in it, is larger than is allowed.
    """
    try:
        chunk = _chunk(file, at, length)
        inside = [(kind, size) for kind, _, size in _inside(chunk.content)]
    except _TooLarge as error:
        raise InputError(f"{path} holds {error}; expected at most {MAX_CHUNK}. That is not a recording.") from None
    except ValueError:
        return None
    for kind, size in inside:
        _check_schema(path, kind, size)
    return chunk, Counter(kind for kind, _ in inside)


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


def _copy_whole(path: Path, file: BinaryIO, out: BinaryIO) -> None:
    """Write the intact records of a damaged file as a valid one, with a new index."""
    out.write(MAGIC)
    chunks: list[bytes] = []
    described = _described(path, file)  # they are also in the first chunk, which may be lost
    counts: Counter[int] = Counter()
    first, last = 2**63, 0

    def keep(chunk: _Chunk) -> None:
        nonlocal first, last
        messages = _indexed(chunk.content, described)
        chunks.append(_write_chunk(out, chunk, messages))
        for channel, entries in messages.items():
            counts[channel] += len(entries)
            first = min(first, *(time for time, _ in entries))
            last = max(last, *(time for time, _ in entries))

    try:
        for number, (kind, at, length) in enumerate(_records(path, file)):
            if kind == CHUNK:
                with suppress(ValueError):
                    chunk = _chunk(file, at, length)
                    if chunk.crc in (0, zlib.crc32(chunk.content)):
                        keep(chunk)
            elif kind in (SCHEMA, CHANNEL, MESSAGE) or not number:  # the header, or a file without chunks
                content = _content(file, at, length)
                if kind in (SCHEMA, CHANNEL):
                    described[_record(kind, content)] = None
                out.write(_record(kind, content))
            elif kind == DATA_END:
                break
    except _Cut as end:
        if (rest := _beginning(file, end.at)) is not None:
            keep(rest)
    out.write(_record(DATA_END, bytes(4)))
    start = out.tell() if chunks else 0
    if chunks:
        table = b"".join(struct.pack("<HQ", *one) for one in sorted(counts.items()))
        statistics = struct.pack("<QHIIIIQQI", counts.total(), 0, 0, 0, 0, len(chunks), first, last, len(table))
        out.write(b"".join([*described, *chunks, _record(STATISTICS, statistics + table)]))
    out.write(_record(FOOTER, struct.pack("<QQI", start, 0, 0)) + MAGIC)


def _beginning(file: BinaryIO, at: int) -> _Chunk | None:
    """The messages at the beginning of the chunk in which a file was cut off; None = there are none, or not known."""
    size = file.seek(0, 2)
    if _content(file, size - len(MAGIC), len(MAGIC)) == MAGIC:
        return None  # not cut: data are missing before this place, so that messages after it may be wrong
    content = _content(file, at, min(size - at, MAX_CHUNK))
    if len(content) < _HEAD + 40 or content[0] != CHUNK or content[_HEAD + 28 : _HEAD + 32] != bytes(4):
        return None  # of compressed chunks nothing is read
    data, whole = content[_HEAD + 40 :], 0
    with suppress(ValueError):
        for _, start, length in _inside(data):
            whole = start + length
    return _Chunk(0, data[:whole]) if whole else None


def _check_schema(path: Path, kind: int, length: int) -> None:
    """Raise an error for a description of a message that would take minutes to parse."""
    if kind == SCHEMA and length > MAX_SCHEMA:
        raise InputError(f"{path} describes a message in {length} bytes; expected at most {MAX_SCHEMA}.")


def _described(path: Path, file: BinaryIO) -> dict[bytes, None]:
    """The schemas and channels in the index at the end, if there is one."""
    found: dict[bytes, None] = {}
    size = file.seek(0, 2)
    (begin,) = _numbers(file, max(size - 28, 0), "<Q")
    try:
        for kind, at, length in _records(path, file, begin) if 0 < begin < size else ():
            if kind in (SCHEMA, CHANNEL):
                found[_record(kind, _content(file, at, length))] = None
    except (_Cut, InputError):  # it is no index
        return {}
    return found


def _indexed(content: bytes, described: dict[bytes, None]) -> dict[int, list[tuple[int, int]]]:
    """By channel, time and place of each message of a chunk; schemas and channels are added to ``described``."""
    messages: dict[int, list[tuple[int, int]]] = {}
    for kind, at, length in _inside(content):
        if kind in (SCHEMA, CHANNEL):
            described[content[at - _HEAD : at + length]] = None
        elif kind == MESSAGE:
            channel, _, time = struct.unpack_from("<HIQ", content, at)
            messages.setdefault(channel, []).append((time, at - _HEAD))
    return messages


def _write_chunk(out: BinaryIO, chunk: _Chunk, messages: dict[int, list[tuple[int, int]]]) -> bytes:
    """Write a chunk, not compressed, and its index; returns the record that the index at the end has of it."""
    times = [time for entries in messages.values() for time, _ in entries] or [0]
    span = struct.pack("<QQ", min(times), max(times))
    size = len(chunk.content)
    crc = zlib.crc32(chunk.content)
    begin = out.tell()
    out.write(_record(CHUNK, span + struct.pack("<QIIQ", size, crc, 0, size) + chunk.content))
    end, offsets = out.tell(), b""
    for channel, entries in messages.items():
        offsets += struct.pack("<HQ", channel, out.tell())
        table = b"".join(struct.pack("<QQ", *entry) for entry in entries)
        out.write(_record(INDEX, struct.pack("<HI", channel, len(table)) + table))
    places = struct.pack("<QQI", begin, end - begin, len(offsets)) + offsets
    return _record(CHUNK_INDEX, span + places + struct.pack("<QIQQ", out.tell() - end, 0, size, size))


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


def _record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


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


def _patch(file: BinaryIO, places: list[tuple[int, int]]) -> None:
    for at, number in places:
        file.seek(at)
        file.write(struct.pack("<I", number))
    file.flush()
