"""Files of text: unpacked if compressed, in UTF-8 where they are in UTF-16; the encoding of others, by their bytes."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import re
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, BinaryIO, cast

from rcbht_jax._util.untrusted import MAX_RATIO, MAX_TABLE_LINE, MAX_TEXT_BYTES, SMALL, check_file
from rcbht_jax.errors import InputError

PACKED: dict[str, Callable[[IO[bytes]], io.BufferedIOBase]] = {  # by the end of the name
    ".gz": lambda file: gzip.GzipFile(fileobj=file),
    ".bz2": bz2.BZ2File,
}
_BLOCK = 2**20  # bytes that are read together
ENCODINGS = {  # how people call them
    "cp1252": "Windows-1252", "cp932": "Shift-JIS", "gb18030": "GB 18030", "cp1251": "Windows-1251",
}  # fmt: skip
_PAIRS = re.compile(rb"[\x81-\x9f\xe0-\xfc][\x40-\x7e\x80-\xfc]")
_CYRILLIC = re.compile(rb"(?<![A-Za-z\x80-\xff])[\xc0-\xff\xa8\xb8]{2,}(?![A-Za-z\x80-\xff])")  # a word of its own
_ACCENTED = re.compile(rb"[A-Za-z][\xc0-\xff]|[\xc0-\xff][A-Za-z]")
_HIGH = re.compile(rb"[\x80-\xff]+")


def plain_name(name: str) -> str:
    """The name of the file that a compressed one holds.

    >>> plain_name("day1/run.csv.gz"), plain_name("run.csv")
    ('day1/run.csv', 'run.csv')
    """
    stem, dot, ending = name.rpartition(".")
    return stem if f"{dot}{ending.lower()}" in PACKED else name


@contextmanager
def opened(path: Path, most: int = MAX_TEXT_BYTES) -> Iterator[BinaryIO]:
    """The content of a file of text, compressed if its name ends so; what is unpacked lies in a temporary file.

    It may have ``most`` bytes, packed and unpacked.

    >>> with gzip.open("run.csv.gz", "wt") as packed:
    ...     _ = packed.write("t,Fz")
    >>> with opened(Path("run.csv.gz")) as file:
    ...     file.read()
    b't,Fz'

    Raises:
        InputError: not a regular file, too large, damaged, or it cannot be read.
    """
    size = check_file(path, most)
    try:
        with ExitStack() as stack:
            file: IO[bytes] = stack.enter_context(path.open("rb"))
            if unpacker := PACKED.get(path.suffix.lower()):
                copy = stack.enter_context(tempfile.TemporaryFile())
                _unpack(path, unpacker(file), copy, min(most, max(SMALL, MAX_RATIO * size)))
                file = copy
            if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
                copy = stack.enter_context(tempfile.TemporaryFile())
                _recode(path, file, copy)
                file = copy
            file.seek(0)
            yield cast("BinaryIO", file)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error


def line_of(file: BinaryIO, path: Path) -> bytes:
    """The next line of a table, with its end; empty where the file ends.

    >>> _ = Path("a.csv").write_text("t,Fz\\n0,1.5")
    >>> with open("a.csv", "rb") as file:
    ...     line_of(file, Path("a.csv")), line_of(file, Path("a.csv"))
    (b't,Fz\\n', b'0,1.5')

    Raises:
        InputError: it is too long.
    """
    line = file.readline(MAX_TABLE_LINE)
    if len(line) == MAX_TABLE_LINE and not line.endswith(b"\n"):
        raise InputError(f"{path} has a line of more than {MAX_TABLE_LINE} bytes; expected line feeds.")
    return line


def _unpack(path: Path, packed: io.BufferedIOBase, copy: IO[bytes], most: int) -> None:
    try:
        while block := packed.read(_BLOCK):
            copy.write(block)
            if copy.tell() > most:
                raise InputError(f"{path} unpacks to more than {most} bytes; split it.")
    except InputError:
        raise
    except (EOFError, ValueError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path} is damaged, or not packed as its name says: {error}.") from None
    copy.seek(0)


def _recode(path: Path, file: IO[bytes], copy: IO[bytes]) -> None:
    """Copy a file of UTF-16 in UTF-8."""
    file.seek(0)
    text = io.TextIOWrapper(cast("BinaryIO", file), "utf-16", newline="")
    try:
        while block := text.read(_BLOCK):
            copy.write(block.encode())
    except UnicodeError:
        raise InputError(f"{path} begins as UTF-16 does and is damaged; save it as UTF-8.") from None
    finally:
        text.detach()


def encoding_of(file: BinaryIO) -> str:
    """The encoding of a whole file, whose position becomes its beginning.

    >>> def of(text, encoding):
    ...     _ = Path("a.csv").write_bytes(text.encode(encoding))
    ...     with open("a.csv", "rb") as file:
    ...         return encoding_of(file)
    >>> of("力 [N], 時間", "utf-8"), of("力 [N], 時間", "cp932"), of("力 [N], 时间", "gb18030"), of("Fügen", "cp1252")
    ('utf-8-sig', 'cp932', 'gb18030', 'cp1252')
    >>> of("Время, мс; Fz, Н", "cp1251")
    'cp1251'
    """
    decoder, encoding = codecs.getincrementaldecoder("utf-8-sig")(), "utf-8-sig"
    block = b""
    try:
        while block := file.read(_BLOCK):
            decoder.decode(block)  # the last sign may be cut
    except UnicodeDecodeError:
        encoding = _other(block)
    file.seek(0)
    return encoding


def doubts(name: str, notes: Iterable[str]) -> list[tuple[str, str]]:
    """A warning about a file of words, by its notes, if it is not UTF-8.

    >>> doubts("runs.csv", ["cp1252"])
    [('runs.csv', 'is not UTF-8 and was read as Windows-1252; if words are garbled, save it as UTF-8.')]
    """
    how = "if words are garbled, save it as UTF-8."
    return [(name, f"is not UTF-8 and was read as {ENCODINGS[note]}; {how}") for note in notes if note in ENCODINGS]


def _other(block: bytes) -> str:
    """The encoding of bytes that are not UTF-8: signs of two bytes each, which seldom fit Western words, or those."""
    runs = _HIGH.findall(block)
    if max(map(len, runs), default=0) >= 4 and all(len(run) % 2 == 0 and min(run) >= 0xA1 for run in runs):
        return "gb18030"
    leads = [pair[0] for pair in _PAIRS.findall(block)]
    rare = sum(lead <= 0x9F for lead in leads)  # dashes, quotes and the like in Windows-1252
    if rare > 1 and 2 * rare >= len(leads) and _decodes(block, "cp932"):
        return "cp932"
    # accented letters of Western words stand beside plain ones
    return "cp1251" if _CYRILLIC.search(block) and not _ACCENTED.search(block) else "cp1252"


def _decodes(block: bytes, encoding: str) -> bool:
    """Whether bytes are text in an encoding; the last sign may be cut."""
    try:
        codecs.getincrementaldecoder(encoding)().decode(block)
    except UnicodeDecodeError:
        return False
    return True
