"""Each extra alone brings what the install page promises: commands run without the packages of the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings
from tests.project.test_packaging import without_extras


@pytest.fixture
def store(tmp_path: Path) -> Path:
    wrench = np.random.default_rng(0).normal(size=(40, 6))
    write_recordings(tmp_path / "a.zarr", Recordings.from_arrays([wrench], outcome="success"), {})
    return tmp_path / "a.zarr"


@pytest.mark.parametrize(
    ("extras", "command"),
    [
        (("store",), ["encode", "{store}"]),
        (("store",), ["stream", "{store}", "--robot", "hiro", "--speed", "0"]),
        (("store", "report"), ["report", "{store}", "-o", "{out}.html"]),
        (("store", "export"), ["export", "{store}", "--format", "csv", "-o", "{out}"]),
        (("store", "export"), ["export", "{store}", "--format", "parquet", "-o", "{out}"]),
        (("store", "export"), ["export", "{store}", "--format", "lerobot", "-o", "{out}"]),
        (("store", "stream"), ["export", "{store}", "--format", "mcap", "-o", "{out}"]),
    ],
    ids=["encode", "stream", "report", "csv", "parquet", "lerobot", "mcap"],
)
def test_a_command_needs_no_other_extra(extras: tuple[str, ...], command: list[str], store: Path) -> None:
    words = [word.format(store=store, out=store.with_name("out")) for word in command]
    without_extras(f"from rcbht_jax.cli.main import main\nassert main({words!r}) == 0\n", "cli", *extras)
