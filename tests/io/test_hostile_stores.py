"""Stores of strangers that declare or unpack to far more than they hold: refused in one sentence, within memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import zarr
from numcodecs.zstd import compress
from zarr.codecs import BytesCodec, Crc32cCodec, GzipCodec, ShardingCodec, ZstdCodec

from rcbht_jax._util import compile_cache
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.chunk_reader import content_size
from tests.support.store_cases import encoded_store, same, simple


def redeclare(path: Path, **shapes: list[int]) -> None:
    """Have arrays declare other shapes, also where the metadata are collected."""
    for name, shape in shapes.items():
        for file in (path / name / "zarr.json", path / "zarr.json"):
            content = json.loads(file.read_text())
            collected = content.get("consolidated_metadata", {"metadata": {name: content}})
            collected["metadata"][name]["shape"] = shape
            file.write_text(json.dumps(content))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    store.write_recordings(tmp_path / "trials.zarr", simple(3, 200), {})
    return tmp_path / "trials.zarr"


@pytest.fixture(scope="module")
def encoded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = encoded_store(tmp_path_factory.mktemp("encoded") / "trials.zarr", simple(3, 200))
    redeclare(path, wrench=[3, 10**12, 6])
    return path


@pytest.mark.parametrize(
    "words",
    [
        ["encode", "--window", "7"],
        ["stream", "--robot", "hiro"],
        ["plot", "map", "-o", "map.pdf"],
        ["describe", "t1"],
        ["evaluate"],
        ["info"],
        ["calibrate", "--method", "rest", "-o", "limits.json"],
    ],
)
def test_a_huge_time_axis_is_one_sentence(
    encoded: Path, words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(encoded.parent)
    monkeypatch.setattr(compile_cache, "use", lambda folder: None)
    count = 2 if words[0] == "plot" else 1
    status = main([*words[:count], str(encoded), *words[count:]])
    error = capsys.readouterr().err
    if words != ["info"]:  # which shows what is counted of a large store, and reads no sample
        assert status == 2
        assert f"{10**12} samples, and the longest recording 200; expected at most 1048576" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("read", [store.longest_of, store.read_recordings, lambda path: list(store.read_batches(path))])
def test_no_reader_believes_a_huge_time_axis(path: Path, read: object) -> None:
    redeclare(path, wrench=[3, 2**62, 6])
    with pytest.raises(InputError, match=r"trials\.zarr holds contradictory recordings: the wrench has 4611686\d+"):
        read(path)  # type: ignore[operator]
    with pytest.raises(InputError, match="the longest recording 200"):
        store.read_recordings(path)


def test_padding_that_recordings_may_have_is_kept(tmp_path: Path) -> None:
    """Recordings chosen from longer ones are padded as those were."""
    recordings = simple(3, 2000)
    recordings.length[:] = 20
    recordings.wrench[:, 20:] = 0
    store.write_recordings(tmp_path / "x.zarr", recordings, {})
    same(store.read_recordings(tmp_path / "x.zarr"), recordings)
    assert store.longest_of(tmp_path / "x.zarr") == 2000


def test_what_no_reader_takes_is_not_written(tmp_path: Path) -> None:
    recordings = simple(1, 50)
    wide = np.zeros((1, 2**20 + 1, 6), np.float32)
    wide[:, :50] = recordings.wrench
    vars(recordings)["wrench"] = wide
    with pytest.raises(InputError, match="Cut what lies beyond"):
        store.write_recordings(tmp_path / "x.zarr", recordings, {})


BOMB = 400_000_000  # bytes


def sealed(data: bytes) -> bytes:
    return data + google_crc32c.value(data).to_bytes(4, "little")


def bomb(path: Path, chunk: str) -> None:
    """Have a chunk, or the first one of a shard, unpack to BOMB bytes."""
    packed = sealed(compress(np.zeros(BOMB, np.uint8), 1))
    if not chunk.startswith("wrench/"):
        (path / chunk).write_bytes(packed)
        return
    index = np.full((8, 2), 2**64 - 1, "<u8")
    index[0] = 0, len(packed)
    (path / chunk).write_bytes(packed + sealed(index.tobytes()))


@pytest.mark.parametrize("chunk", ["length/c/0", "trial/c/0", "axis/c/0", "wrench/c/0/0/0"])
def test_a_packed_chunk_takes_no_more_memory_than_it_may(path: Path, chunk: str) -> None:
    bomb(path, chunk)
    code = (
        "import resource, sys; from pathlib import Path; from rcbht_jax.errors import InputError\n"
        "from rcbht_jax.io import store\n"
        "used = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "path, before = Path(sys.argv[1]), used()\n"
        "try:\n    store.read_recordings(path)\n"
        "except InputError as error:\n    print(used() - before, error)\n"
    )
    run = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    grown, _, sentence = run.stdout.partition(" ")
    assert int(grown) < 150_000  # KiB
    assert "declares 400000000 unpacked; expected at most" in sentence


@pytest.mark.parametrize("size", [0, 1, 255, 256, 257, 65_791, 65_792, 10**6])
def test_the_size_of_a_frame_is_read_as_it_was_written(size: int) -> None:
    assert content_size(compress(bytes(size), 1)) == size
    assert content_size(compress(np.random.default_rng(0).bytes(size), 9)[:18]) == size


@pytest.mark.parametrize(
    "codecs",
    [
        [BytesCodec(), GzipCodec()],
        [BytesCodec(), ZstdCodec(), GzipCodec()],
        [BytesCodec(), ZstdCodec(), ZstdCodec(), Crc32cCodec()],
        [ShardingCodec(chunk_shape=(4,), codecs=[BytesCodec(), GzipCodec()])],
        [ShardingCodec(chunk_shape=(4,), index_codecs=[BytesCodec()])],  # a packed index later zarrs refuse themselves
    ],
)
def test_chunks_packed_otherwise_are_refused(path: Path, codecs: list[zarr.abc.codec.Codec]) -> None:
    file = path / "length" / "zarr.json"
    content = json.loads(file.read_text())
    content["codecs"] = [codec.to_dict() for codec in codecs]
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match="length is packed in an unknown way"):
        store.read_recordings(path)


def test_a_description_is_no_larger_than_json_may_be(path: Path) -> None:
    with (path / "length" / "zarr.json").open("ab") as file:
        file.truncate(2**26 + 1)
    with pytest.raises(InputError, match="not a regular file of at most"):
        store.read_recordings(path)


def reading_of(path: Path, way: str) -> None:
    """Read a store as one of three ways does: from its files, with its collected metadata, at a URL."""
    if way == "collected":
        store.read_rows(path, [0])
    elif way == "files":
        store.read_table(path)
    else:
        memory = pytest.importorskip("fsspec").filesystem("memory")
        memory.put(str(path), f"/{path.parent.name}", recursive=True)
        store.read_table(f"memory://{path.parent.name}")


WAYS = ("files", "collected", "URL")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("content", [b"\xff\xff\xff\x7f", (4).to_bytes(4, "little")], ids=["many", "more than bytes"])
def test_a_chunk_declares_the_texts_that_it_holds(path: Path, content: bytes, way: str) -> None:
    (path / "trial" / "c" / "0").write_bytes(sealed(compress(content, 1)))
    with pytest.raises(InputError, match=r"a chunk of 4 bytes declares \d+ texts; expected the 4 of its shape"):
        reading_of(path, way)


def redeclare_rows(path: Path, rows: int, part: int) -> None:
    redeclare(path, part_sha256=[rows // part, 32], length=[rows])
    content = json.loads((path / "zarr.json").read_text())
    content["attributes"] |= {"rows": rows, "part_rows": part}
    (path / "zarr.json").write_text(json.dumps(content))


def test_rows_are_in_no_more_files_than_a_folder_may_have(path: Path) -> None:
    redeclare_rows(path, 10**6, 100)  # but in chunks of 4
    with pytest.raises(InputError, match="length has 1000000 rows, in more than 200000 files"):
        store.read_lengths(path)


@pytest.mark.parametrize("way", WAYS)
def test_no_reader_believes_a_thousand_million_rows(path: Path, way: str) -> None:
    redeclare_rows(path, 10**9, 4)
    with pytest.raises(InputError, match=r"1000000000 rows in 250000000 parts; expected at most 10000000"):
        reading_of(path, way)


@pytest.mark.parametrize(
    ("shapes", "said"),
    [
        ({"axis": [10**9]}, "axis declares 16000000000 bytes, far more than its files hold"),
        ({"simulation/part_sha256": [10**9, 32]}, "declares 3 rows in parts of 4, but has others"),
        ({"simulation/x": [3, 10**9]}, "declares 24000000000 bytes, far more than its files hold"),
    ],
)
def test_an_array_declares_about_as_much_as_its_files_hold(
    tmp_path: Path, shapes: dict[str, list[int]], said: str
) -> None:
    path = tmp_path / "x.zarr"
    store.write_recordings(path, simple(3, 20), {}, simulation={"x": np.zeros((3, 2))})
    redeclare(path, **shapes)
    with pytest.raises(InputError, match=said):
        store.verify(path)


def test_neither_size_nor_padding_is_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Version 1 has all wrenches in one array, and each field of its labels, most slots of which are empty."""
    group = zarr_io.create_group(tmp_path / "x.zarr", {})
    zarr_io.create_array(group, "empty", (2**26 + 1,), "int8", ("slot",), {}, (2**22,))
    assert not zarr_io.read_array(group, "empty", "int8").any()
    monkeypatch.setattr(zarr_io, "MAX_BYTES", 2**10)
    zarr_io.write_array(group, "large", np.arange(2.0**12), ("time",), "float64", {})
    assert zarr_io.read_array(group, "large", "float64")[-1] == 2**12 - 1


def test_as_many_summaries_are_read_as_there_are_parts(path: Path) -> None:
    before = store.read_summary(path)
    redeclare(path, part_summary=[10**9])
    assert store.read_summary(path) == before


def test_texts_as_wide_as_the_longest_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert zarr_io.fixed_width(np.array([["a", ""]], np.dtypes.StringDType()), tmp_path).tolist() == [["a", ""]]
    texts = np.array(["a" * 2**20, *[""] * 600], np.dtypes.StringDType())
    with pytest.raises(InputError, match="601 texts, the longest of 1048576 characters"):
        zarr_io.fixed_width(texts, tmp_path)
    monkeypatch.setattr(zarr_io, "MAX_BYTES", 2**10)
    names = np.array([f"sim-assembly-robot-{row:06d}" for row in range(100)], np.dtypes.StringDType())
    assert zarr_io.fixed_width(names, tmp_path).tolist() == names.tolist()
