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
    ("extra", "commands"),
    [
        ("store", ["encode a.zarr", "stream a.zarr --robot hiro --speed 0"]),
        ("report", ["report a.zarr -o a.html"]),
        ("export", [f"export a.zarr --format {kind} -o {kind}" for kind in ("csv", "parquet", "lerobot")]),
        ("stream", ["export a.zarr --format mcap -o mcap"]),
    ],
)
def test_a_command_needs_no_other_extra(extra: str, commands: list[str], store: Path) -> None:
    program = "import os\nfrom rcbht_jax.cli.main import main\n"
    program += f"os.chdir({str(store.parent)!r})\nassert [main(words.split()) for words in {commands!r}].count(0)"
    without_extras(f"{program} == {len(commands)}", "cli", "store", extra)
