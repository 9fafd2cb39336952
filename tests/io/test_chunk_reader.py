"""Chunks read directly are what Zarr reads; damage is an error, and unknown layouts are left to Zarr."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st
from numcodecs.zstd import compress
from numpy.typing import NDArray
from zarr.codecs import BytesCodec, Crc32cCodec, ShardingCodec, ZstdCodec
from zarr.core.chunk_key_encodings import V2ChunkKeyEncoding

from rcbht_jax.errors import InputError
from rcbht_jax.io import chunk_files, chunk_reader
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.chunk_reader import Chunks

SHAPE, CHUNK, SHARD = (9, 25, 3), (2, 5, 2), (4, 10, 4)
PACKED = (ZstdCodec(level=1), Crc32cCodec())


def member_of(folder: Path, values: NDArray[Any], **options: Any) -> zarr.Array[Any]:
    """An array that Zarr wrote, as the stores open it."""
    zarr.create_group(folder, zarr_format=3)
    group = zarr_io.open_group(folder, "r+")
    made = {"chunks": CHUNK, "compressors": PACKED, **options}
    group.create_array("a", shape=values.shape, dtype=values.dtype, **made)[...] = values  # type: ignore[arg-type]
    return zarr_io.member(zarr_io.open_group(folder), "a")


def values_of(dtype: str) -> NDArray[Any]:
    """Numbers, with chunks and whole files of zeros."""
    values = np.random.default_rng(1).normal(0, 40, SHAPE).astype(dtype)
    values[:4, 10:20], values[4:6, :5] = 0, 0
    return values


def chunks_of(array: zarr.Array[Any]) -> Chunks:
    chunks = chunk_reader.chunks_of(array)
    assert chunks is not None
    return chunks


@pytest.fixture(scope="module", params=[("float32", SHARD), ("float64", None), ("int8", SHARD), ("bool", None)])
def array(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[zarr.Array[Any], NDArray[Any]]:
    """An array, and all of it as Zarr reads it."""
    dtype, shard = request.param
    made = member_of(tmp_path_factory.mktemp("made") / "g", values_of(dtype), shards=shard)
    return made, np.asarray(made[...])


@given(st.data())
def test_any_rows_are_those_of_zarr(array: tuple[zarr.Array[Any], NDArray[Any]], data: st.DataObject) -> None:
    rows = np.array(data.draw(st.lists(st.integers(0, SHAPE[0] - 1), max_size=12)), np.int64)
    stops = tuple(data.draw(st.integers(0, size)) for size in SHAPE[1:])
    found = chunk_reader.read(chunks_of(array[0]), rows, stops)
    expected = array[1][rows][:, : stops[0], : stops[1]]
    assert found.dtype == expected.dtype
    assert np.array_equal(found, expected)


@pytest.mark.parametrize(
    "options",
    [
        {"fill_value": 1},
        {"serializer": BytesCodec(endian="big")},
        {"chunk_key_encoding": V2ChunkKeyEncoding(separator="/")},
        {
            "chunks": SHARD,
            "compressors": None,
            "serializer": ShardingCodec(
                chunk_shape=CHUNK,
                codecs=(BytesCodec(), *PACKED),
                index_location="start",  # type: ignore[arg-type]
            ),
        },
    ],
    ids=["filled with ones", "big-endian", "other names", "index at the start"],
)
def test_other_layouts_are_left_to_zarr(options: dict[str, Any], tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"), **options)
    assert chunk_reader.chunks_of(array) is None
    assert np.array_equal(np.asarray(array[...]), values_of("float32"))


def test_texts_are_left_to_zarr(tmp_path: Path) -> None:
    texts = np.array(["a", "bc"], np.dtypes.StringDType())
    assert chunk_reader.chunks_of(member_of(tmp_path / "g", texts, chunks=(2,))) is None


@pytest.mark.parametrize("shard", [SHARD, None], ids=["in shards", "alone"])
@pytest.mark.parametrize("place", [5, -9, -2], ids=["first chunk", "index or chunk", "checksum"])
def test_a_flipped_bit_is_an_error(shard: Any, place: int, tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"), shards=shard)
    file = tmp_path / "g" / "a" / "c" / "0" / "0" / "0"
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)
    with pytest.raises(ValueError, match="does not match its checksum"):
        chunk_reader.read(chunks_of(array), np.arange(SHAPE[0]), SHAPE[1:])


@pytest.mark.parametrize("kept", [1, 40, -1])
def test_a_shortened_file_is_an_error(kept: int, tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"), shards=SHARD)
    file = tmp_path / "g" / "a" / "c" / "0" / "0" / "0"
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(ValueError, match="a chunk "):
        chunk_reader.read(chunks_of(array), np.arange(2), SHAPE[1:])


@pytest.mark.parametrize(("offset", "length"), [(2**63, 8), (0, 2**40), (0, 0)])
def test_an_index_that_points_elsewhere_is_an_error(offset: int, length: int, tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"), shards=SHARD)
    file = tmp_path / "g" / "a" / "c" / "0" / "0" / "0"
    size = 16 * 8
    index = np.frombuffer(file.read_bytes()[-size - 4 : -4], "<u8").copy()
    index[:2] = offset, length
    file.write_bytes(file.read_bytes()[: -size - 4] + chunk_files._checked(index.tobytes()))
    with pytest.raises(ValueError, match="is not within"):
        chunk_reader.read(chunks_of(array), np.arange(2), SHAPE[1:])


@pytest.mark.parametrize(("size", "said"), [(10**9, "expected at most 80"), (40, "expected the 80 of its shape")])
def test_a_chunk_of_another_size_is_not_unpacked(size: int, said: str, tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"))
    file = tmp_path / "g" / "a" / "c" / "0" / "0" / "0"
    file.write_bytes(chunk_files._checked(compress(bytes(size), 1)))
    with pytest.raises(ValueError, match=said):
        chunk_reader.read(chunks_of(array), np.arange(2), SHAPE[1:])


def test_a_pipe_is_not_read(tmp_path: Path) -> None:
    array = member_of(tmp_path / "g", values_of("float32"), shards=SHARD)
    file = tmp_path / "g" / "a" / "c" / "0" / "0" / "0"
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(InputError, match="not a regular file"):
        chunk_reader.read(chunks_of(array), np.arange(2), SHAPE[1:])
