"""The encoding of a text, by its bytes: UTF-8, or what spreadsheets write in Japan, China and Western Europe."""

from __future__ import annotations

import codecs
import re
from typing import BinaryIO

BLOCK = 2**20  # bytes that are looked at together
WORDS = {"cp1252": "Windows-1252", "cp932": "Shift-JIS", "gb18030": "GB 18030"}  # how people call them
_PAIRS = re.compile(rb"[\x81-\x9f\xe0-\xfc][\x40-\x7e\x80-\xfc]")
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
    """
    decoder, encoding = codecs.getincrementaldecoder("utf-8-sig")(), "utf-8-sig"
    block = b""
    try:
        while block := file.read(BLOCK):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        encoding = _other(block)
    file.seek(0)
    return encoding


def _other(block: bytes) -> str:
    """The encoding of bytes that are not UTF-8: signs of two bytes each, which seldom fit Western words, or those."""
    runs = _HIGH.findall(block)
    if max(map(len, runs), default=0) >= 4 and all(len(run) % 2 == 0 and min(run) >= 0xA1 for run in runs):
        return "gb18030"
    leads = [pair[0] for pair in _PAIRS.findall(block)]
    rare = sum(lead <= 0x9F for lead in leads)  # dashes, quotes and the like in Windows-1252
    return "cp932" if rare > 1 and 2 * rare >= len(leads) and _decodes(block, "cp932") else "cp1252"


def _decodes(block: bytes, encoding: str) -> bool:
    """Whether bytes are text in an encoding; the last sign may be cut."""
    try:
        codecs.getincrementaldecoder(encoding)().decode(block)
    except UnicodeDecodeError:
        return False
    return True
