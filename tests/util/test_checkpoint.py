"""Checkpoints are resumed by the same work only."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from rcbht_jax._util import checkpoint
from rcbht_jax.errors import InputError


def test_content_comes_back_and_a_missing_file_is_none(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    assert checkpoint.load(path, {"seed": 1}) is None
    checkpoint.save(path, {"seed": 1, "axes": (1, 2)}, [1.5, math.inf])
    assert checkpoint.load(path, {"axes": [1, 2], "seed": 1}) == [1.5, math.inf]


@pytest.mark.parametrize(
    ("known", "wanted", "told"),
    [
        ({"job": {"seed": 1}}, {"job": {"seed": 2}}, "job.seed 1, not 2"),
        ({"job": {}}, {"job": {"seed": 2}}, "job.seed null, not 2"),
        ({"job": {}}, {"job": {"limit": None}}, "one of them alone has job.limit"),
        ({"job": {"limit": None}}, {"job": {}}, "one of them alone has job.limit"),
        ([1], {"seed": 1}, '[1], not {"seed": 1}'),
    ],
)
def test_other_work_is_refused_with_the_value_that_differs(tmp_path: Path, known: Any, wanted: Any, told: str) -> None:
    path = tmp_path / "c.json"
    checkpoint.save(path, known, [])
    with pytest.raises(InputError, match=re.escape(f"other data or options ({told})")):
        checkpoint.load(path, wanted)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"made_by": 1', "\xff"])
def test_a_damaged_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="damaged"):
        checkpoint.load(path, 1)
