"""A model of beliefs in a file, and programs that stay out of the user's cache."""

from __future__ import annotations

from pathlib import Path

import pytest

from rcbht_jax._util import compile_cache
from rcbht_jax.introspection import model as model_files
from tests.support.command_line import CommandLine
from tests.support.introspection_models import model


@pytest.fixture(autouse=True)
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs of these tests stay out of the user's cache."""
    monkeypatch.setattr(compile_cache, "use", lambda folder: None)


@pytest.fixture
def model_path(tmp_path: Path) -> Path:
    """A model of beliefs."""
    model_files.save(tmp_path / "m", model())
    return tmp_path / "m"


@pytest.fixture
def rcbht(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> CommandLine:
    """The command line."""
    return CommandLine(capsys, monkeypatch)
