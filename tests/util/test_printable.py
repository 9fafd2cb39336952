"""Tables in a terminal, whose East Asian letters are two columns wide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util.printable import room
from rcbht_jax.cli.main import main
from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings


def test_the_columns_of_info_are_aligned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Recordings.from_arrays(np.zeros((2, 40, 1)), 100, axes=["Fz"], session=["\uc6d4\uc694\uc77c", "monday"])
    write_recordings(tmp_path / "a.zarr", made, {})
    assert main(["info", str(tmp_path / "a.zarr")]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("mine ")]
    assert len({room(row[: row.index("unknown")]) for row in rows}) == 1
