"""Extension of griffe, which reads the docstrings of the reference pages: Sphinx roles become links.

A name is looked up where it is written. It becomes a link if the reference has it, else plain code.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, GriffeError

ROLE = re.compile(r":[a-z]+:`~?([\w.]+)`")


class Roles(Extension):
    """Replaces the Sphinx roles of every docstring."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Called with each module, class, function and attribute once it is read."""
        if obj.docstring is not None:
            obj.docstring.value = ROLE.sub(lambda match: link(obj, match[1]), obj.docstring.value)


def link(obj: Any, name: str) -> str:
    """A link to a name as it is written in the docstring of an object; plain code where no page has it."""
    first, dot, rest = name.partition(".")
    try:
        target = obj.resolve(first) + dot + rest
    except GriffeError:  # a full name
        target = name
    return f'<autoref optional identifier="{target}"><code>{name}</code></autoref>'
