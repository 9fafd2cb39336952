"""Label tracks inside a store: ``labels/<name>/<layer>/<field>`` with dimensions [trial, axis, slot]."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import rcbht_jax
from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.optional import needs_extra
from rcbht_jax.errors import InputError
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.store import count_recordings, open_store
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks

with needs_extra("store"):
    import zarr

DIMENSIONS = ("trial", "axis", "slot")
INTEGERS = {"label": "int8", "t0": "int32", "t1": "int32", "emit": "int32"}
FIELDS = {field.name: INTEGERS.get(field.name, "float") for field in fields(LabelTrack)}
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def write_tracks(
    path: Path, name: str, tracks: LabelTracks, attrs: Mapping[str, Any], *, created: str | None = None
) -> None:
    """Add a set of label tracks to a store, atomically.

    >>> write_tracks(Path("trials.zarr"), "online-W5", tracks, {"window": 5})  # doctest: +SKIP

    Args:
        path: an existing store.
        name: for example "online-W5" or "offline-master"; letters, digits, dot, hyphen and underscore.
        tracks: arrays ``[recording, axis, slot]``; the layers may differ in slots.
        attrs: how the labels were made (semantics, window, thresholds): JSON values.
        created: creation date to store; default now.

    Raises:
        InputError: ``path`` is not a store, the name is malformed or taken, a shape or dtype is wrong, or ``attrs``
            is not JSON.
    """
    count = count_recordings(path)
    target = _folder(path, name)
    if target.exists():
        raise InputError(f"{path} has label tracks {name} already; choose another name.")
    arrays = {layer: _checked(getattr(tracks, layer), layer, count) for layer in LAYERS}
    header = {
        "rcbht_jax_version": rcbht_jax.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds") if created is None else created,
        "content_sha256": content_hash(a for layer in arrays.values() for a in layer.values()),
    }
    # The draft is outside the store: readers list every folder inside it.
    with atomic_folder(target, near=path) as draft:
        group = zarr_io.create_group(draft, {**attrs, **header})
        for layer, by_field in arrays.items():
            sub = group.create_group(layer)
            for field_name, values in by_field.items():
                zarr_io.write_array(sub, field_name, values, DIMENSIONS, str(values.dtype), {})
        if not (path / "labels" / "zarr.json").exists():
            zarr.create_group(path / "labels", zarr_format=3)
    zarr_io.consolidate(path)


def read_tracks(path: Path, name: str) -> tuple[LabelTracks, dict[str, Any]]:
    """Read a set of label tracks ``[recording, axis, slot]`` and its attributes.

    >>> tracks, attrs = read_tracks(Path("trials.zarr"), "online-W5")  # doctest: +SKIP

    Raises:
        InputError: ``path`` is not a store, has no such tracks, or they are damaged.
    """
    count = count_recordings(path)
    folder = _folder(path, name)
    if not folder.is_dir():
        names = ", ".join(list_tracks(path)) or "none"
        raise InputError(f"{path} has no label tracks {name}; it has: {names}.")
    group = zarr_io.open_group(folder)
    with zarr_io.reading(folder):
        arrays = {layer: _read_layer(group, layer) for layer in LAYERS}
        expected = group.attrs["content_sha256"]
        by_layer = {layer: _checked(LabelTrack(**arrays[layer]), layer, count) for layer in LAYERS}
    if content_hash(a for layer in by_layer.values() for a in layer.values()) != expected:
        raise InputError(f"{folder} is damaged: its content does not match its checksum. Encode again.")
    return LabelTracks(*(LabelTrack(**arrays[layer]) for layer in LAYERS)), dict(group.attrs)


def choose_tracks(path: Path, name: str = "") -> tuple[str, LabelTracks, dict[str, Any]]:
    """Name, label tracks and attributes of the tracks ``name``; without a name, of the only ones in the store.

    Raises:
        InputError: there are none, none of that name, or several and no name is given.
    """
    names = list_tracks(path)
    if not names:
        raise InputError(f'{path} has no label tracks; run "rcbht encode {path}" first.')
    if not name and len(names) > 1:
        raise InputError(f"{path} has several label tracks; choose one with --tracks: {', '.join(names)}.")
    if name and name not in names:
        raise InputError(
            f'{path} has no label tracks {name}; run "rcbht encode" first, or choose one it has: {", ".join(names)}.'
        )
    return (name or names[0], *read_tracks(path, name or names[0]))


def list_tracks(path: Path) -> list[str]:
    """Names of the label tracks in a store, sorted; also of damaged ones, which reading them tells.

    Raises:
        InputError: ``path`` is not a store.
    """
    open_store(path)
    entries = [entry for entry in (path / "labels").glob("*") if entry.is_dir() and not entry.name.startswith(".")]
    return sorted(entry.name for entry in entries if NAME.fullmatch(entry.name))


def _folder(path: Path, name: str) -> Path:
    if not NAME.fullmatch(name):
        raise InputError(f"{name!r} is not a name for label tracks; expected letters, digits and . _ - only.")
    return path / "labels" / name


def _read_layer(group: zarr.Group, layer: str) -> dict[str, Any]:
    sub = group[layer]
    if not isinstance(sub, zarr.Group):
        raise InputError(f"{group.store_path} has no layer {layer}; it is incomplete. Encode again.")
    return {name: zarr_io.read_array(sub, name, None if dtype == "float" else dtype) for name, dtype in FIELDS.items()}


def _checked(track: LabelTrack, layer: str, count: int) -> dict[str, Any]:
    """The fields of a layer as host arrays of agreeing shape."""
    arrays = {name: np.asarray(getattr(track, name)) for name in FIELDS}
    shape = arrays["label"].shape
    if len(shape) != 3 or shape[0] != count:
        raise InputError(f"{layer} labels have shape {shape}; expected [{count} recordings, axes, slots].")
    for name, expected in FIELDS.items():
        dtype = arrays[name].dtype
        matches = dtype in (np.float32, np.float64) if expected == "float" else dtype == expected
        if arrays[name].shape != shape or not matches:
            raise InputError(
                f"{layer} {name} is {dtype} of shape {arrays[name].shape}; expected {expected} of shape {shape}."
            )
    return arrays
