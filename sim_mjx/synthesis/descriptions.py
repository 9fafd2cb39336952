"""What a growing store holds before its parts, and has no checksum yet: descriptions (``zarr.json``), small arrays."""

from __future__ import annotations

import json
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

from rcbht_jax._util.atomic import atomic_new
from rcbht_jax._util.untrusted import MAX_JSON_BYTES, check_readable, load_json, parse_json, read_bytes
from rcbht_jax.io.store_schema import GAPS, HASH

FILE = "descriptions.json"  # in the work folder
DIVERGED = "diverged"
_ADDED = (DIVERGED, GAPS, HASH)  # attributes of a table that is complete, in this order
_COLLECTED = "consolidated_metadata"


def keep(folder: Path, store: Path) -> None:
    """Record the files of a store that has no parts yet."""
    files = (file for file in sorted(store.rglob("*")) if file.is_file())
    texts = {str(file.relative_to(store)): _text(file) for file in files}
    with suppress(FileExistsError), atomic_new(folder / FILE) as draft:  # all workers would write the same
        draft.write_text(json.dumps(texts))


def are_intact(folder: Path, store: Path) -> bool:
    """Whether the files are the recorded ones, except for dimensions that grow and attributes that completion adds.

    Raises:
        OSError: one cannot be read now.
    """
    try:
        texts = load_json(folder / FILE)
        there = {name: _text(store / name) for name in texts}
        return _holds_files(store, texts) and all(
            there[name] == text or _is_grown(text, there[name]) for name, text in texts.items()
        )
    except (OSError, ValueError, AttributeError, KeyError, TypeError) as error:  # whatever a damaged file can hold
        check_readable(error)
        return False


def _holds_files(store: Path, noted: Collection[str]) -> bool:
    """Whether there are only files and folders, and chunks in folders: no part is written through a link."""
    return all(_is_part(path, str(path.relative_to(store)) in noted) for path in [store, *store.rglob("*")])


def _is_part(path: Path, noted: bool) -> bool:
    if path.is_symlink():
        return False
    return path.is_dir() or (path.is_file() and (noted or path.name != "c"))  # that of a scalar is recorded


def _text(file: Path) -> str:
    """A description as it is; a chunk of an array, which never changes, as text that is no JSON."""
    content = read_bytes(file, MAX_JSON_BYTES)
    return content.decode() if file.name == "zarr.json" else f"bytes {content.hex()}"


def _is_grown(recorded: str, text: str) -> bool:
    """Whether a description is the recorded one of an array that has grown, or of a table that was completed."""
    noted, found = (parse_json(one, finite=False) for one in (recorded, text))
    if noted["node_type"] == "array":
        return _is_longer(noted, found["shape"], text)
    return _is_completed(noted, found)


def _is_longer(noted: dict[str, Any], shape: Any, text: str) -> bool:
    """Whether an array is the recorded one, except for dimensions of length 0 that have grown."""
    if len(shape) != len(noted["shape"]) or any(
        not isinstance(new, int) or (old and new != old) for old, new in zip(noted["shape"], shape, strict=True)
    ):
        return False
    return text == json.dumps(noted | {"shape": shape}, indent=2)  # as ``rcbht_jax.io.parts`` writes it


def _is_completed(noted: dict[str, Any], found: dict[str, Any]) -> bool:
    """Whether a group is the recorded one of a table, except for attributes that completion adds.

    Compared as text, because the order of attributes counts, too.
    """
    attributes = noted["attributes"]
    added = {name: found["attributes"][name] for name in _ADDED if name in found["attributes"]}
    wanted = noted | {"attributes": attributes | added}
    plain = [{key: value for key, value in one.items() if key != _COLLECTED} for one in (wanted, found)]
    return "part_rows" in attributes and json.dumps(plain[0]) == json.dumps(plain[1])
