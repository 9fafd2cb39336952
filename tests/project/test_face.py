"""The names of ``rcbht_jax``: each is documented with an example that runs, and nothing is loaded before it is used."""

from __future__ import annotations

import doctest
import subprocess
import sys

import pytest

import rcbht_jax as rj


@pytest.mark.parametrize("name", rj.__all__)
def test_every_name_has_an_example(name: str) -> None:
    """Which runs: test_examples.py."""
    tests = doctest.DocTestFinder(recurse=False).find(getattr(rj, name), name, globs={})
    assert any(test.examples for test in tests), f"{name} has no >>> example"


def test_there_are_few_names_and_they_are_listed() -> None:
    assert 20 <= len(rj.__all__) <= 30
    assert rj.__all__ == sorted(rj._HOME)
    assert set(rj.__all__) <= set(dir(rj))
    with pytest.raises(AttributeError, match="no attribute 'encoder_config'"):
        rj.encoder_config  # noqa: B018


def test_import_loads_nothing_that_is_not_used() -> None:
    code = "import sys, rcbht_jax; print(*sorted(m for m in ('jax', 'numpy', 'sklearn', 'zarr') if m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"
