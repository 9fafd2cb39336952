"""Files written directly are what Zarr reads, and hold what Zarr would have written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numpy.typing import NDArray
from zarr.codecs import Crc32cCodec, ZstdCodec

from rcbht_jax.io import chunk_files

ROWS = 4


def array_at(path: Path, shape: tuple[int, ...], dtype: Any, chunk: tuple[int, ...], shard: Any) -> zarr.Array[Any]:
    return zarr.create_array(
        path,
        shape=shape,
        dtype=dtype,
        chunks=chunk,
        shards=shard,
        compressors=[ZstdCodec(level=chunk_files.LEVEL), Crc32cCodec()],
    )


def noise(shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """Numbers with stretches of zeros, negative zeros and values that are no number."""
    rng = np.random.default_rng(len(shape))
    values = rng.normal(0, 40, shape).astype(dtype)
    values[:, : shape[1] // 2] = 0
    if dtype.startswith("float"):
        values[0, 0], values[0, -1] = -0.0, np.nan
    return values


@pytest.mark.parametrize("dtype", ["float32", "float64", "int8", "int32", "bool"])
@pytest.mark.parametrize(
    ("width", "axis", "chunk", "shard"),
    [
        (37, 1, (2, 8, 3), (ROWS, 16, 3)),
        (16, 1, (4, 16, 3), (ROWS, 16, 3)),
        (1, 1, (1, 8, 3), (ROWS, 8, 3)),
        (50, 2, (2, 3, 8), (ROWS, 3, 24)),
    ],
)
def test_zarr_reads_the_shards(
    dtype: str, width: int, axis: int, chunk: tuple[int, ...], shard: tuple[int, ...], tmp_path: Path
) -> None:
    shape = (2 * ROWS, width, 3) if axis == 1 else (2 * ROWS, 3, width)
    values = noise(shape, dtype)
    array = array_at(tmp_path / "a", shape, dtype, chunk, shard)
    for number in (1, 0):
        rows = values[number * ROWS : (number + 1) * ROWS]
        chunk_files.write_shards(tmp_path / "a" / "c", (number, *[0] * (axis - 1)), rows, axis, chunk, shard)
    assert array[...].tobytes() == values.tobytes()  # type: ignore[union-attr]
    other = array_at(tmp_path / "b", shape, dtype, chunk, shard)
    other[...] = values
    files, theirs = (
        {str(path.relative_to(tmp_path / name)) for path in (tmp_path / name).rglob("*") if path.is_file()}
        for name in "ab"
    )
    assert files == theirs


def test_what_is_all_zeros_has_no_file(tmp_path: Path) -> None:
    file = tmp_path / "c" / "0" / "0"
    chunk_files.write_chunk(file, np.ones((2, 3)), (2, 3))
    assert file.is_file()
    chunk_files.write_chunk(file, np.zeros((2, 3)), (2, 3))
    assert not file.exists()
    chunk_files.write_shards(tmp_path / "c", (1,), np.zeros((2, 3)), 1, (1, 2), (2, 4))
    assert not (tmp_path / "c" / "1").exists()


@pytest.mark.parametrize("axis", [0, 1])
def test_fewer_values_leave_no_shards_of_those_before(axis: int, tmp_path: Path) -> None:
    shape = (40, 3) if axis == 0 else (1, 40, 3)
    chunk = (4, 3) if axis == 0 else (1, 4, 3)
    array = array_at(tmp_path / "a", shape, "float32", chunk, (*chunk[:axis], 8, 3))
    for count in (40, 9):
        values = np.ones((*shape[:axis], count, 3), np.float32)
        chunk_files.write_shards(tmp_path / "a" / "c", (0,) * axis, values, axis, chunk, (*chunk[:axis], 8, 3))
    found = np.moveaxis(np.asarray(array[...]), axis, 0)
    assert (found[:9].all(), found[9:].any()) == (True, False)


@pytest.mark.parametrize("rows", [1, 3, ROWS])
def test_a_chunk_of_fewer_rows_is_filled_up(rows: int, tmp_path: Path) -> None:
    values = noise((rows, 5), "float32")
    array = array_at(tmp_path / "a", (ROWS, 5), "float32", (ROWS, 5), None)
    chunk_files.write_chunk(tmp_path / "a" / "c" / "0" / "0", values, (ROWS, 5))
    found = np.asarray(array[...])
    assert found[:rows].tobytes() == values.tobytes()
    assert not found[rows:].any()


def test_damage_is_noticed(tmp_path: Path) -> None:
    values = noise((ROWS, 20), "float64")
    array = array_at(tmp_path / "a", (ROWS, 20), "float64", (2, 5), (ROWS, 20))
    chunk_files.write_shards(tmp_path / "a" / "c", (0,), values, 1, (2, 5), (ROWS, 20))
    file = tmp_path / "a" / "c" / "0" / "0"
    data = bytearray(file.read_bytes())
    data[3] ^= 1
    file.write_bytes(data)
    with pytest.raises(ValueError, match="checksum"):
        array[...]


def test_an_interrupted_file_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "c" / "0"
    chunk_files.write_chunk(file, np.ones(3), (3,))
    before = file.read_bytes()
    monkeypatch.setattr(chunk_files.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        chunk_files.write_chunk(file, np.full(3, 2.0), (3,))
    assert [path.name for path in file.parent.iterdir()] == ["0"]
    assert file.read_bytes() == before
