"""Decoders in a process of their own: what they make is the same, and their end is one sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from numpy.typing import NDArray

from rcbht_jax._util import untrusted
from rcbht_jax._util.optional import MissingPackage
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import arrays, columnar, matlab
from rcbht_jax.io.importing.isolated import Decode, _decoder, isolated
from rcbht_jax.io.importing.table import Table


def whole(path: Path, name: str) -> Iterator[Table]:
    """Every kind of value that a table can hold."""
    columns = {"t": np.arange(3.0), "odd/\udcff": np.array([np.nan, -0.0, 1e300]), "who": np.array(["a", "ü", ""])}
    yield Table(name, columns, 5.0, {"t": "s"}, {"dt": 0.1, "x": "y"}, (("track", "label", 0.0, 1.0),), ("note",))
    yield Table("empty", {"n": np.zeros(0, np.int64)})


def mistakes(path: Path, name: str) -> Iterator[Table]:
    raise ValueError(name)


def crashes(path: Path, name: str) -> Iterator[Table]:
    os.kill(os.getpid(), signal.SIGSEGV)
    yield Table(name, {})


def hangs(path: Path, name: str) -> Iterator[Table]:
    os.write(1, b"decoders print")
    while name:
        pass
    yield Table(name, {})


def waits(path: Path, name: str) -> Iterator[Table]:
    time.sleep(600)
    yield Table(name, {})


def floods(path: Path, name: str) -> Iterator[Table]:
    yield Table(name, {"x": np.ones(2**30)})


def imports(path: Path, name: str) -> Iterator[Table]:
    import slow_library  # type: ignore[import-not-found]  # noqa: F401

    yield Table(name, {"seconds": np.array([time.process_time()])})


def refuses(path: Path, name: str) -> Iterator[Table]:
    raise InputError(f"{path} is odd.")
    yield Table(name, {})


def lacks(path: Path, name: str) -> Iterator[Table]:
    raise MissingPackage("h5py", "import")
    yield Table(name, {})


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file beside which this process works, so that its name is relative."""
    monkeypatch.chdir(tmp_path)
    Path("a.bin").write_bytes(b"x")
    return Path("a.bin")


def test_tables_come_back_as_they_were(file: Path) -> None:
    for found, made in zip(isolated(whole, file, "n"), whole(file, "n"), strict=True):
        assert {**vars(found), "columns": 0} == {**vars(made), "columns": 0}
        for (key, left), (name, right) in zip(found.columns.items(), made.columns.items(), strict=True):
            assert (key, left.dtype, left.tobytes()) == (name, right.dtype, right.tobytes())


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of memory and signals as on Linux")
def test_crash_hang_and_flood_are_a_sentence_and_the_next_file_is_read(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"^a.bin is damaged: what decodes such files crashed \(status -11\)\.$"):
        list(isolated(crashes, file, "n"))
    with pytest.raises(InputError, match=r"^a.bin is damaged: what decodes such files crashed \(status 1\)\.$"):
        list(isolated(mistakes, file, "n"))
    with pytest.raises(InputError, match=r"^a.bin is damaged: it asks for more memory than there is"):
        list(isolated(floods, file, "n"))
    with monkeypatch.context() as patch:
        patch.setattr(untrusted, "DECODER_SECONDS", -0.9)  # and 1 s for what a small file may unpack to
        with pytest.raises(InputError, match=r"^a.bin is damaged: what decodes such files was stopped after 0 s\.$"):
            list(isolated(hangs, file, "n"))
        patch.setattr("rcbht_jax.io.importing.isolated.DECODER_PATIENCE", 0.5)
        with pytest.raises(InputError, match=r"^a.bin was not decoded within 1 s; try again when the machine is idle"):
            list(isolated(waits, file, "n"))
    assert len(list(isolated(whole, file, "n"))) == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of a processor's time as on Linux")
def test_importing_a_library_takes_none_of_the_time_of_a_file(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("slow_library.py").write_text("import time\nwhile time.process_time() < 3:\n    pass\n")
    monkeypatch.syspath_prepend(os.getcwd())
    _decoder(os.getpid()).close()  # one that is begun anew finds the library
    monkeypatch.setattr(untrusted, "DECODER_SECONDS", -0.6)  # and 1 s for what a small file may unpack to
    assert len(list(isolated(whole, file, "n"))) == 2  # the time of one file is no limit for what the next one imports
    [table] = isolated(imports, file, "n", "slow_library", "no_such_library")
    assert table.columns["seconds"] >= 3
    _decoder(os.getpid()).close()
    with pytest.raises(InputError, match="what decodes such files was stopped after 0 s"):
        list(isolated(imports, file, "n"))  # a library that nobody named counts


def parquet(path: Path, columns: dict[str, NDArray[np.float64]]) -> None:
    pq.write_table(pa.table(columns), path)


def hdf5(path: Path, columns: dict[str, NDArray[np.float64]]) -> None:
    with h5py.File(path, "w") as file:
        for key, values in columns.items():
            file[key] = values


READERS = {"parquet": (columnar, parquet), "hdf5": (arrays, hdf5), "matlab": (matlab, scipy.io.savemat)}


@pytest.mark.parametrize("kind", READERS)
def test_a_decoder_imports_nothing_but_the_libraries_that_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    asked: list[tuple[str, ...]] = []

    def ask(decode: Decode, path: Path, name: str, *libraries: str) -> Iterator[Table]:
        asked.append((decode.__name__, *libraries))
        yield from ()

    (module, save), made = READERS[kind], tmp_path / "a"
    save(made, {"time": np.arange(400) / 100, "Fz": np.zeros(400)})
    monkeypatch.setattr("rcbht_jax.io.importing.isolated.isolated", ask)
    list(getattr(module, f"read_{kind}")(made, "n"))
    [(decode, *libraries)] = asked
    lines = (
        "import importlib, inspect, os, pathlib, sys",
        f"decode = inspect.unwrap(importlib.import_module({module.__name__!r}).{decode})",
        f"[importlib.import_module(one) for one in {libraries!r}]",
        "before = set(sys.modules)",
        f"[table] = decode(pathlib.Path({str(made)!r}), 'n')",
        "assert len(table.columns) == 2",
        "print(*set(sys.modules) - before, flush=True)",
        "os._exit(0)",  # as the child is ended: Arrow's threads may abort an orderly exit
    )
    ran = subprocess.run([sys.executable, "-c", "\n".join(lines)], check=False, capture_output=True, text=True)
    assert (ran.returncode, ran.stdout.split()) == (0, []), ran.stderr


def test_sentences_pass_with_the_name_that_was_given(file: Path) -> None:
    with pytest.raises(InputError, match=r"^a.bin is odd\.$"):
        list(isolated(refuses, file, "n"))
    with pytest.raises(MissingPackage, match=r"h5py is not installed"):
        list(isolated(lacks, file, "n"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads as Linux lists them")
@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_a_machine_of_many_cores_decodes_with_no_more_threads(tmp_path: Path, suffix: str) -> None:
    table, path = pa.table({f"a{number}": np.arange(2000.0) for number in range(64)}), tmp_path / f"a{suffix}"
    if suffix == ".parquet":
        pq.write_table(table, path)
    else:
        with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema) as writer:
            writer.write_table(table)
    lines = (
        "import os, pathlib, pandas, pyarrow.parquet",
        "from rcbht_jax.io.importing.columnar import read_parquet",
        "pyarrow.set_cpu_count(32)",
        "before = len(os.listdir('/proc/self/task'))",
        f"[table] = read_parquet.__wrapped__(pathlib.Path({str(path)!r}), 'n')",
        "assert len(table.columns) == 64",
        "print(len(os.listdir('/proc/self/task')) - before, flush=True)",
        "os._exit(0)",
    )
    ran = subprocess.run([sys.executable, "-c", "\n".join(lines)], check=False, capture_output=True, text=True)
    assert int(ran.stdout) <= 8, ran.stderr  # those of input and output, however many cores
