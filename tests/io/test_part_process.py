"""Parts written by another process: what it is given, what it answers, and what it takes."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.part_process import PartProcess
from rcbht_jax.io.parts import Field, Layout, Part
from tests.support.fake_simulation import tree

FIELDS = {"value": Field("float32", ("slot",), (None,)), "name": Field("string"), "count": Field("int32")}


def part_in(folder: Path) -> Part:
    """One part of an empty table; its wrong values would be seen in the digest."""
    parts.create(zarr_io.create_group(folder, {}), Layout(5, 3), FIELDS)
    values = {
        "value": np.arange(6, dtype=np.float32).reshape(2, 3)[:, ::-1],  # not contiguous
        "name": np.array(["", "Größe"]),
        "count": np.array([7, -1], np.int32),
    }
    return Part(folder, Layout(5, 3), 1, FIELDS, values, ("value", "name"))


@pytest.fixture
def process() -> Iterator[PartProcess]:
    one = PartProcess()
    yield one
    one.close()
    one.wait()


def written(process: PartProcess, path: Path, *some: Part) -> None:
    process.send(path, some)
    process.wait_until_written()


def test_the_same_bytes_and_errors_as_in_this_process(tmp_path: Path, process: PartProcess) -> None:
    here, there = part_in(tmp_path / "here"), part_in(tmp_path / "there")
    parts.put(tmp_path / "here", [here])
    written(process, tmp_path / "there", there)
    assert tree(there.folder) == tree(here.folder)
    assert parts.digests(zarr_io.open_group(there.folder))[1] is not None

    wrong = replace(there, values={**there.values, "count": np.zeros(2, np.int64)})
    with pytest.raises(InputError, match="count of a part is int64"):
        written(process, tmp_path / "there", wrong)
    with pytest.raises(InputError, match="there is no part 9"):
        written(process, tmp_path / "there", replace(there, number=9))
    shutil.rmtree(tmp_path / "there" / "count" / "c")
    (tmp_path / "there" / "count" / "c").write_text("a file in place of a folder")
    with pytest.raises(OSError, match="count/c"):
        written(process, tmp_path / "there", there)


def test_text_without_letters_comes_back(tmp_path: Path, process: PartProcess) -> None:
    part = part_in(tmp_path / "table")
    written(process, tmp_path / "table", replace(part, values={**part.values, "name": np.array(["", ""])}))
    group = zarr_io.open_group(tmp_path / "table")
    assert parts.read(group, "name", slice(3, 5), FIELDS["name"]).tolist() == ["", ""]
    np.testing.assert_array_equal(
        parts.read(group, "value", slice(3, 5), FIELDS["value"]), np.array([[2, 1, 0], [5, 4, 3]], np.float32)
    )


def test_no_array_is_copied_on_its_way(tmp_path: Path, process: PartProcess) -> None:
    part = part_in(tmp_path / "table")
    large = replace(part, values={**part.values, "value": np.zeros((2, 10**6), np.float32)})
    tracemalloc.start()
    try:
        written(process, tmp_path / "table", large)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()


def test_it_imports_neither_jax_nor_a_simulator() -> None:
    code = "import sys, rcbht_jax.io.part_process; print(sorted({'jax', 'mujoco', 'sklearn'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
