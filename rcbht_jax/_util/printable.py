"""Text of other people's files as it may be shown."""

from __future__ import annotations

import unicodedata


def printable(text: str) -> str:
    r"""Text with control characters spelled out: a name must not steer the terminal.

    >>> printable("a\x1b[2J")
    'a\\x1b[2J'
    """
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf") else c.encode("unicode_escape").decode()
        for c in text
    )
