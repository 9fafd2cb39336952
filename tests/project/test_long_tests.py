"""The list of the longest tests names tests that exist, and every part of it runs some day."""

from __future__ import annotations

from itertools import chain

import pytest

from tests.conftest import ROOT
from tests.support.long_tests import is_in, left_out, names


def test_every_name_is_a_test() -> None:
    every = names()
    assert len(set(every)) == len(every)
    for name in every:
        file, _, test = name.partition("::")
        assert f"def {test.partition('[')[0]}(" in (ROOT / file).read_text(), name


def test_three_parts_run_each_of_them_once() -> None:
    every = set(names())
    ran = [every - left_out(f"{part}/3") for part in (1, 2, 3)]
    assert sorted(chain(*ran)) == sorted(every)
    assert not left_out("all")
    assert left_out("none") == every


def test_cases_are_left_out_one_by_one_or_together() -> None:
    assert is_in("a.py::test[1]", {"a.py::test"})
    assert is_in("a.py::test[1]", {"a.py::test[1]"})
    assert not is_in("a.py::test[1]", {"a.py::test[2]", "a.py::test_other"})


@pytest.mark.parametrize("option", ["some", "0/3", "4/3", "1/0", ""])
def test_other_options_are_refused(option: str) -> None:
    with pytest.raises(ValueError, match="expected all, none, or a part"):
        left_out(option)
