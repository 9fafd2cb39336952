"""Descriptions (``zarr.json``) of the arrays of a growing store, which have no checksum until it is complete."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from rcbht_jax._util.atomic import atomic_new
from rcbht_jax._util.untrusted import MAX_JSON_BYTES, load_json, read_bytes

FILE = "descriptions.json"  # in the work folder


def keep(folder: Path, store: Path) -> None:
    """Note the descriptions of a store in which all parts are missing."""
    files = {str(file.relative_to(store)): file.read_text() for file in sorted(store.rglob("zarr.json"))}
    texts = {name: text for name, text in files.items() if json.loads(text)["node_type"] == "array"}
    with suppress(FileExistsError), atomic_new(folder / FILE) as draft:  # all workers would write the same
        draft.write_text(json.dumps(texts))


def are_intact(folder: Path, store: Path) -> bool:
    """Whether the descriptions are the noted ones, but for dimensions that have grown."""
    try:
        texts = load_json(folder / FILE)
        there = {name: read_bytes(store / name, MAX_JSON_BYTES).decode() for name in texts}
        return all(_is_grown(text, there[name]) for name, text in texts.items())
    except (OSError, ValueError, AttributeError, KeyError, TypeError):  # whatever a damaged file can hold
        return False


def _is_grown(noted: str, text: str) -> bool:
    """Whether a description is the noted one, with dimensions that had no length then."""
    if text == noted:
        return True
    content, shape = json.loads(noted), json.loads(text)["shape"]
    if len(shape) != len(content["shape"]) or any(
        not isinstance(new, int) or (old and new != old) for old, new in zip(content["shape"], shape, strict=True)
    ):
        return False
    return text == json.dumps(content | {"shape": shape}, indent=2)  # as ``rcbht_jax.io.parts`` writes it
