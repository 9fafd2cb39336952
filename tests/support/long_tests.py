"""The tests that take longest, some five per cent of all and more than half of the time, in ``long_tests.txt``."""

from __future__ import annotations

import re
from pathlib import Path

OPTION = "--long"
HELP = "which of the tests in tests/support/long_tests.txt run: all (default), none, or a part of them such as 2/3"


def names() -> list[str]:
    """Their names, with the case in brackets if only one case of a test is long."""
    lines = (Path(__file__).parent / "long_tests.txt").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def left_out(option: str) -> set[str]:
    """Those that an option of the command line leaves out; parts take turns, so that they last about as long.

    >>> sorted(left_out("1/2") & left_out("2/2"))
    []
    >>> left_out("1/2") | left_out("2/2") == left_out("none")
    True
    """
    if option == "all":
        return set()
    if option == "none":
        return set(names())
    found = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", option)
    if not found or int(found[1]) > int(found[2]):
        raise ValueError(f"{OPTION} {option} is unknown; expected all, none, or a part such as 2/3.")
    part, parts = int(found[1]), int(found[2])
    return {name for at, name in enumerate(names()) if at % parts != part - 1}


def is_in(test: str, tests: set[str]) -> bool:
    """Whether a test, or all cases of it, are among some.

    >>> is_in("a.py::test[1]", {"a.py::test"}), is_in("a.py::test[1]", {"a.py::test[2]"})
    (True, False)
    """
    return test in tests or test.partition("[")[0] in tests
