"""Digests are part of stores, models and committed results: their values are fixed here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rcbht_jax._util.digest import content_hash, data_hash, files_hash
from tests.support.store_cases import simple


def test_values_never_change(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_text("1 2\n")
    arrays = [np.arange(3, dtype=np.float32), np.array(["ä", "b"]), np.float64(0.5)]
    assert content_hash(arrays)[:16] == "1e0618abad72810c"
    assert data_hash(simple())[:16] == "53f070c3ff0516c5"
    assert files_hash(tmp_path, [tmp_path / "a.dat", tmp_path / "missing.dat"])[:16] == "f382723095204e9e"


def test_width_of_strings_does_not_matter() -> None:
    assert content_hash([np.array(["a", "b"], "U1")]) == content_hash([np.array(["a", "b"], "U9")])
