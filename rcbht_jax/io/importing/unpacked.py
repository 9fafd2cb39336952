"""Files of text as they are read: unpacked if compressed, in UTF-8 where they are in UTF-16."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, BinaryIO, cast

from rcbht_jax._util.untrusted import MAX_RATIO, MAX_TABLE_LINE, MAX_TEXT_BYTES, SMALL, check_file
from rcbht_jax.errors import InputError

PACKED: dict[str, Callable[[IO[bytes]], io.BufferedIOBase]] = {  # by the end of the name
    ".gz": lambda file: gzip.GzipFile(fileobj=file),
    ".bz2": bz2.BZ2File,
}
_BLOCK = 2**20


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
