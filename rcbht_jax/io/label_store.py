"""Label tracks inside a store: ``labels/<name>/<layer>/<field>`` with dimensions [trial, axis, slot].

All functions raise an InputError where ``path`` is not a store, has no such label tracks, or they are damaged.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.url_path import as_path
from rcbht_jax._util.values import expect
from rcbht_jax.errors import InputError
from rcbht_jax.features.spans import check_rate
from rcbht_jax.io import label_parts, store_old
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.parts import Layout
from rcbht_jax.io.store import count_recordings, open_store, read_table, recording_rows
from rcbht_jax.io.store_reader import replaced
from rcbht_jax.io.store_schema import HASH, LABELLED, LABELS
from rcbht_jax.labels import LAYERS
from rcbht_jax.learning.tasks import TrackBatches
from rcbht_jax.types import LabelTracks, TrackInfo

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")


def write_tracks(
    path: Path | str, name: str, tracks: LabelTracks, attrs: Mapping[str, Any], *, created: str | None = None
) -> None:
    """Add a set of label tracks to a store, atomically.

    >>> import rcbht_jax as rj
    >>> recordings = rj.read_recordings("trials.zarr")
    >>> tracks = rj.encode(recordings.wrench, 1 / recordings.dt, window=5, lengths=recordings.length)
    >>> write_tracks(Path("trials.zarr"), "words", tracks, {"window": 5})

    Args:
        path: an existing store.
        name: for example "online-W5" or "offline-master"; letters, digits, dot, hyphen and underscore.
        tracks: arrays ``[recording, axis, slot]``; the layers may differ in slots.
        attrs: how the labels were made (semantics, window, thresholds): JSON values.
        created: creation date to store; default now.

    Raises:
        InputError: ``path`` is not a store, the name is malformed or taken, a shape or dtype is wrong, the labels are
            of another rate, or ``attrs`` is not JSON.
    """
    path = as_path(path)
    expect("The set of labels", tracks, LabelTracks)
    count = count_recordings(path)
    for layer in LAYERS:
        label_parts.checked(getattr(tracks, layer), layer, count)
    write_batches(path, name, [tracks], attrs, created=created)


def write_batches(
    path: Path, name: str, batches: Iterable[LabelTracks], attrs: Mapping[str, Any], *, created: str | None = None
) -> None:
    """Add a set of label tracks in batches, with one batch at a time in memory.

    >>> import rcbht_jax as rj
    >>> from rcbht_jax.io import store
    >>> batches = store.read_batches(Path("trials.zarr"))
    >>> tracks = (rj.encode(one.wrench, 1 / one.dt, window=5, lengths=one.length) for one in batches)
    >>> write_batches(Path("trials.zarr"), "words-in-batches", tracks, {"window": 5})

    Args:
        path: an existing store.
        name: as for :func:`write_tracks`.
        batches: label tracks of consecutive recordings, together of all.
        attrs: how the labels were made: JSON values.
        created: creation date to store; default now.

    Raises:
        InputError: as for :func:`write_tracks`, or another store was put in the place of this one meanwhile.
    """
    zarr_io.check_writable(path)
    rows, folder = recording_rows(path), _folder(path, name)
    if folder.exists():
        raise InputError(f"{path} has label tracks {name} already; choose another name.")
    layout = Layout(int(rows[-1]) + 1, min(label_parts.PART, int(rows[-1]) + 1))
    # The draft is outside the store: readers list every folder inside it.
    try:
        with atomic_folder(folder, near=path) as draft:
            _write_draft(draft, path, rows, layout, _of_its_rate(path, batches), attrs, created)
            label_parts.require_group(path)
    except InputError:
        if uncollected_tracks(path):  # another process took the name meanwhile: these are there under another one
            collect(path)
        raise
    collect(path)


def _of_its_rate(path: Path, batches: Iterable[LabelTracks]) -> Iterator[LabelTracks]:
    """The same batches, each checked not to be of another rate than the store."""
    dt = float(zarr_io.read_array(open_store(path), "dt", "float64"))
    for batch in batches:
        check_rate(batch, dt, f"{path} has")
        yield batch


def replace_batches(path: Path, name: str, batches: Iterable[LabelTracks], attrs: Mapping[str, Any]) -> None:
    """Write damaged or missing label tracks of a store again, from labels that were made as those were.

    Args:
        path: an existing store.
        name: of the label tracks.
        batches: as for :func:`write_batches`.
        attrs: of the label tracks, as :func:`read_tracks_attrs` gives them; if they have a checksum, it is compared.

    Raises:
        InputError: the labels are not those of the checksum; nothing is replaced.
    """
    zarr_io.check_writable(path)
    rows, folder = recording_rows(path), _folder(path, name)
    layout = Layout(attrs["rows"], attrs["part_rows"])
    own = {key: value for key, value in attrs.items() if key not in ("created", "rows", "part_rows", HASH, LABELLED)}
    with atomic_folder(folder, near=path, replace=folder.exists()) as draft:
        _write_draft(draft, path, rows, layout, batches, own, attrs["created"])
        if HASH in attrs and zarr_io.open_group(draft).attrs[HASH] != attrs[HASH]:
            raise InputError(f"{folder} cannot be made again: the installed versions encode otherwise.")
        label_parts.require_group(path)
    collect(path)


def _write_draft(
    draft: Path,
    path: Path,
    rows: NDArray[np.int64],
    layout: Layout,
    batches: Iterable[LabelTracks],
    attrs: Mapping[str, Any],
    created: str | None,
) -> None:
    """Label tracks in a folder of their own, complete with checksums."""
    own = open_store(path).attrs[HASH]
    ends = np.searchsorted(rows, [layout.span(number).stop for number in range(len(layout))]).tolist()
    sizes = np.diff([0, *ends]).tolist()
    for number, batch in enumerate(label_parts.regroup(batches, sizes)):
        if number == 0:
            label_parts.create(draft, layout, batch, attrs, created=created)
        span = layout.span(number)
        places = rows[ends[number] - sizes[number] : ends[number]] - span.start
        label_parts.write_part(draft, number, label_parts.spread(batch, places, span.stop - span.start))
    label_parts.finish(draft, path)
    if zarr_io.open_group(draft).attrs[LABELLED] != own:
        raise replaced(path)


def read_tracks(path: Path | str, name: str) -> tuple[LabelTracks, dict[str, Any]]:
    """Read a set of label tracks ``[recording, axis, slot]``, with the names of their axes, and its attributes.

    >>> tracks, attrs = read_tracks(Path("trials.zarr"), "online-W5")
    >>> tracks.primitive.label.shape[:2]  # [recording, axis]
    (4, 6)

    Raises:
        InputError: ``path`` is not a store, has no such tracks, or they are damaged.
    """
    path = as_path(path)
    attrs, table = read_tracks_attrs(path, name), read_table(path)
    info = TrackInfo(1 / table.dt, table.axes, tuple(range(len(table))))
    return replace(_whole(path, name), info=info), attrs


def _whole(path: Path, name: str) -> LabelTracks:
    [tracks] = read_batches(path, name, [count_recordings(path)])
    return tracks


def read_batches(path: Path, name: str, sizes: Iterable[int]) -> Iterator[LabelTracks]:
    """Label tracks of consecutive recordings in batches of the given sizes, which add up to all recordings.

    >>> batches = read_batches(Path("trials.zarr"), "online-W5", [3, 1])  # of a store of 4 recordings
    >>> [len(batch.mc.label) for batch in batches]
    [3, 1]
    """
    folder, rows = _folder(path, name), recording_rows(path)
    attrs = own_attrs(path, name)
    found = (
        label_parts.read(folder, rows)
        if "part_rows" in attrs
        else iter([store_old.read_tracks(folder, attrs, len(rows))])
    )
    yield from label_parts.regroup(found, sizes)


def read_rows(path: Path, name: str, numbers: NDArray[np.int64]) -> LabelTracks:
    """Label tracks of some recordings, by ascending number; only the parts that hold them are read."""
    if "part_rows" in own_attrs(path, name):
        return label_parts.joined(list(label_parts.read(_folder(path, name), recording_rows(path)[numbers])))
    return label_parts.taken(_whole(path, name), numbers)


def track_batches(path: Path, names: Mapping[str, str]) -> TrackBatches:
    """Label tracks of a store for functions that read them in batches.

    >>> batches = track_batches(Path("trials.zarr"), {"W5": "online-W5"})
    >>> [list(batch) for batch in batches.read()]
    [['W5']]

    Args:
        path: the store.
        names: the caller's name -> the name in the store.

    Raises:
        InputError: ``path`` is not a store; the rest, as for :func:`read_batches`, while they are read.
    """
    sizes = part_sizes(count_recordings(path))

    def read() -> Iterator[dict[str, LabelTracks]]:
        batches = [read_batches(path, name, sizes) for name in names.values()]
        return (dict(zip(names, tracks, strict=True)) for tracks in zip(*batches, strict=True))

    return TrackBatches(tuple(names), read)


def verify_tracks(path: Path, name: str) -> None:
    """Read a set of label tracks, part by part, and compare it with its checksums and the collected metadata."""
    for _ in read_batches(path, name, part_sizes(count_recordings(path))):
        pass
    if "part_rows" in read_tracks_attrs(path, name):
        zarr_io.check_collected(path, lambda member: f"{member}/".startswith(f"{LABELS}/{name}/"))


def uncollected_tracks(path: Path) -> list[str]:
    """Names of the label tracks that xarray misses, since the process that wrote them was killed.

    :func:`collect` mends that.
    """
    return [name for name in list_tracks(path) if zarr_io.uncollected(path, f"{LABELS}/{name}")]


def collect(path: Path) -> None:
    """Collect the metadata of all label tracks that are there, so that xarray finds them.

    Raises:
        InputError: ``path`` cannot be changed.
    """
    zarr_io.check_writable(path)
    label_parts.require_group(path)
    with zarr_io.locked(path):  # of two that write at the same time, the later one finds the tracks of both
        zarr_io.consolidate(path)


def copy_tracks(source: Path, target: Path, name: str) -> None:
    """Copy a set of label tracks as it is, damaged or not, to another store of the same recordings, replacing its own.

    Args:
        source: store that has the label tracks.
        target: store of the same recordings in the same parts.
        name: of the label tracks.

    Raises:
        InputError: the stores have other recordings, by their digests.
    """
    if open_store(source).attrs[HASH] != open_store(target).attrs[HASH]:
        raise InputError(f"{target} has other recordings than {source}, so that label tracks {name} are not theirs.")
    folder = _folder(target, name)
    with atomic_folder(folder, near=target, replace=folder.exists()) as draft:
        shutil.copytree(_folder(source, name), draft, symlinks=True)
        label_parts.require_group(target)
    collect(target)


def read_tracks_attrs(path: Path, name: str) -> dict[str, Any]:
    """How a set of label tracks was made."""
    open_store(path)
    folder = _folder(path, name)
    if name not in zarr_io.subfolders(folder.parent):
        names = ", ".join(list_tracks(path)) or "none"
        raise InputError(f"{path} has no label tracks {name}; it has: {names}.")
    return dict(zarr_io.open_group(folder).attrs)


def own_attrs(path: Path, name: str) -> dict[str, Any]:
    """The attributes of label tracks that label the recordings of this store; those of earlier versions do not say.

    Raises:
        InputError: they label others.
    """
    attrs, own = read_tracks_attrs(path, name), open_store(path).attrs.get(HASH)
    if attrs.get(LABELLED, own) != own:
        raise InputError(
            f"{_folder(path, name)} labels other recordings than those of {path}; delete it and encode again."
        )
    return attrs


def part_sizes(count: int) -> list[int]:
    """Sizes of the batches in which the label tracks of ``count`` recordings are read.

    >>> part_sizes(2500)
    [1024, 1024, 452]
    """
    return [min(label_parts.PART, count - first) for first in range(0, count, label_parts.PART)]


def choose_tracks(path: Path | str, name: str = "") -> tuple[str, LabelTracks, dict[str, Any]]:
    """Name, label tracks and attributes of the tracks ``name``; without a name, of the only ones in the store.

    Raises:
        InputError: there are none, none of that name, or several and no name is given.
    """
    path = as_path(path)
    chosen = choose_name(path, name)
    return chosen, _whole(path, chosen), read_tracks_attrs(path, chosen)


def choose_name(path: Path, name: str = "") -> str:
    """``name`` if the store has such label tracks; without a name, that of the only ones in the store.

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
    return name or names[0]


def list_tracks(path: Path | str) -> list[str]:
    """Names of the label tracks in a store, sorted, including damaged ones."""
    path = as_path(path)
    open_store(path)
    return sorted(name for name in zarr_io.subfolders(path / LABELS) if NAME.fullmatch(name))


def _folder(path: Path, name: str) -> Path:
    if not (isinstance(name, str) and NAME.fullmatch(name)) or name == "zarr.json":  # Zarr's own file
        raise InputError(
            f"{str(name)[:40]!r} is not a name for label tracks; expected up to 200 letters, digits and . _ - only, "
            "and not zarr.json."
        )
    return path / LABELS / name
