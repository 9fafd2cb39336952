"""Texts in MATLAB files: cells of which some are empty, and rows of characters, in both formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from rcbht_jax.io.importing.importer import read_source

COUNT = 60
WRENCH = np.random.default_rng(0).normal(size=(COUNT, 6))
WORDS = ["free"] * 30 + ["pushing"] * 20 + [""] * 10
SPANS = [("free", 0.0, 0.3), ("pushing", 0.3, 0.5)]


def column(texts: list[Any]) -> np.ndarray:
    """A cell array with a row for each text."""
    cells = np.empty((len(texts), 1), object)
    cells[:, 0] = texts
    return cells


def written(path: Path, version: int, words: list[Any] | np.ndarray, within: bool) -> None:
    """A MATLAB file with a time, a wrench, and words: a list as a cell array, an array as rows of characters."""
    if version == 5:
        cells = column(words) if isinstance(words, list) else words
        values = {"time": np.arange(COUNT) / 100, "wrench": WRENCH, "phase": cells}
        scipy.io.savemat(path, {"run": values} if within else values)
        return
    h5py = pytest.importorskip("h5py")

    def char(group: Any, name: str, rows: list[str]) -> Any:
        codes = np.array([[ord(letter) for letter in row] for row in rows], np.uint16)
        one = group.create_dataset(name, data=codes.T if codes.size else np.array([0, 0], np.uint64))
        one.attrs["MATLAB_class"] = np.bytes_("char")
        if not codes.size:
            one.attrs["MATLAB_empty"] = np.uint8(1)
        return one

    with h5py.File(path, "w", userblock_size=512) as file:
        run = file.create_group("run") if within else file
        for name, values in {"time": np.arange(COUNT)[None] / 100, "wrench": WRENCH.T}.items():
            run.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_("double")
        if isinstance(words, np.ndarray):
            char(run, "phase", words.tolist())
        else:
            texts = [char(file, f"#refs#/{number}", [word]).ref for number, word in enumerate(words)]
            cell = run.create_dataset("phase", data=np.array(texts, h5py.ref_dtype)[None], dtype=h5py.ref_dtype)
            cell.attrs["MATLAB_class"] = np.bytes_("cell")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(128) + path.read_bytes()[128:])


@pytest.mark.parametrize("within", [False, True])
@pytest.mark.parametrize("version", [5, 7])
@pytest.mark.parametrize("rows", [False, True])
def test_empty_and_padded_texts_mark_nothing(rows: bool, version: int, within: bool, tmp_path: Path) -> None:
    words = np.array([word.ljust(7) for word in WORDS]) if rows else WORDS
    written(tmp_path / "run.mat", version, words, within)
    imported = read_source(tmp_path)
    marks = imported.recordings.annotations
    assert len(marks.tracks) == 1
    labels = [marks.labels[marks.tracks[0]][code] for code in marks.code]
    assert list(zip(labels, marks.start.tolist(), marks.end.tolist(), strict=True)) == [
        (label, pytest.approx(start), pytest.approx(end)) for label, start, end in SPANS
    ]
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH, rtol=1e-6)


def test_an_empty_number_in_a_cell_of_texts_is_an_empty_text(tmp_path: Path) -> None:
    written(tmp_path / "run.mat", 5, [word or np.empty((0, 0)) for word in WORDS], within=False)
    marks = read_source(tmp_path).recordings.annotations
    assert marks.labels == {"phase": ("free", "pushing")}


def test_a_cell_of_empty_arrays_and_one_of_numbers_hold_no_texts(tmp_path: Path) -> None:
    written(tmp_path / "run.mat", 5, [np.empty((0, 0))] * (COUNT - 1) + [np.zeros((2, 2))], within=False)
    assert len(read_source(tmp_path).recordings.annotations) == 0


@pytest.mark.parametrize("key", ["names", "parts"])
def test_short_lists_of_texts_do_not_turn_a_matrix_and_name_its_columns_if_called_so(key: str, tmp_path: Path) -> None:
    lists = {key: column(["grip", "twist"]), "units": column(["N", "Nm"])}
    scipy.io.savemat(tmp_path / "a.mat", {"data": WRENCH[:, :2], "fs": 100.0, **lists})
    recordings = read_source(tmp_path / "a.mat", "matlab").recordings
    assert recordings.axes == (("grip", "twist") if key == "names" else ("data_0", "data_1"))
    np.testing.assert_allclose(recordings.wrench[0], WRENCH[:, :2], rtol=1e-6)


@pytest.mark.parametrize(("name", "given"), [("units", ["kN"] * 3 + ["Nmm"] * 3), ("wrench_units", ["kN", "Nmm"])])
def test_a_cell_array_of_units_is_understood(name: str, given: list[str], tmp_path: Path) -> None:
    values = {"t": np.arange(COUNT) / 100, "wrench": WRENCH, name: column(given)}
    scipy.io.savemat(tmp_path / "a.mat", {"run": values})
    imported = read_source(tmp_path / "a.mat")
    assert imported.recordings.units == ("kN",) * 3 + ("Nmm",) * 3
    assert not any("left out" in remark for remark in imported.report.remarks)


def test_units_of_a_table_stand_beside_the_names_of_its_columns(tmp_path: Path) -> None:
    names, units = ["Time", *(f"{kind}{axis}" for kind in "FM" for axis in "xyz")], ["ms", *["N"] * 3, *["Nmm"] * 3]
    values = {"data": np.column_stack([10.0 * np.arange(COUNT), WRENCH])}
    scipy.io.savemat(tmp_path / "a.mat", {**values, "VariableNames": column(names), "VariableUnits": column(units)})
    recordings = read_source(tmp_path / "a.mat").recordings
    assert (recordings.units, recordings.dt) == (tuple(units[1:]), 0.01)
