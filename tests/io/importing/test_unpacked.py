"""Packed files of text: read like those that they hold, within the limits."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing import unpacked
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from tests.io.importing.test_hostile import VALID

PACK = {".gz": gzip.compress, ".bz2": bz2.compress}


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize("suffix", [".csv", ".jsonl", ".json", ".ts"])
def test_a_packed_file_is_read_like_its_content(suffix: str, ending: str, tmp_path: Path) -> None:
    content = VALID[suffix]()
    (tmp_path / "plain").mkdir()
    (tmp_path / "packed").mkdir()
    (tmp_path / f"plain/run{suffix}").write_bytes(content)
    (tmp_path / f"packed/run{suffix}{ending}").write_bytes(PACK[ending](content))
    mapping = Mapping(source_rate=100.0) if suffix == ".ts" else Mapping()
    plain, packed = (read_source(tmp_path / folder, mapping=mapping) for folder in ("plain", "packed"))
    np.testing.assert_array_equal(packed.recordings.wrench, plain.recordings.wrench)
    assert packed.recordings.trial.tolist() == plain.recordings.trial.tolist()
    assert packed.report.understood == plain.report.understood


def test_annotations_and_tables_find_packed_recordings(tmp_path: Path) -> None:
    for number in range(2):
        rows = "".join(f"{k * 0.01},{(k * (number + 3)) % 7}\n" for k in range(90))
        (tmp_path / f"run{number}.csv.gz").write_bytes(gzip.compress(b"t,Fz\n" + rows.encode()))
    (tmp_path / "run0_labels.csv").write_text("label,start,end\npush,0.1,0.3\n")
    (tmp_path / "trials.csv.gz").write_bytes(gzip.compress(b"file,outcome\nrun0.csv,success\nrun1,failure\n"))
    recordings = read_source(tmp_path).recordings
    assert recordings.outcome.tolist() == ["success", "failure"]
    assert recordings.annotations.labels == {"label": ("push",)}
    for pattern in ("run0.csv", "run0.csv.gz", "*0.csv*"):
        assert read_source(tmp_path, mapping=Mapping(files=(pattern,))).recordings.trial.tolist() == ["run0"]


def test_a_file_and_its_packed_copy_are_one_recording(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_bytes(VALID[".csv"]())
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(VALID[".csv"]()))
    imported = read_source(tmp_path)
    assert len(imported.recordings) == 1
    assert len(imported.report.duplicates) == 1


@pytest.mark.parametrize("pack", PACK.values(), ids=PACK)
def test_damaged_and_endless_content_is_refused(pack: Callable[[bytes], bytes], tmp_path: Path, monkeypatch) -> None:
    ending = next(key for key, value in PACK.items() if value is pack)
    packed = pack(VALID[".csv"]())
    for content in (packed[:-30], packed[:20] + b"\xff" * 20 + packed[40:], b"t,Fz\n0,1\n1,2\n"):
        (tmp_path / f"run.csv{ending}").write_bytes(content)
        with pytest.raises(InputError, match=rf"run\.csv{ending} (is damaged|cannot be read)"):
            read_source(tmp_path / f"run.csv{ending}")
    monkeypatch.setattr(unpacked, "SMALL", 2**16)
    (tmp_path / f"run.csv{ending}").write_bytes(pack(b"0," * 2**22))
    with pytest.raises(InputError, match=r"unpacks to more than \d+ bytes; split it"):
        read_source(tmp_path / f"run.csv{ending}")
