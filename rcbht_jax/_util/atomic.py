"""Files and folders that appear complete or not at all, also after a kill or a power cut.

A draft is written beside its target and renamed when complete. A killed process leaves at most a draft, whose name
begins with a dot and contains ".partial-".
"""

from __future__ import annotations

import os
import shutil
import signal
import threading
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from rcbht_jax.errors import InputError

_FLUSHES = 16  # files that are flushed at the same time


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a draft of the file ``path``, with the same suffix; on success it replaces ``path``, else it is removed.

    Behind a link the file that it points to is replaced, so that the link stays.

    >>> with atomic_write(Path("limits.json")) as draft:  # doctest: +SKIP
    ...     draft.write_text("{}")

    Raises:
        InputError: ``path`` is a folder, a device or a pipe, which no file may replace.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is not a regular file; expected a name for a new file, or of a file to replace.")
    path = path.resolve() if path.is_symlink() else path
    draft = draft_of(path)
    try:
        yield draft
        _flush(draft)
        draft.replace(path)
        _flush(path.parent)  # the rename itself must survive a power cut
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def atomic_new(path: Path) -> Iterator[Path]:
    """As :func:`atomic_write` for a file that must not exist: of several processes only one makes it.

    >>> with atomic_new(Path("manifest.json")) as draft:  # doctest: +SKIP
    ...     draft.write_text("{}")

    Raises:
        FileExistsError: ``path`` exists; it is left as it is.
    """
    draft = draft_of(path)
    try:
        yield draft
        _flush(draft)
        os.link(draft, path)
        _flush(path.parent)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path, near: Path | None = None) -> Iterator[Path]:
    """Give the name of a draft folder to create; on success it replaces the folder ``path``, else it is removed.

    Args:
        path: folder to create or replace.
        near: whose sibling the draft is; default ``path``.
    """
    draft = draft_of(path if near is None else near)
    try:
        yield draft
        flush_tree(draft)
        _swap(draft, path)
        _flush(path.parent)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def draft_of(path: Path) -> Path:
    """A new hidden name beside ``path`` with the same suffix."""
    return path.with_name(f".{path.stem}.partial-{uuid.uuid4().hex[:12]}{path.suffix}")


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C until the block is done; outside the main thread, which never receives it, do nothing.

    For libraries with background tasks (Zarr): interrupted, they would go on writing into a draft being removed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if pressed:
        raise KeyboardInterrupt


def flush_tree(folder: Path) -> None:
    """Have a folder and all that it holds on disk, so that what it replaces can be deleted."""
    with ThreadPoolExecutor(_FLUSHES) as pool:  # each waits for the disk, which does many at once
        for _ in pool.map(_flush, (entry for entry in folder.rglob("*") if not entry.is_symlink())):
            pass
    _flush(folder)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _swap(draft: Path, path: Path) -> None:
    if not path.exists():
        draft.rename(path)
        return
    old = draft.with_name(f"{draft.name}-old")
    path.rename(old)
    try:
        draft.rename(path)
    except BaseException:
        old.rename(path)
        raise
    shutil.rmtree(old, ignore_errors=True)
