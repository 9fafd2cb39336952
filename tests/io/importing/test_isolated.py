"""Decoders in a process of their own: what they make is the same, and their end is one sentence."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util import untrusted
from rcbht_jax._util.optional import MissingPackage
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.isolated import isolated
from rcbht_jax.io.importing.table import Table


def whole(path: Path, name: str) -> Iterator[Table]:
    """Every kind of value that a table can hold."""
    columns = {"t": np.arange(3.0), "odd/\udcff": np.array([np.nan, -0.0, 1e300]), "who": np.array(["a", "ü", ""])}
    yield Table(name, columns, 5.0, {"t": "s"}, {"dt": 0.1, "x": "y"}, (("track", "label", 0.0, 1.0),), ("note",))
    yield Table("empty", {"n": np.zeros(0, np.int64)})


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
    with pytest.raises(InputError, match=r"^a.bin is damaged: it asks for more memory than there is"):
        list(isolated(floods, file, "n"))
    with monkeypatch.context() as patch:
        patch.setattr(untrusted, "DECODER_SECONDS", -0.6)  # and 1 s for what a small file may unpack to
        for start in (1.0, 0.0):  # the first file of a kind has this longer: the library is imported with it
            patch.setattr("rcbht_jax.io.importing.isolated.DECODER_START", start)
            words = rf"^a.bin is damaged: what decodes such files was stopped after {start:.0f} s\.$"
            with pytest.raises(InputError, match=words):
                list(isolated(hangs, file, "n"))
        patch.setattr("rcbht_jax.io.importing.isolated.DECODER_PATIENCE", 0.5)
        with pytest.raises(InputError, match=r"^a.bin was not decoded within 4 s; try again when the machine is idle"):
            list(isolated(waits, file, "n"))
    assert len(list(isolated(whole, file, "n"))) == 2


def test_sentences_pass_with_the_name_that_was_given(file: Path) -> None:
    with pytest.raises(InputError, match=r"^a.bin is odd\.$"):
        list(isolated(refuses, file, "n"))
    with pytest.raises(MissingPackage, match=r"h5py is not installed"):
        list(isolated(lacks, file, "n"))
