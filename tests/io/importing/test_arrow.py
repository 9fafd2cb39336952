"""Tables in Arrow's own formats: as Parquet has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

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
