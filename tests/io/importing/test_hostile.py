"""Whatever a file holds: a data set or one sentence, soon, and without much memory."""

from __future__ import annotations

import gzip
import io
import json
import os
import pickle
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import zarr
from hypothesis import given, settings
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import storage_mcap
from rosbags.typesys import Stores, get_typestore

from rcbht_jax.errors import InputError
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.rosbags import McapWriter
from tests.attacks.folders import recordings
from tests.io.importing.test_readers import TIME, WRENCH, write_ros1

SECONDS = 2.0


def outcome(content: bytes, suffix: str, kind: str = "auto") -> None:
    """A finite data set, or an InputError in one sentence; anything else escapes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        path.write_bytes(content)
        start, sentence = time.perf_counter(), "."
        try:
            recordings = read_source(path, kind, Mapping(source_rate=100.0)).recordings
            assert np.isfinite(recordings.wrench).all()
        except InputError as error:
            sentence = str(error)
        assert sentence.endswith((".", "?"))
        assert time.perf_counter() - start < SECONDS


def npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, t=TIME, wrench=WRENCH, who=np.array(["ann"]))
    return file.getvalue()


def csv() -> bytes:
    rows = [
        f"{t},{','.join(map(str, row))},{'free' if t < 0.2 else 'push'}" for t, row in zip(TIME, WRENCH, strict=True)
    ]
    return "\n".join(["t,Fx,Fy,Fz,Mx,My,Mz,phase", *rows]).encode()


def parquet() -> bytes:
    file = io.BytesIO()
    lists = pa.FixedSizeListArray.from_arrays(pa.array(WRENCH.ravel()), 6)
    pq.write_table(pa.table({"t": TIME, "wrench": lists, "who": ["ann"] * len(TIME)}), file)
    return file.getvalue()


def feather() -> bytes:
    file = io.BytesIO()
    table = pa.table({"t": TIME, **{f"w_{k}": WRENCH[:, k] for k in range(6)}, "who": ["ann"] * len(TIME)})
    with pa.ipc.new_file(file, table.schema) as writer:
        writer.write_table(table)
    return file.getvalue()


def matlab() -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {"t": TIME, "log": {"wrench": WRENCH, "who": "ann"}}, do_compression=True)
    return file.getvalue()


def bag() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_ros1(Path(folder) / "a.bag")
        return (Path(folder) / "a.bag").read_bytes()


def hdf5() -> bytes:
    h5py = pytest.importorskip("h5py")
    file = io.BytesIO()
    with h5py.File(file, "w") as group:
        group["t"], group["log/wrench"], group.attrs["who"] = TIME, WRENCH, "ann"
    return file.getvalue()


def ts() -> bytes:
    head = "@problemName pokes\n@timeStamps false\n@missing false\n@dimension 6\n@classLabel true soft hard\n@data\n"
    return (head + ":".join(",".join(map(repr, axis)) for axis in WRENCH.T.tolist()) + ":soft\n").encode()


def uci() -> bytes:
    rows = "".join("\t" + "\t".join(map(repr, row)) + "\n" for row in WRENCH.tolist())
    return f"collision_in_tool\n{rows}\n\n".encode()


def jsonl() -> bytes:
    rows = zip(TIME.tolist(), WRENCH.tolist(), strict=True)
    return "".join(f'{{"time": {t}, "wrench": {row}, "who": "ann"}}\n' for t, row in rows).encode()


def json_document() -> bytes:
    return json.dumps({"time": TIME.tolist(), "wrench": WRENCH.tolist(), "who": "ann"}).encode()


def zarr_zip() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        with zarr.storage.ZipStore(Path(folder) / "a.zip", mode="w") as file:
            group = zarr.open_group(file, mode="w")
            group.create_array("t", data=TIME)
            group.create_array("wrench", data=WRENCH)
        return (Path(folder) / "a.zip").read_bytes()


def mcap() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        with McapWriter(Path(folder) / "a.mcap") as writer:
            for stamp, row in zip(TIME.tolist(), WRENCH.tolist(), strict=True):
                writer.wrench(1 + stamp, tuple(row))
        return (Path(folder) / "a.mcap").read_bytes()


VALID = {
    ".mcap": mcap, ".csv": csv, ".npz": npz, ".parquet": parquet, ".mat": matlab, ".bag": bag, ".h5": hdf5, ".ts": ts,
    ".data": uci, ".jsonl": jsonl, ".json": json_document, ".csv.gz": lambda: gzip.compress(csv()),
    ".zarr.zip": zarr_zip, ".feather": feather,
}  # fmt: skip
KIND = {".data": "uci"}  # of suffixes that state none
SUFFIXES = sorted([*VALID, ".npy", ".db3", ".tsv"])


@pytest.fixture(scope="module", autouse=True)
def decoder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The process that decodes has begun, and has imported what it needs: its start is not measured."""
    folder = tmp_path_factory.mktemp("first")
    for suffix in (".mat", ".parquet"):
        (folder / f"a{suffix}").write_bytes(VALID[suffix]())
        read_source(folder / f"a{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=25)
@given(st.data())
def test_any_bytes(suffix: str, data: st.DataObject) -> None:
    magic = {
        ".npz": b"PK\x03\x04", ".npy": b"\x93NUMPY\x01\x00", ".parquet": b"PAR1", ".bag": b"#ROSBAG V2.0\n",
        ".h5": b"\x89HDF\r\n\x1a\n", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\x00",
        ".mat": b"MATLAB 5.0".ljust(124) + b"\x00\x01IM", ".ts": b"@classLabel true a\n@data\n", ".data": b"normal\n",
    }.get(suffix, b"t,Fz\n")  # fmt: skip
    head = data.draw(st.sampled_from([b"", magic]))
    outcome(head + data.draw(st.binary(max_size=400)), suffix, KIND.get(suffix, "auto"))


@pytest.mark.parametrize("suffix", sorted(VALID))
@settings(max_examples=40)
@given(st.data())
def test_valid_files_with_other_bytes(suffix: str, data: st.DataObject) -> None:
    content = bytearray(VALID[suffix]())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    held = data.draw(st.sampled_from([len(content), len(content) // 2]))
    outcome(bytes(content[:held]), suffix, KIND.get(suffix, "auto"))


@pytest.mark.parametrize("suffix", sorted(VALID))
def test_the_valid_files_are_valid(suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").write_bytes(VALID[suffix]())
    mapping = Mapping(source_rate=100.0) if suffix in (".ts", ".data") else None  # they hold no times
    imported = read_source(tmp_path / f"a{suffix}", KIND.get(suffix, "auto"), mapping)
    np.testing.assert_array_equal(imported.recordings.wrench[0], WRENCH)


# --- Huge, and what is no file -------------------------------------------------------------------------------------


def header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def zipped(*members: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


def huge_hdf5() -> bytes:
    h5py = pytest.importorskip("h5py")
    file = io.BytesIO()
    with h5py.File(file, "w") as group:
        group.create_dataset("wrench", (10**9, 6), "f8", chunks=(1000, 6))
    return file.getvalue()


def huge_parquet() -> bytes:
    file = io.BytesIO()
    pq.write_table(pa.table({"t": np.zeros(30_000_000)}), file)
    return file.getvalue()


def huge_mat() -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {"wrench": np.zeros((3_000_000, 6))}, do_compression=True)
    return file.getvalue()


def bomb_bag(compression: Writer1.CompressionFormat) -> bytes:
    """One chunk of a bag with a text of 300 MB zeros."""
    store, kind = get_typestore(Stores.ROS1_NOETIC), "std_msgs/msg/String"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        writer = Writer1(path)
        writer.set_compression(compression)
        with writer:
            connection = writer.add_connection("/wrench", "geometry_msgs/msg/WrenchStamped", typestore=store)
            text = writer.add_connection("/text", kind, typestore=store)
            writer.write(text, 1, (300_000_000).to_bytes(4, "little") + bytes(300_000_000))
            writer.write(connection, 2, bytes(64))
        return path.read_bytes()


def bomb_mcap() -> bytes:
    """A chunk that declares 1000 bytes and unpacks to 300 MB."""
    packed = vars(storage_mcap)["zstd"].compress(bytes(300_000_000))
    chunk = struct.pack("<QQQII", 0, 0, 1000, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    return b"\x89MCAP0\r\n" + b"\x06" + struct.pack("<Q", len(chunk)) + chunk


HUGE = {
    "bz2.bag": lambda: bomb_bag(Writer1.CompressionFormat.BZ2),
    "lz4.bag": lambda: bomb_bag(Writer1.CompressionFormat.LZ4),
    "zstd.mcap": bomb_mcap,
    "shape.npy": lambda: header((10**12, 6)),
    "shape.npz": lambda: zipped(("wrench.npy", header((10**12, 6)))),
    "bomb.npz": lambda: zipped(("wrench.npy", header((15_000_000, 1)) + bytes(120_000_000))),
    "negative.npy": lambda: header((-5, 6)),
    "columns.npy": lambda: header((2, 100_000)) + bytes(1_600_000),
    "sparse.h5": huge_hdf5,
    "constant.parquet": huge_parquet,
    "zeros.mat": huge_mat,
    "columns.csv": lambda: b",".join(b"a%d" % k for k in range(100_000)) + b"\n" + b"1," * 99_999 + b"1\n",
    "line.csv": lambda: b"t,Fz\n" + b"1" * 50_000_000,
    "noline.csv": lambda: b"x" * 50_000_000,
    "zeros.csv": lambda: bytes(50_000_000),
    "line.ts": lambda: b"@data\n" + b"1," * 25_000_000,
    "long.ts": lambda: b"@data\n" + b"1," * 4_000_000 + b"1\n",
    "dimensions.ts": lambda: b"@data\n" + b"1:" * 4_000_000 + b"1\n",
    "noline.ts": lambda: b"x" * 50_000_000,
    "line.data": lambda: b"normal\n" + b"1\t" * 25_000_000,
    "classes.data": lambda: b"normal\n1 2 3 4 5 6\n" * 200_000,
    "digits.csv": lambda: b"t,Fz\n0,1\n1," + b"9" * 900_000 + b"\n",
}
LIMITED = """
import os, resource, signal, sys, time
from pathlib import Path
import jax, pyarrow.parquet, scipy.io, scipy.signal
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import arrays, columnar, matlab
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import read_source
import rcbht_jax.io.importing.bags
try: import h5py
except ImportError: pass

for module in (arrays, columnar, matlab):  # in this process
    module.isolated = lambda decode, path, name, *libraries: decode(path, name)

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

for line in sys.stdin:
    if child := os.fork():
        if status := os.waitpid(child, 0)[1]:
            print("The reader ended with", status)
            print("inf inf", flush=True)
        continue
    signal.alarm(60)
    before, start = peak(), time.process_time()  # others may keep the machine busy
    try:
        read_source(path := Path(line.rstrip()), "uci" if path.suffix == ".data" else "auto")
        sentence = "read"
    except InputError as error:
        sentence = str(error)
    print(sentence)
    print(time.process_time() - start, peak() - before, flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def limited() -> Iterator[subprocess.Popen[str]]:
    """A process that reads each file named to it in a fork: imports once, a peak of memory per file."""
    with subprocess.Popen(
        [sys.executable, "-c", LIMITED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(timeout=60) == 0


@pytest.mark.parametrize("name", sorted(HUGE))
def test_huge_files_are_refused_soon_and_with_little_memory(
    name: str, limited: subprocess.Popen[str], tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(HUGE[name]())
    assert limited.stdin is not None
    assert limited.stdout is not None
    print(tmp_path / name, file=limited.stdin, flush=True)
    sentence, numbers = limited.stdout.readline(), limited.stdout.readline()
    assert sentence != "read\n"
    seconds, mebibytes = map(float, numbers.split())
    assert seconds < SECONDS, sentence
    assert mebibytes < 200, sentence


def test_a_large_file_is_refused_by_its_size(tmp_path: Path) -> None:
    for suffix in SUFFIXES:
        path = tmp_path / f"large{suffix}"
        with path.open("wb") as file:
            file.truncate(2**36)  # takes no room
        with pytest.raises(InputError, match="has 68719476736 bytes; expected at most"):
            read_source(path, KIND.get(suffix, "auto"))


def test_pipes_and_devices_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(InputError, match="not a folder, a pipe or a device"):
        read_source(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="not a folder, a pipe or a device"):
        read_source(tmp_path / "zero.csv")
    (tmp_path / "gone.csv").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="gone"):
        read_source(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_an_export_whose_numbers_are_none_is_refused(value: float, tmp_path: Path) -> None:
    """Parquet has no checksums: a changed value may be one that no store takes."""
    export(DataSet.of(recordings()), tmp_path / "good", "parquet")
    table = pq.read_table(tmp_path / "good" / "wrench.parquet")
    column = table.column("Fz").to_numpy().copy()
    column[3] = value
    at = table.column_names.index("Fz")
    pq.write_table(table.set_column(at, "Fz", pa.array(column)), tmp_path / "good" / "wrench.parquet")
    with pytest.raises(InputError, match="good is damaged: recording 0"):
        read_source(tmp_path / "good")


class _Opened:
    def __reduce__(self) -> tuple:
        return os.mkdir, ("opened-by-a-pickle",)


def test_pickles_are_never_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez(tmp_path / "a.npz", wrench=np.array([_Opened(), 1], object))
    np.save(tmp_path / "b.npy", np.array([_Opened(), 1], object))
    (tmp_path / "c.npy").write_bytes(pickle.dumps(_Opened()))
    (tmp_path / "d.npz").write_bytes(pickle.dumps(_Opened()))
    for path in sorted(tmp_path.glob("*.np*")):
        with pytest.raises(InputError):
            read_source(path)
    assert not (tmp_path / "opened-by-a-pickle").exists()


def test_links_inside_hdf5_are_not_followed(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["wrench"] = WRENCH
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["link"] = h5py.ExternalLink("secret.h5", "/wrench")
        file["loop"] = h5py.SoftLink("/")
    with pytest.raises(InputError, match="holds no array"):
        read_source(tmp_path / "a.h5")
