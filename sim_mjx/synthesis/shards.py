"""The work folder of a synthesis: a manifest and one complete, checksummed file per finished shard.

Everything is written to a temporary name, flushed to the disk and renamed: a kill at any moment leaves finished
shards and at most one file that is thrown away.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import content_hash
from rcbht_jax.errors import InputError

MANIFEST, LOCK, PARTIAL = "manifest.json", "lock", ".partial"
Arrays = dict[str, NDArray[Any]]


def folder_of(target: Path) -> Path:
    """The work folder that belongs to a store."""
    return target.with_name(f"{target.name}.work")


@contextmanager
def working(folder: Path, manifest: Mapping[str, Any]) -> Iterator[None]:
    """Begin or resume the work in a folder, which nobody else works in meanwhile.

    Args:
        folder: made if it is not there.
        manifest: everything that determines the shards, JSON values; an interrupted run must have had the same.

    Raises:
        InputError: the folder belongs to something else, to other options, or to a run that is still going.
    """
    folder.mkdir(exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder} is being worked in by another rcbht simulate; wait for it.") from None
        _check_manifest(folder, manifest)
        for leftover in folder.glob(f"*{PARTIAL}"):
            leftover.unlink()
        yield


def save(folder: Path, shard: int, arrays: Arrays) -> None:
    """Write a finished shard, atomically."""
    digest = np.array(content_hash(arrays[name] for name in sorted(arrays)))

    def write(file: IO[bytes]) -> None:
        # not compressed: noisy wrenches hardly shrink, and it would take longer than simulating them on a GPU
        np.savez(file, allow_pickle=False, sha256=digest, **arrays)

    write_atomically(_file(folder, shard), write)


def load(folder: Path, shard: int) -> Arrays | None:
    """A finished shard; None if it is missing or damaged and must be made again."""
    try:
        # opened here, because NumPy leaves a damaged file open
        with _file(folder, shard).open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (FileNotFoundError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    digest = arrays.pop("sha256", None)
    good = digest is not None and str(digest) == content_hash(arrays[name] for name in sorted(arrays))
    return arrays if good else None


def remove(folder: Path) -> None:
    """Delete a work folder: the manifest after all that it explains, so that a kill leaves nothing unexplained."""
    for entry in folder.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        elif entry.name not in (MANIFEST, LOCK):
            entry.unlink()
    (folder / MANIFEST).unlink()
    (folder / LOCK).unlink()
    folder.rmdir()


def as_json(value: Any) -> Any:
    """A JSON value as it is after being written and read: tuples are lists."""
    return json.loads(json.dumps(value))


def _file(folder: Path, shard: int) -> Path:
    return folder / f"shard-{shard:06d}.npz"


def _check_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    path = folder / MANIFEST
    wanted = as_json(manifest)
    if not path.exists():
        foreign = [entry.name for entry in folder.iterdir() if entry.name != LOCK and entry.suffix != PARTIAL]
        if foreign:
            raise InputError(f"{folder} holds {foreign[0]} and no {MANIFEST}; move it away or choose another name.")
        text = json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False)
        write_atomically(path, lambda file: file.write(text.encode()))
        return
    try:
        found = json.loads(path.read_text())
    except ValueError as error:
        raise InputError(f"{path} is damaged; delete {folder} to begin anew.") from error
    if found != wanted:
        raise InputError(
            f"{folder} was begun with {_difference(found, wanted)}. "
            "Finish it with the same options, choose another name, or delete it to begin anew."
        )


def _difference(found: Any, wanted: Any, name: str = "") -> str:
    """The first value that differs, in words."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in sorted({*found, *wanted}):
            if found.get(key) != wanted.get(key):
                return _difference(found.get(key), wanted.get(key), f"{name}.{key}" if name else key)
    return f"{name or 'a manifest'} {json.dumps(found)}, not {json.dumps(wanted)}"


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    draft = path.with_name(path.name + PARTIAL)
    try:
        with draft.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    # the rename itself must survive a power cut
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
