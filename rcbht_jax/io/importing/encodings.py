"""The encoding of a text, by its bytes: UTF-8, or what spreadsheets write in Japan, China and Europe."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable
from typing import BinaryIO

BLOCK = 2**20  # bytes that are looked at together
WORDS = {  # how people call them
    "cp1252": "Windows-1252", "cp932": "Shift-JIS", "gb18030": "GB 18030", "cp1251": "Windows-1251",
}  # fmt: skip
_PAIRS = re.compile(rb"[\x81-\x9f\xe0-\xfc][\x40-\x7e\x80-\xfc]")
_CYRILLIC = re.compile(rb"(?<![A-Za-z\x80-\xff])[\xc0-\xff\xa8\xb8]{2,}(?![A-Za-z\x80-\xff])")  # a word of its own
_ACCENTED = re.compile(rb"[A-Za-z][\xc0-\xff]|[\xc0-\xff][A-Za-z]")
_HIGH = re.compile(rb"[\x80-\xff]+")


def encoding_of(file: BinaryIO) -> str:
    """The encoding of a whole file, whose position becomes its beginning.

    >>> from pathlib import Path
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
        while block := file.read(BLOCK):
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
    return [(name, f"is not UTF-8 and was read as {WORDS[note]}; {how}") for note in notes if note in WORDS]


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
