"""The tests that take longest, less than a tenth of all and more than half of the time, in ``long_tests.txt``."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

OPTION = "--long"
HELP = "whether the tests in tests/support/long_tests.txt run: all (default), none, or a part of them alone such as 2/4"


def names() -> list[str]:
    """Files, tests, and single cases of tests."""
    lines = (Path(__file__).parent / "long_tests.txt").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


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
    part = set(names()[int(found[1]) - 1 :: int(found[2])])
    return lambda test: _is_in(test, part)


def _is_in(test: str, some: set[str]) -> bool:
    return test in some or test.partition("[")[0] in some or test.partition("::")[0] in some
