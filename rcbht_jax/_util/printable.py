"""Text of other people's files and processes as it may be shown and written."""

from __future__ import annotations

import re
import unicodedata
from io import BufferedIOBase

_BYTES = re.compile("[\udc80-\udcff]")  # what stands for a byte that is not UTF-8 in the name of a file (PEP 383)


def printable(text: str) -> str:
    r"""Text with control characters spelled out: a name must not steer the terminal.

    >>> printable("a\x1b[2J")
    'a\\x1b[2J'
    """
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf") else c.encode("unicode_escape").decode()
        for c in text
    )


def room(text: str) -> int:
    """How many usual letters take as much room: letters of East Asian scripts are twice as wide.

    >>> room("Fz"), room("\ud798")
    (2, 2)
    """
    return sum(1 + (unicodedata.east_asian_width(letter) in "WF") for letter in text)


def padded(text: str, width: int) -> str:
    """Text and blanks that take the room of so many letters.

    >>> padded("Fz", 4), padded("\ud798", 4) == "\ud798  "
    ('Fz  ', True)
    """
    return text + " " * (width - room(text))


def plural(count: int, one: str, many: str = "") -> str:
    """A number of things in words.

    >>> plural(1, "recording"), plural(2, "axis", "axes")
    ('1 recording', '2 axes')
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


def spelled(name: object) -> str:
    r"""A file's name, or a text that quotes it, as text that can be written: bytes that are not UTF-8 are spelled out.

    Accents that are separate characters, as in names that macOS wrote, are composed with their letters (NFC).

    >>> spelled("run-\udcff.csv"), spelled("e\u0301") == "\u00e9"
    ('run-\\xff.csv', True)
    """
    return unicodedata.normalize("NFC", _BYTES.sub(lambda found: f"\\x{ord(found[0]) - 0xDC00:x}", str(name)))


def last_line(report: BufferedIOBase) -> str:
    """The last line that a process wrote to a file; "" = nothing.

    >>> import io
    >>> last_line(io.BytesIO(b"begun\\nno space left\\n"))
    'no space left'
    """
    report.seek(0)
    return (report.read().decode(errors="replace").strip().splitlines() or [""])[-1]
