"""Numbers that stand for missing values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping, read_mapping, write_mapping

N = 60
FORCES = np.random.default_rng(0).normal(size=(N, 3)).round(3) * 10


def write(path: Path, number: str, rows: tuple[int, ...] = (5, 6, 30)) -> None:
    cells = [",".join([number] * 3 if k in rows else map(str, FORCES[k])) for k in range(N)]
    path.write_text("\n".join(["t,Fx,Fy,Fz", *(f"{k * 0.01:.2f},{cell}" for k, cell in enumerate(cells))]) + "\n")


@pytest.mark.parametrize("number", ["-9999", "1e30", "-999.0", "9.96921e+36", "-3.4028235e+38", "-32768"])
def test_a_number_far_from_all_others_is_named_and_a_map_makes_it_missing(number: str, tmp_path: Path) -> None:
    """It was read as a force, without a word."""
    write(tmp_path / "a.csv", number)
    report = read_source(tmp_path / "a.csv").report
    [(_, warning)] = [row for row in report.warnings if "far from all others" in row[1]]
    assert warning.startswith("Fx is ")
    assert "in 3 samples" in warning
    (tmp_path / "map.toml").write_text(warning[warning.index("missing = ") : -1])
    imported = read_source(tmp_path / "a.csv", mapping=read_mapping(tmp_path / "map.toml"))
    assert imported.recordings.note.tolist() == ["missing:3"]
    assert not imported.report.warnings
    kept = np.delete(np.arange(N), [5, 6, 30])
    np.testing.assert_allclose(imported.recordings.wrench[0][kept], FORCES[kept], rtol=1e-6)
    assert np.abs(imported.recordings.wrench).max() <= np.abs(FORCES).max() + 1e-3


def test_forces_that_are_large_and_a_sensor_at_rest_are_no_such_numbers(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "99.0")
    assert not read_source(tmp_path / "a.csv").report.warnings
    write(tmp_path / "a.csv", "9999", rows=tuple(range(N)))
    assert not any("far from" in text for _, text in read_source(tmp_path / "a.csv").report.warnings)


def test_numbers_of_a_map_are_written_and_read(tmp_path: Path) -> None:
    write_mapping(tmp_path / "map.toml", Mapping(missing=(-9999.0, 1e30)))
    assert read_mapping(tmp_path / "map.toml").missing == (-9999.0, 1e30)
