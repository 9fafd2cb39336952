"""The work folder of a synthesis: ``manifest.json``, ``claims/``, and the unfinished store.

A shard is a batch of consecutive trials, and a part of the store; the manifest holds everything that determines its
content, so that workers share, and a later run resumes, only their own shards. A shard counts as finished when its
digest is there, which is written last: what a kill leaves of others is written again. Claims
(:mod:`sim_mjx.synthesis.claims`) record which worker makes which shard.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from rcbht_jax._util.atomic import atomic_new, delete
from rcbht_jax._util.checkpoint import first_difference
from rcbht_jax._util.printable import plural
from rcbht_jax._util.untrusted import check_readable, load_json
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_parts, parts, store_reader
from rcbht_jax.io.store_reader import Stored
from rcbht_jax.io.store_schema import LABELS, open_store
from sim_mjx.synthesis import claims, descriptions

MANIFEST, PARTIAL, WORK = "manifest.json", ".*.partial-*", ".work"
_TRIES = 25
DIGESTS = {  # described in words, since a digest says nothing to a reader
    "own_sha256": "your files", "scene_sha256": "what your files read", "sim_mjx_sha256": "the simulation's code",
    "encoding_sha256": "the encoder's code",
}  # fmt: skip
_OPTIONS = {  # of "rcbht simulate" as people know them, by their place in the manifest
    **{f"job.{name}": f"--{name}" for name in ("trials", "seed", "engine", "shard", "window")},
    "job.preset": "the preset or assembly", "job.spec.physical": "--physical",
    "job.spec.nominal_share": "--nominal-share", "job.spec.longest": "--max-seconds",
}  # fmt: skip


def folder_of(target: Path) -> Path:
    """The work folder that belongs to a store.

    Raises:
        InputError: the store has no name.
    """
    if not target.name:
        raise InputError(f'"{target}" is not a name for a store; expected for example trials.zarr.')
    return target.with_name(target.name + WORK)


def target_of(path: Path) -> Path:
    """The store that becomes of one in a work folder with a plan; any other store itself."""
    here = Path(os.path.realpath(path))
    inside = here == store_of(here.parent) and here.parent.suffix == WORK and has_plan(here.parent)
    return here.parent.with_suffix("") if inside else path


def begin(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Create a work folder, or make sure that an existing one is for the same shards.

    Args:
        folder: created if it does not exist.
        manifest: everything that determines the shards, JSON values; an existing folder must have the same.

    Raises:
        InputError: the folder holds other files or has another manifest.
    """
    for place in (folder, folder / claims.FOLDER):
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            raise InputError(f"{place} is a link or a file; move it away or choose another name.")
    folder.mkdir(exist_ok=True)
    _check_manifest(folder, manifest)
    (folder / claims.FOLDER).mkdir(exist_ok=True)


def renew(folder: Path, notice: Callable[[str], None] | None = None) -> None:
    """If no worker is active, delete the records of failed attempts, partial files and damaged shards.

    Args:
        folder: the work folder.
        notice: called with a sentence before shards are verified, which takes minutes if there are many.

    Raises:
        OSError, MemoryError: something cannot be read now; nothing of it is deleted.
    """
    with claims.wait_for(folder, "begin"):
        if any(tries[-1].state == "held" for task, tries in claims.board(folder).items() if task != "begin"):
            return
        claims.clear(folder)
        for leftover in [*folder.glob(PARTIAL), *store_of(folder).rglob("*.partial")]:
            delete(leftover)
        if not descriptions.are_intact(folder, store_of(folder)):
            delete(store_of(folder))
            delete(folder / descriptions.FILE)
        try:
            stored = Stored.of(store_of(folder), open_store(store_of(folder)))
            found = sorted(finished(folder))
            if found and notice is not None:
                notice(f"Verifying {plural(len(found), 'finished shard')}.")
            for shard, intact in zip(found, parts.each(partial(_is_intact, stored), found), strict=True):
                if not intact:
                    parts.discard(stored.path, shard)
        except InputError as error:  # no store yet, or a damaged one
            check_readable(error)
            delete(store_of(folder))


def store_of(folder: Path) -> Path:
    """The store that is being made."""
    return folder / "store.zarr"


def finished(folder: Path) -> set[int]:
    """Numbers of the finished shards; none if the folder is gone."""
    chunks = _digest(folder, 0).parent.parent
    try:
        names = os.listdir(chunks)
    except (FileNotFoundError, NotADirectoryError):
        return set()
    # called often: no Path objects
    return {int(name) for name in names if name.isdecimal() and os.path.exists(f"{chunks}/{name}/0")}


def finished_at(folder: Path) -> list[float]:
    """When each of the finished shards was finished, s, ascending."""
    times = []
    for shard in finished(folder):
        with suppress(FileNotFoundError):  # the folder is being removed
            times.append(_digest(folder, shard).stat().st_mtime)
    return sorted(times)


def has_plan(folder: Path) -> bool:
    """Whether there is a manifest: another process may have completed the store and removed it."""
    return (folder / MANIFEST).exists()


def task(shard: int) -> str:
    """Name of a shard's task, for its claims."""
    return f"{shard:06d}"


def remove(folder: Path) -> None:
    """Delete the shards, then the manifest: a kill leaves no shard without its manifest.

    The caller holds the claim "join" meanwhile, so that no worker makes a deleted shard again.
    """
    for entry in folder.iterdir():
        if entry.name not in (claims.FOLDER, MANIFEST):
            delete(entry)
    (folder / MANIFEST).unlink(missing_ok=True)


def close(folder: Path) -> None:
    """Delete what :func:`remove` left, once the claim is released: shared folders with open files cannot be deleted."""
    for _ in range(_TRIES):
        if not folder.is_dir() or (folder / MANIFEST).exists():  # gone, or begun anew
            return
        shutil.rmtree(folder / claims.FOLDER, ignore_errors=True)
        with suppress(OSError):  # another process is reading the claims
            folder.rmdir()
            return
        time.sleep(claims.POLL)


def as_json(value: Any) -> Any:
    """A value as JSON returns it: tuples become lists."""
    return json.loads(json.dumps(value))


def _digest(folder: Path, shard: int) -> Path:
    return store_of(folder) / parts.digest_file(shard)


def _is_intact(stored: Stored, shard: int) -> bool:
    """Whether all that the store holds of a shard, labels too, is as it was written."""
    try:
        store_reader.check_part(stored, shard)
        for labels in sorted((stored.path / LABELS).glob("*/zarr.json")):
            label_parts.check_part(labels.parent, shard)
    except InputError as error:
        check_readable(error)
        return False
    return True


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
            "Finish it with the same options, versions and kind of processor, choose another name, or delete it "
            "to begin anew."
        )


def _is_claims(entry: Path) -> bool:
    return entry.name == claims.FOLDER and entry.is_dir()


def _difference(existing: Any, wanted: Any) -> str:
    """The first value that differs, in words."""
    name, existing, wanted = first_difference(existing, wanted)
    last = name.rpartition(".")[2]
    if last in DIGESTS and existing and wanted:
        return f"another content of {DIGESTS[last]} ({last})"
    if existing is wanted is None:
        return f"other options (one of the manifests alone has {name})"
    if name in _OPTIONS and existing is None:
        return f"no {_OPTIONS[name]}, not with {json.dumps(wanted)}"
    said = "none" if wanted is None else json.dumps(wanted)
    return f"{_OPTIONS.get(name, name) or 'a manifest'} {json.dumps(existing)}, not {said}"
