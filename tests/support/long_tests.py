"""The tests that take longest, less than a tenth of all and more than half of the time, in ``long_tests.txt``."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

OPTION = "--long"
HELP = "whether the tests in tests/support/long_tests.txt run: all (default), none, or a part of them alone such as 2/4"


def lines() -> list[list[str]]:
    """Tests and single cases of tests, those together that share what is slow to make."""
    text = (Path(__file__).parent / "long_tests.txt").read_text()
    return [line.split(" + ") for line in text.splitlines() if line and not line.startswith("#")]


def names() -> list[str]:
    """All tests and single cases of tests. No files: a quick test that is added to one would hardly ever run."""
    return [name for line in lines() for name in line]


def chosen(option: str) -> Callable[[str], bool]:
    """Which tests an option of the command line runs, by their name; parts take turns, so that they last as long.

    >>> [[chosen(option)(names()[0]) for option in ("all", "none", "1/2", "2/2")]]
    [[True, False, True, False]]
    """
    if option == "all":
        return lambda _: True
    if option == "none":
        every = set(names())
        return lambda test: not _is_in(test, every)
    found = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", option)
    if not found or int(found[1]) > int(found[2]):
        raise ValueError(f"{OPTION} {option} is unknown; expected all, none, or a part such as 2/4.")
    part = {name for line in lines()[int(found[1]) - 1 :: int(found[2])] for name in line}
    return lambda test: _is_in(test, part)


def _is_in(test: str, some: set[str]) -> bool:
    return test in some or test.partition("[")[0] in some
