"""Zarr groups of other programs: replay buffers, groups without episodes, and what may not be decoded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numcodecs import Blosc, Pickle
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.labels import AXES
from tests.attacks.folders import recordings

WRENCH = np.random.default_rng(0).normal(size=(500, 6)).cumsum(0).astype(np.float32)
ENDS = [200, 500]
BUFFER = {
    "data/wrench": WRENCH, "data/timestamp": np.r_[np.arange(200), np.arange(300)] * 0.01,
    "data/camera": np.zeros((500, 8, 8, 3), np.uint8), "meta/episode_ends": np.array(ENDS),
    "meta/success": np.array([True, False]),
}  # fmt: skip


def write(path: Path, arrays: dict[str, NDArray[Any]], version: Any = 2, **attributes: Any) -> Path:
    group = zarr.open_group(path, mode="w", zarr_format=version, attributes=attributes)
    options: dict[str, Any] = {"compressors": Blosc("zstd", 5)} if version == 2 else {}
    for key, values in arrays.items():
        group.create_array(key, data=values, **options)
    return path


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("packed", [False, True])
def test_a_replay_buffer_is_a_recording_for_each_episode(version: int, packed: bool, tmp_path: Path) -> None:
    source = write(tmp_path / "buffer.zarr", BUFFER, version)
    if packed:
        shutil.make_archive(str(source), "zip", source)
        shutil.rmtree(source)
        source = tmp_path / "buffer.zarr.zip"
    for where in (source, tmp_path):
        imported = read_source(where)
        found = imported.recordings
        assert (found.axes, found.length.tolist(), 1 / found.dt) == (AXES, [200, 300], pytest.approx(100))
        np.testing.assert_array_equal(found.wrench[0, :200], WRENCH[:200])
        np.testing.assert_array_equal(found.wrench[1], WRENCH[200:])
        assert found.outcome.tolist() == ["success", "failure"]
        assert any("data/camera" in remark for remark in imported.report.remarks)


def test_groups_without_ends_are_files_of_arrays(tmp_path: Path) -> None:
    trials = {"trial_0/Fz": WRENCH[:200, 2], "trial_1/Fz": WRENCH[200:450, 2]}
    source = write(tmp_path / "run.zarr", trials, 3, rate=50)
    found = read_source(source).recordings
    assert (found.length.tolist(), 1 / found.dt) == ([200, 250], 50)


def test_what_may_run_code_is_not_decoded(tmp_path: Path) -> None:
    """An array whose codec unpickles, which would run what a stranger wrote."""
    source = write(tmp_path / "buffer.zarr", {"data/wrench": WRENCH, "data/other": WRENCH})
    about = json.loads((source / "data/other/.zarray").read_text())
    (source / "data/other/.zarray").write_text(json.dumps(about | {"filters": [Pickle().get_config()]}))
    imported = read_source(source, mapping=Mapping(source_rate=100.0))
    assert imported.recordings.axes == AXES
    assert any("data/other" in remark for remark in imported.report.remarks)
    (source / "data/wrench/.zarray").write_text(json.dumps(about | {"filters": [Pickle().get_config()]}))
    with pytest.raises(InputError, match=r"holds no array \[time\] or \[time, axis\]"):
        read_source(source)


def test_damaged_groups_are_refused_with_a_sentence(tmp_path: Path) -> None:
    source = write(tmp_path / "buffer.zarr", BUFFER)
    about = (source / "data/wrench/.zarray").read_text()
    for changes, reason in (
        ({"shape": [10**9, 6], "chunks": [10**9, 6]}, "declares arrays of"),
        ({"shape": [-1, 6]}, "declares arrays of|is not a readable Zarr"),
        ({"shape": ["a", 6]}, "is not a readable Zarr"),
        ({"dtype": "<z9"}, "is not a readable Zarr"),
    ):
        (source / "data/wrench/.zarray").write_text(json.dumps(json.loads(about) | changes))
        with pytest.raises(InputError, match=reason):
            read_source(source)
    (source / "data/wrench/.zarray").write_text(about)
    (source / "data/wrench/0.0").write_bytes(b"\x00" * 40)
    with pytest.raises(InputError, match=r"is not a readable Zarr"):
        read_source(source)
    write(source, BUFFER | {"meta/episode_ends": np.array([300, 200])})
    with pytest.raises(InputError, match="must be increasing ends"):
        read_source(source)


def test_what_this_program_wrote_is_no_source(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    store.write_recordings(tmp_path / "runs/own.zarr", recordings(), {})
    with pytest.raises(InputError, match=r"own\.zarr is a store that rcbht wrote"):
        read_source(tmp_path / "runs/own.zarr")
    (tmp_path / "runs/a.csv").write_text("t,Fz\n" + "\n".join(f"{k / 100},{k % 7}" for k in range(60)))
    imported = read_source(tmp_path / "runs")
    assert imported.recordings.trial.tolist() == ["a"]
    assert imported.report.remarks[0] == "1 other file was not read: own.zarr."


@pytest.mark.parametrize("version", [2, 3])
def test_attributes_of_the_group_of_a_recording_are_its_facts(version: Any, tmp_path: Path) -> None:
    group = zarr.open_group(tmp_path / "runs.zarr", mode="w", zarr_format=version)
    group.attrs["fps"] = 100
    for number in range(2):
        group.create_array(f"trial_{number}/force", data=np.random.default_rng(number).normal(size=(60, 3)))
        others = {"cells": [[1, 2], [3]], "config": {"gain": 1}, "comment": None}  # which are no facts
        group[f"trial_{number}"].attrs.update({"operator": "ab"[number], "success": number == 1, **others})
    recordings = read_source(tmp_path / "runs.zarr").recordings
    assert recordings.dt == pytest.approx(0.01)
    assert recordings.columns["operator"].tolist() == ["a", "b"]
    assert recordings.outcome.tolist() == ["failure", "success"]
