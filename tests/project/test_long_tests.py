"""The list of the longest tests names tests that exist, and every part of it runs some day."""

from __future__ import annotations

import pytest

from tests.conftest import ROOT
from tests.support.long_tests import chosen, names


def test_every_name_is_a_test() -> None:
    every = names()
    assert len(set(every)) == len(every)
    for name in every:
        file, _, test = name.partition("::")
        assert f"def {test.partition('[')[0]}(" in (ROOT / file).read_text(), name


def test_each_runs_in_one_of_four_parts_and_others_in_none() -> None:
    parts = [chosen(f"{part}/4") for part in (1, 2, 3, 4)]
    for name in names():
        assert [part(name) for part in parts].count(True) == 1
        assert chosen("all")(name)
        assert not chosen("none")(name)
    other = "tests/project/test_long_tests.py::test_every_name_is_a_test"
    assert chosen("none")(other)
    assert not any(part(other) for part in parts)


def test_a_test_stands_for_its_cases_and_a_line_stays_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.long_tests.lines", lambda: [["a.py::test", "a.py::test_two"], ["c.py::test[1]"]])
    ran = ("a.py::test[1]", "a.py::test", "a.py::test_two", "c.py::test[1]")
    others = ("a.py::test_other", "c.py::test[2]", "d.py::test")
    assert [chosen("1/2")(name) for name in ran] == [True] * 3 + [False]
    assert [chosen("2/2")(name) for name in ran] == [False] * 3 + [True]
    assert [chosen("1/1")(name) for name in (*ran, *others)] == [True] * 4 + [False] * 3


@pytest.mark.parametrize("option", ["some", "0/3", "4/3", "1/0", ""])
def test_other_options_are_refused(option: str) -> None:
    with pytest.raises(ValueError, match="expected all, none, or a part"):
        chosen(option)
