"""Text that is shown: of other people's files and processes, of numbers of things, of what a task leaves out."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from io import BufferedIOBase

INTERVALS = "intervals, "  # how a reason begins that counts intervals of trials which are used, not trials
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


def reasons_of(dropped: Mapping[str, int]) -> list[tuple[str, str]]:
    """How much is left out, and why.

    >>> reasons_of({"outcome unknown": 2, "intervals, class in one trial only: peg": 1})
    [('2 trials', 'outcome unknown'), ('1 interval', 'class in one trial only: peg')]
    """
    return [
        (plural(count, "interval" if reason.startswith(INTERVALS) else "trial"), reason.removeprefix(INTERVALS))
        for reason, count in dropped.items()
    ]


def left_out(dropped: Mapping[str, int]) -> str:
    """The same as a sentence that follows others; "" = nothing is left out.

    >>> left_out({"outcome unknown": 2}), left_out({})
    (' Left out: 2 trials (outcome unknown).', '')
    """
    return f" Left out: {', '.join(f'{what} ({why})' for what, why in reasons_of(dropped))}." if dropped else ""


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
