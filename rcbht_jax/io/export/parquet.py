"""Parquet files that grow piece by piece."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util.optional import require

ROWS = 2**18


class ParquetFiles:
    """Parquet files that grow piece by piece; what is added at once is in one row group.

    A row group takes memory until its file is closed, so that a row group per recording would not do.

    Args:
        folder: of the files.
        metadata: of files, by their names without suffix.
        rows: of a file, at which a row group is full; default ``ROWS``.
    """

    def __init__(
        self, folder: Path, metadata: Mapping[str, Mapping[str, str]] | None = None, rows: int | None = None
    ) -> None:
        self._pa, self._pq = require("pyarrow", "export"), require("pyarrow.parquet", "export")
        self._folder, self._metadata, self._rows = folder, metadata or {}, ROWS if rows is None else rows
        self._waiting: dict[str, list[Any]] = {}
        self._writers: dict[str, Any] = {}

    def __enter__(self) -> ParquetFiles:
        return self

    def __exit__(self, *_: object) -> None:
        for writer in self._writers.values():
            writer.close()

    def add(self, title: str, rows: Mapping[str, Any]) -> None:
        """Append rows to a file."""
        waiting = self._waiting.setdefault(title, [])
        columns = {name: self._column(values) for name, values in rows.items()}
        waiting.append(self._pa.table(columns).replace_schema_metadata(self._metadata.get(title)))
        if sum(len(table) for table in waiting) >= self._rows:
            self._write(title)

    def flush(self) -> None:
        """Write what waits for its row group to be full."""
        for title in self._waiting:
            self._write(title)

    def _column(self, values: Any) -> Any:
        if isinstance(values, np.ndarray) and values.dtype.kind == "U":  # of which pyarrow takes what precedes a NUL
            return self._pa.array(values.tolist(), self._pa.string())
        return self._pa.array(values)

    def _write(self, title: str) -> None:
        if waiting := self._waiting[title]:
            if title not in self._writers:
                path = self._folder / f"{title}.parquet"
                self._writers[title] = self._pq.ParquetWriter(path, waiting[0].schema)
            table = self._pa.concat_tables(waiting)
            self._writers[title].write_table(table, row_group_size=len(table) or None)
            self._waiting[title] = []
