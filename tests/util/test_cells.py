"""Cells that a spreadsheet would run are text, and come back as they were."""

from __future__ import annotations

import hypothesis.strategies as st
import pytest
from hypothesis import given

from rcbht_jax._util.cells import cell, text_of


@given(st.text("'=+-@\t\r\nA1(|.", max_size=6) | st.text())
def test_what_is_written_comes_back(text: str) -> None:
    assert text_of(cell(text)) == text


@pytest.mark.parametrize(
    "text", ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+HYPERLINK(A1)", "\t=1", "'=1", "=", "+x\n"]
)
def test_a_formula_is_text(text: str) -> None:
    assert cell(text) == f"'{text}"


@pytest.mark.parametrize("value", ["+x-y+r", "-0.5", "-1e-05", "+", "a=b", "", "'tis", 1.5, -1, None])
def test_everything_else_is_as_it_was(value: object) -> None:
    assert cell(value) == value
