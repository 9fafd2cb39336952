"""The work folder of a synthesis: ``manifest.json``, one checksummed file per finished shard, and ``claims/``.

A shard is a batch of consecutive trials; the manifest holds everything that determines their content, so that workers
share, and a later run resumes, only their own shards. Files are written atomically: a kill leaves finished shards and
at most one partial file, which a run that finds nobody at work deletes. Who is at work on what tell the claims
(:mod:`sim_mjx.synthesis.claims`).
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from rcbht_jax._util.atomic import atomic_new
from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.untrusted import load_json, read_arrays
from rcbht_jax.errors import InputError
from sim_mjx.synthesis import claims

MANIFEST, PARTIAL = "manifest.json", ".*.partial-*"
_TRIES = 25
Arrays = dict[str, Shaped[np.ndarray, "_row ..."]]  # by name


def folder_of(target: Path) -> Path:
    """The work folder that belongs to a store.

    Raises:
        InputError: the store has no name.
    """
    if not target.name:
        raise InputError(f'"{target}" is not a name for a store; expected for example trials.zarr.')
    return target.with_name(f"{target.name}.work")


def begin(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Create a work folder, or make sure that an existing one is for the same shards.

    Args:
        folder: created if it does not exist.
        manifest: everything that determines the shards, JSON values; an existing folder must have the same.

    Raises:
        InputError: the folder holds other files or has another manifest.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder} is a link or a file; move it away or choose another name.")
    folder.mkdir(exist_ok=True)
    _check_manifest(folder, manifest)
    (folder / claims.FOLDER).mkdir(exist_ok=True)


def renew(folder: Path) -> None:
    """Where nobody is at work: forget failed attempts and delete partial files and damaged shards."""
    with claims.wait_for(folder, "begin"):
        if any(tries[-1].state == "held" for task, tries in claims.board(folder).items() if task != "begin"):
            return
        claims.clear(folder)
        for leftover in folder.glob(PARTIAL):
            leftover.unlink(missing_ok=True)
        for shard in finished(folder):
            if load(folder, shard) is None:
                _file(folder, shard).unlink(missing_ok=True)


def finished(folder: Path) -> set[int]:
    """Numbers of the shards that are there; none where the folder is gone."""
    try:
        names = os.listdir(folder)
    except FileNotFoundError:
        return set()
    return {int(name[6:-4]) for name in names if name.startswith("shard-") and name.endswith(".npz")}


def has_plan(folder: Path) -> bool:
    """Whether there is a manifest: another process may have joined all shards and removed it."""
    return (folder / MANIFEST).exists()


def task(shard: int) -> str:
    """What a claim on a shard is called."""
    return f"{shard:06d}"


def save(folder: Path, shard: int, arrays: Arrays) -> None:
    """Write a finished shard."""
    digest = np.array(content_hash(arrays[name] for name in sorted(arrays)))
    with suppress(FileExistsError), atomic_new(_file(folder, shard)) as draft:  # another worker's is as good
        # not compressed: noisy wrenches hardly shrink, and it would take longer than simulating them on a GPU
        np.savez(draft, allow_pickle=False, sha256=digest, **arrays)


def load(folder: Path, shard: int) -> Arrays | None:
    """A finished shard; None if it is missing or damaged and must be simulated again."""
    try:
        arrays = read_arrays(_file(folder, shard))
    except Exception:  # a damaged archive can fail in any way inside zipfile and NumPy
        return None
    digest = arrays.pop("sha256", None)
    intact = digest is not None and str(digest) == content_hash(arrays[name] for name in sorted(arrays))
    return arrays if intact else None


def remove(folder: Path) -> None:
    """Delete the shards, then the manifest: a kill leaves no shard without its manifest.

    The caller holds the claim "join" meanwhile, so that nobody makes a deleted shard again.
    """
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != claims.FOLDER:
            shutil.rmtree(entry)
        elif entry.is_file() and entry.name != MANIFEST:
            entry.unlink(missing_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)


def close(folder: Path) -> None:
    """Delete what :func:`remove` left, once the claim is given back: open files can keep a shared folder from going."""
    for _ in range(_TRIES):
        if not folder.is_dir() or (folder / MANIFEST).exists():  # gone, or begun anew
            return
        shutil.rmtree(folder / claims.FOLDER, ignore_errors=True)
        with suppress(OSError):  # another process has just looked for claims
            folder.rmdir()
            return
        time.sleep(claims.POLL)


def as_json(value: Any) -> Any:
    """A value as JSON returns it: tuples become lists."""
    return json.loads(json.dumps(value))


def _file(folder: Path, shard: int) -> Path:
    return folder / f"shard-{shard:06d}.npz"


def _check_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    path = folder / MANIFEST
    wanted = as_json(manifest)
    if not path.exists():
        foreign = [entry.name for entry in folder.iterdir() if not (entry.match(PARTIAL) or _is_claims(entry))]
        if foreign and not path.exists():  # it may have come meanwhile, and shards with it
            raise InputError(f"{folder} holds {foreign[0]} and no {MANIFEST}; move it away or choose another name.")
        with suppress(FileExistsError), atomic_new(path) as draft:
            draft.write_text(json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False))
    try:
        existing = load_json(path)
    except ValueError as error:
        raise InputError(f"{path} is damaged; delete {folder} to begin anew.") from error
    if existing != wanted:
        raise InputError(
            f"{folder} was begun with {_difference(existing, wanted)}. "
            "Finish it with the same options, choose another name, or delete it to begin anew."
        )


def _is_claims(entry: Path) -> bool:
    return entry.name == claims.FOLDER and entry.is_dir()


def _difference(existing: Any, wanted: Any, name: str = "") -> str:
    """The first value that differs, in words."""
    if isinstance(existing, dict) and isinstance(wanted, dict):
        for key in sorted({*existing, *wanted}):
            if existing.get(key) != wanted.get(key):
                return _difference(existing.get(key), wanted.get(key), f"{name}.{key}" if name else key)
    return f"{name or 'a manifest'} {json.dumps(existing)}, not {json.dumps(wanted)}"
