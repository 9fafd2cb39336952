"""The work folder of a synthesis: ``manifest.json`` and one checksummed file per finished shard.

A shard is a batch of consecutive trials; the manifest holds everything that determines their content, so that a run
resumes only its own shards. Files are written atomically: a kill leaves finished shards and at most one partial file,
which the next run deletes.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.json_file import load_json
from rcbht_jax.errors import InputError

MANIFEST, PARTIAL = "manifest.json", ".*.partial-*"
Arrays = dict[str, Shaped[np.ndarray, "_row ..."]]  # by name


def folder_of(target: Path) -> Path:
    """The work folder that belongs to a store.

    Raises:
        InputError: the store has no name.
    """
    if not target.name:
        raise InputError(f'"{target}" is not a name for a store; expected for example trials.zarr.')
    return target.with_name(f"{target.name}.work")


@contextmanager
def working(folder: Path, manifest: Mapping[str, Any]) -> Iterator[None]:
    """Create or resume a work folder and lock it against other processes.

    Args:
        folder: created if it does not exist.
        manifest: everything that determines the shards, JSON values; an existing folder must have the same.

    Raises:
        InputError: the folder holds other files, has another manifest, or is locked.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder} is a link or a file; move it away or choose another name.")
    folder.mkdir(exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)  # the folder itself: a file in it might be somebody else's
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder} is being worked in by another rcbht simulate; wait for it.") from None
        _check_manifest(folder, manifest)
        for leftover in folder.glob(PARTIAL):
            leftover.unlink()
        yield
    finally:
        os.close(lock)


def save(folder: Path, shard: int, arrays: Arrays) -> None:
    """Write a finished shard."""
    digest = np.array(content_hash(arrays[name] for name in sorted(arrays)))
    with atomic_write(_file(folder, shard)) as draft:
        # not compressed: noisy wrenches hardly shrink, and it would take longer than simulating them on a GPU
        np.savez(draft, allow_pickle=False, sha256=digest, **arrays)


def load(folder: Path, shard: int) -> Arrays | None:
    """A finished shard; None if it is missing or damaged and must be simulated again."""
    try:
        # opened here, because NumPy leaves a damaged file open
        with _file(folder, shard).open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception:  # a damaged archive can fail in any way inside zipfile and NumPy
        return None
    digest = arrays.pop("sha256", None)
    intact = digest is not None and str(digest) == content_hash(arrays[name] for name in sorted(arrays))
    return arrays if intact else None


def remove(folder: Path) -> None:
    """Delete a work folder, the manifest after the shards: a kill leaves none without its manifest."""
    for entry in folder.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        elif entry.name != MANIFEST:
            entry.unlink()
    (folder / MANIFEST).unlink()
    folder.rmdir()


def as_json(value: Any) -> Any:
    """A value as JSON returns it: tuples become lists."""
    return json.loads(json.dumps(value))


def _file(folder: Path, shard: int) -> Path:
    return folder / f"shard-{shard:06d}.npz"


def _check_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    path = folder / MANIFEST
    wanted = as_json(manifest)
    if not path.exists():
        foreign = [entry.name for entry in folder.iterdir() if not entry.match(PARTIAL)]
        if foreign:
            raise InputError(f"{folder} holds {foreign[0]} and no {MANIFEST}; move it away or choose another name.")
        with atomic_write(path) as draft:
            draft.write_text(json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False))
        return
    try:
        existing = load_json(path)
    except ValueError as error:
        raise InputError(f"{path} is damaged; delete {folder} to begin anew.") from error
    if existing != wanted:
        raise InputError(
            f"{folder} was begun with {_difference(existing, wanted)}. "
            "Finish it with the same options, choose another name, or delete it to begin anew."
        )


def _difference(existing: Any, wanted: Any, name: str = "") -> str:
    """The first value that differs, in words."""
    if isinstance(existing, dict) and isinstance(wanted, dict):
        for key in sorted({*existing, *wanted}):
            if existing.get(key) != wanted.get(key):
                return _difference(existing.get(key), wanted.get(key), f"{name}.{key}" if name else key)
    return f"{name or 'a manifest'} {json.dumps(existing)}, not {json.dumps(wanted)}"
