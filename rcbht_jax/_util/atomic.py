"""Files that are there whole or not at all."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary sibling of ``path`` to write; on success it takes its place, on failure it is removed.

    It has the suffix of ``path``. A killed process leaves at most a file whose name begins with a dot and contains
    ".partial-". Folders: :func:`rcbht_jax.io.zarr.replacing`.
    """
    draft = path.with_name(f".{path.stem}.partial-{uuid.uuid4().hex[:12]}{path.suffix}")
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
