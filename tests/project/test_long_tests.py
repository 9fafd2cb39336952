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
        assert f"def {test.partition('[')[0]}" in (ROOT / file).read_text(), name


def test_each_runs_in_one_of_four_parts_and_others_in_none() -> None:
    parts = [chosen(f"{part}/4") for part in (1, 2, 3, 4)]
    for name in names():
        assert [part(name) for part in parts].count(True) == 1
        assert chosen("all")(name)
        assert not chosen("none")(name)
    other = "tests/project/test_long_tests.py::test_every_name_is_a_test"
    assert chosen("none")(other)
    assert not any(part(other) for part in parts)


def test_files_and_tests_stand_for_all_that_is_in_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.long_tests.names", lambda: ["a.py", "b.py::test", "c.py::test[1]"])
    runs = chosen("1/1")
    assert [runs(name) for name in ("a.py::test[1]", "b.py::test[1]", "b.py::test", "c.py::test[1]")] == [True] * 4
    assert [runs(name) for name in ("b.py::test_other", "c.py::test[2]", "d.py::test")] == [False] * 3


@pytest.mark.parametrize("option", ["some", "0/3", "4/3", "1/0", ""])
def test_other_options_are_refused(option: str) -> None:
    with pytest.raises(ValueError, match="expected all, none, or a part"):
        chosen(option)
