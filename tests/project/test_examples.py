"""Every example in a docstring of the packages and of the experiments prints what it says."""

from __future__ import annotations

import doctest
import importlib
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import rcbht_jax as rj
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings

ROOT = Path(__file__).parents[2]
RUNS = re.compile(r">>> (?!.*\+SKIP)")


def modules() -> list[str]:
    """Names of all modules with examples that can run."""
    files = [
        path for package in ("rcbht_jax", "sim_mjx", "experiments") for path in sorted((ROOT / package).rglob("*.py"))
    ]
    with_examples = [path.relative_to(ROOT) for path in files if RUNS.search(path.read_text(encoding="utf-8"))]
    return [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in with_examples]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that examples read."""
    folder = tmp_path_factory.mktemp("examples")
    wrench = np.random.default_rng(0).normal(size=(4, 400, 6)).cumsum(1)
    write_recordings(folder / "trials.zarr", Recordings.from_arrays(list(wrench), 200.0), {})
    write_tracks(folder / "trials.zarr", "online-W5", rj.encode(wrench, window=5), {"window": 5})
    columns = {"time": np.arange(400) / 200, "Fz": wrench[0, :, 2]}
    (folder / "runs").mkdir()
    np.savetxt(folder / "runs" / "a.csv", np.stack([*columns.values()], 1), "%.4f", ",", header="time,Fz", comments="")
    parquet.write_table(pa.table(columns), folder / "run.parquet")
    with h5py.File(folder / "run.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
    shutil.copytree(ROOT / "examples" / "mappings", folder / "examples" / "mappings")
    (folder / "limits.json").write_text('{"grip": [70.0, 46.0]}')
    return folder


@pytest.mark.parametrize("name", modules())
def test_examples_print_what_they_say(
    name: str, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shutil.copytree(files, tmp_path / "work"))  # an example may write files
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted > 0
    assert found.failed == 0, capsys.readouterr().out
