"""Tables in Arrow's own formats: as Parquet has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.labels import AXES
from tests.io.importing.test_readers import TIME, WRENCH

FRAME = pd.DataFrame({"time": TIME, **dict(zip(AXES, WRENCH.T, strict=True)), "phase": ["free"] * len(TIME)})


def write(path: Path, compression: str | None) -> None:
    table = pa.Table.from_pandas(FRAME)
    options = pa.ipc.IpcWriteOptions(compression=compression)
    make = pa.ipc.new_stream if path.suffix == ".arrow" else pa.ipc.new_file
    with path.open("wb") as raw, make(raw, table.schema, options=options) as file:
        file.write_table(table)


@pytest.mark.parametrize("suffix", [".feather", ".arrow"])
@pytest.mark.parametrize("compression", [None, "zstd", "lz4"])
def test_files_and_streams_of_arrow_are_tables(suffix: str, compression: str | None, tmp_path: Path) -> None:
    write(tmp_path / f"run{suffix}", compression)
    recordings = read_source(tmp_path).recordings
    assert recordings.axes == AXES
    np.testing.assert_allclose(recordings.wrench[0], WRENCH, rtol=1e-6)
    content = (tmp_path / f"run{suffix}").read_bytes()
    for cut in (3, 200, len(content) // 2):
        (tmp_path / f"run{suffix}").write_bytes(content[:cut])
        with pytest.raises(InputError, match=r"is not a readable Parquet or Arrow file|is damaged"):
            read_source(tmp_path / f"run{suffix}")


@pytest.mark.parametrize("size", [-1, 6], ids=["lists", "lists of fixed size"])
@pytest.mark.parametrize("missing", [None, []])
def test_a_missing_list_is_a_missing_sample_and_ragged_lists_are_named(
    size: int, missing: list[float] | None, tmp_path: Path
) -> None:
    rows: list[list[float] | None] = WRENCH.tolist()
    rows[7] = missing if size < 0 else None
    ragged = [[0.0] * (1 + k % 3) for k in range(len(TIME))]
    wrench = pa.array(rows, pa.list_(pa.float64(), size))
    parquet.write_table(pa.table({"time": TIME, "wrench": wrench, "contacts": ragged}), tmp_path / "run.parquet")
    imported = read_source(tmp_path)
    assert imported.recordings.axes == AXES
    assert imported.recordings.note.tolist() == ["missing:1"]
    np.testing.assert_allclose(np.delete(imported.recordings.wrench[0], 7, 0), np.delete(WRENCH, 7, 0), rtol=1e-6)
    assert "Arrays of another shape or kind were left out: 'contacts'." in imported.report.remarks


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_a_time_of_day_is_a_time(unit: str, per_second: int, tmp_path: Path) -> None:
    counts = [43_200 * per_second + round(time * per_second) for time in TIME.tolist()]
    times = pa.array(counts, pa.time32(unit) if unit == "ms" else pa.time64(unit))
    columns = {"date": pa.array([20_000] * len(TIME), pa.date32()), "time": times, "Fz": WRENCH[:, 2]}
    parquet.write_table(pa.table(columns), tmp_path / "run.parquet")
    recordings = read_source(tmp_path).recordings
    assert recordings.dt == pytest.approx(TIME[1] - TIME[0])
    assert recordings.columns["date"].tolist() == ["2024-10-04"]
