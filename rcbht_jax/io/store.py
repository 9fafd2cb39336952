"""The store: a Zarr v3 group with one row per recording, readable by ``xarray.open_zarr``.

Layout of version 3 (dimensions in brackets): ``wrench [trial, time, axis]`` float32, zero beyond ``length [trial]``;
the coordinates ``trial`` (names), ``time`` (s) and ``axis`` (names; their units in the attribute ``axis_units``);
the string variables ``arm``, ``source``, ``session``, ``outcome``, ``note`` ``[trial]``; ``dt`` (scalar and attribute);
further columns ``[trial]`` in ``columns/``; annotations in ``annotations/`` (``track``, ``label``, ``start``, ``end``
``[trial, interval]``; the codes count from 1 in the attribute ``annotation_labels``, 0 = no interval); label tracks in
``labels/<name>/<layer>/`` (``rcbht_jax.io.label_store``); parameters and ground truth of a simulation in
``simulation/``, every array ``[trial, ...]``. The dimension "trial" counts recordings: one arm of one trial. A row of
length 0, listed in the attribute ``gaps``, is no recording, and readers leave it out. Version 1 is read as well
(:mod:`rcbht_jax.io.store_old`); no release has written version 2.

A store is written in parts of consecutive rows (:mod:`rcbht_jax.io.store_writer`), each with files of its own, and read
whole, by rows or in batches, so that it may be larger than memory. Every chunk carries a CRC-32C, every recording's
samples and every part a SHA-256 (``wrench_sha256 [trial, byte]``, ``part_sha256 [part, byte]``), and the store that of
its parts (attribute ``content_sha256``, which an unfinished store lacks): reading detects truncation and loss.
:func:`write_recordings` writes atomically (:mod:`rcbht_jax._util.atomic`).

All functions that read raise an InputError where ``path`` does not exist, is not a store of this format, or is damaged;
those that need all of a store, also while it is being written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax._util.atomic import atomic_folder
from rcbht_jax._util.digest import wrench_digests
from rcbht_jax._util.url_path import as_path
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts, store_old, store_reader, store_writer
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import VARIABLES, validate
from rcbht_jax.io.store_reader import Stored, replaced
from rcbht_jax.io.store_schema import FORMAT, FORMAT_VERSION, HASH, LABELS, SIMULATION, in_parts, open_store, schema_of
from rcbht_jax.io.summary import Summary, summary_of
from rcbht_jax.labels import AXES, UNITS
from rcbht_jax.types import Recordings

__all__ = [
    "FORMAT", "FORMAT_VERSION", "SIMULATION", "VARIABLES", "check_target", "count_recordings", "is_finished",
    "longest_of", "open_store", "progress_of", "read_attrs", "read_batches", "read_digests", "read_lengths",
    "read_recordings", "read_rows", "read_sample", "read_simulation", "read_simulation_batches", "read_summary",
    "read_table", "validate", "verify", "write_recordings",
]  # fmt: skip

BATCH_BYTES = 2**26  # of wrenches that are in memory at once
SAMPLE_BYTES = 2**26  # of wrenches that represent all; their analysis takes ten times as much memory
SMALL_BYTES = 2**28  # of wrenches that "rcbht info" reads all of


def check_target(path: Path, overwrite: bool) -> None:
    """Check that a store can be written at ``path``, before the work is done.

    Raises:
        InputError: the parent folder does not exist, or ``path`` exists and ``overwrite`` is false or it is not a
            store; nothing else is ever replaced.
    """
    zarr_io.check_target(path, FORMAT, overwrite)


def write_recordings(
    path: Path | str,
    recordings: Recordings,
    attrs: Mapping[str, Any],
    overwrite: bool = False,
    *,
    created: str | None = None,
    simulation: Mapping[str, NDArray[Any]] | None = None,
    part: int | None = None,
) -> None:
    """Write recordings as a store, atomically.

    >>> recordings = Recordings.from_arrays([np.zeros((300, 6)), np.zeros((200, 6))], 200.0)
    >>> write_recordings(Path("mine.zarr"), recordings, {"importer": "my-robot"})

    Args:
        path: folder to create, by convention ending in ``.zarr``.
        recordings: wrenches in N and Nm with their metadata.
        attrs: provenance (JSON values), stored with the version, the creation date and the content hash.
        overwrite: replace an existing store once the new one is complete.
        created: creation date to store; default now. With a fixed text, equal content gives equal bytes.
        simulation: arrays ``[recording, ...]`` for the group ``simulation/``; text as NumPy strings.
        part: number of recordings in a part; default: parts of about 64 MiB.

    Raises:
        InputError: the recordings are inconsistent, ``path`` exists, ``attrs`` is not JSON, or a part is empty.
    """
    path = as_path(path)
    check_target(path, overwrite)
    validate(recordings)
    for name, values in (simulation or {}).items():
        if len(values) != len(recordings):
            raise InputError(
                f"{SIMULATION}/{name} has {len(values)} rows; expected {len(recordings)}, one per recording."
            )
    schema = schema_of(recordings, simulation, part=part)
    date = datetime.now(UTC).isoformat(timespec="seconds") if created is None else created
    with atomic_folder(path, replace=overwrite) as draft:
        store_writer.create(draft, schema, attrs, date)
        for number in range(len(schema.layout)):
            rows = schema.layout.span(number)
            some = None if simulation is None else {name: values[rows] for name, values in simulation.items()}
            block = recordings if len(schema.layout) == 1 else recordings.take(np.arange(rows.start, rows.stop))
            store_writer.write_part(draft, number, block, some)
        store_writer.finish(draft)


def read_recordings(path: Path | str) -> Recordings:
    """Read and check a whole store.

    >>> recordings = read_recordings(Path("trials.zarr"))
    >>> recordings.wrench.shape  # [recording, time, axis]
    (4, 400, 6)

    Raises:
        InputError: ``path`` does not exist, is not a store of this format, is still being written, or is damaged (a
            chunk is missing, truncated or altered).
    """
    stored = _open(path := as_path(path))
    return _valid(path, stored if isinstance(stored, Recordings) else store_reader.read_all(stored))


def read_rows(path: Path | str, rows: ArrayLike) -> Recordings:
    """Read some recordings, by number, in the given order; of their wrenches only the chunks that hold them are read.

    >>> len(read_rows(Path("trials.zarr"), [3]))
    1

    A store of version 1 is read whole.

    Raises:
        InputError: there is no such recording, or as for :func:`read_recordings`.
    """
    path, numbers = as_path(path), np.atleast_1d(np.asarray(rows))
    stored = _open(path, collected=True)
    count = len(stored if isinstance(stored, Recordings) else stored.rows())
    if numbers.dtype.kind not in "iu" or not len(numbers) or numbers.min() < 0 or numbers.max() >= count:
        raise InputError(f"{path} has recordings 0 to {count - 1}; asked for {numbers.tolist()[:9]}.")
    if isinstance(stored, Recordings):
        return _valid(path, stored).take(numbers)
    return _valid(path, store_reader.read_rows(stored, numbers.astype(np.int64)))


def read_batches(path: Path | str, most: int | None = None) -> Iterator[Recordings]:
    """All recordings of a store in their order, in batches, so that only one batch is in memory.

    >>> sum(int(batch.length.sum()) for batch in read_batches(Path("trials.zarr")))
    1600

    Args:
        path: the store; of version 1 it is read whole.
        most: bytes of wrenches in a batch; default 64 MiB.
    """
    stored, most = _open(path := as_path(path)), BATCH_BYTES if most is None else most
    for batch in [stored] if isinstance(stored, Recordings) else store_reader.read_parts(stored, most):
        yield _valid(path, batch)


def read_table(path: Path | str) -> Recordings:
    """All recordings of a store without their samples: names, lengths, columns and annotations.

    Of a store that is still being written, those that are there. The chunks are verified by their CRC alone;
    :func:`verify` does more.

    Returns:
        recordings whose ``wrench`` has no samples ``[recording, 0, axis]``.
    """
    stored = _open(as_path(path))
    return stored if isinstance(stored, Recordings) else store_reader.read_table(stored)


def read_summary(path: Path) -> Summary:
    """The summary of a store (:func:`rcbht_jax.io.summary.summary_of`), as far as it is written; no row is read.

    A store of version 1 is read whole.
    """
    stored = _open(path)
    return summary_of(stored) if isinstance(stored, Recordings) else store_reader.read_summary(stored)


def longest_of(path: Path) -> int:
    """Samples to which :func:`read_recordings` pads all recordings."""
    return store_reader.padded_to(path, open_store(path))


def progress_of(path: Path) -> tuple[int, int, dict[str, str], int]:
    """Progress of a store that may still be being written.

    Returns:
        recordings that are there; how many there will be (some of them gaps, while it is being written); the axes and
        their units; and bytes of the wrenches, padded.
    """
    group, there = open_store(path), count_recordings(path)
    with zarr_io.reading(path):
        wrench: Any = group["wrench"]
        if not in_parts(group):
            return there, there, dict(zip(AXES, UNITS, strict=True)), wrench.nbytes
        names = zarr_io.read_array(group, "axis", "string").tolist()
        axes = dict(zip(names, map(str, group.attrs["axis_units"]), strict=True))  # type: ignore[arg-type]
        return there, there if HASH in group.attrs else wrench.shape[0], axes, wrench.nbytes


def read_sample(path: Path, most: int | None = None) -> tuple[Recordings, NDArray[np.int64]]:
    """All recordings of a store, or, of a large one, recordings spread evenly over it.

    Args:
        path: the store.
        most: bytes of padded wrenches beyond which it is large; default 64 MiB.

    Returns:
        the recordings, and their numbers.
    """
    length, group = read_lengths(path), open_store(path)
    with zarr_io.reading(path):
        axes = group["wrench"].shape[2]  # type: ignore[union-attr]
    room = (SAMPLE_BYTES if most is None else most) // (4 * axes * int(length.max()))
    if room >= len(length):
        return read_recordings(path), np.arange(len(length))
    numbers = np.linspace(0, len(length) - 1, max(1, room)).round().astype(np.int64)
    return read_rows(path, numbers), numbers


def verify(path: Path | str) -> None:
    """Read everything but the label tracks, part by part, and compare it with its checksums."""
    stored = _open(path := as_path(path))
    if isinstance(stored, Recordings):
        if SIMULATION in open_store(path):
            read_simulation(path)
        return
    store_reader.check_whole(stored)
    if stored.schema.simulation:
        store_reader.check_simulation(stored)
    parts.each(partial(store_reader.check_part, stored), range(len(stored.schema.layout)))
    zarr_io.check_collected(path, lambda name: name.split("/")[0] != LABELS)


def is_finished(path: Path) -> bool:
    """Whether all of a store has been written."""
    return HASH in open_store(path).attrs


def read_simulation(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Parameters and ground truth of simulated recordings: arrays ``[recording, ...]`` by name; all, or those named.

    Raises:
        InputError: ``path`` is not a store, holds no simulation or no such array, or is damaged.
    """
    found = list(read_simulation_batches(path, *names))
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def read_simulation_batches(path: Path, *names: str) -> Iterator[dict[str, NDArray[Any]]]:
    """As :func:`read_simulation`, of consecutive recordings in batches: the parts of the store."""
    group = open_store(path)
    sub = group.get(SIMULATION)
    if not isinstance(sub, zarr_io.Group):
        raise InputError(f'{path} holds no simulation; expected a store made by "rcbht simulate".')
    if in_parts(group):
        yield from store_reader.read_simulation(Stored.of(path, group), names)
        return
    arrays = store_old.read_simulation(path, sub)
    yield {name: arrays[name] for name in names or arrays}


def read_digests(path: Path) -> NDArray[np.uint8]:
    """SHA-256 of the samples of each recording ``[recording, 32]``: equal ones are copies."""
    stored = _open(path)
    if isinstance(stored, Recordings):
        return wrench_digests(stored.wrench, stored.length)
    return store_reader.read_digests(stored)


def read_attrs(path: Path) -> dict[str, Any]:
    """The store's attributes: provenance, ``dt``, ``import_report`` and so on."""
    return dict(open_store(path).attrs)


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """A block that reads a store several times, and is refused if another one was put in its place meanwhile.

    >>> with unchanged(Path("trials.zarr")):
    ...     table, batches = read_table(Path("trials.zarr")), list(read_batches(Path("trials.zarr")))

    Raises:
        InputError: it was replaced, whatever else went wrong; or as for :func:`read_attrs`.
    """
    before = read_attrs(path).get(HASH)
    try:
        yield
    finally:
        if read_attrs(path).get(HASH) != before:
            raise replaced(path)


def count_recordings(path: Path) -> int:
    """Number of recordings in a store; while it is being written, of those that are there."""
    group = open_store(path)
    if in_parts(group) and HASH in group.attrs:
        return len(Stored.of(path, group).rows())
    return len(read_lengths(path))


def read_lengths(path: Path) -> NDArray[np.int32]:
    """Samples of each recording; while the store is being written, of those that are there."""
    group = open_store(path)
    with zarr_io.reading(path):
        if in_parts(group):
            return store_reader.read_lengths(Stored.of(path, group))
        return zarr_io.read_array(group, "length", "int32")


def recording_rows(path: Path) -> NDArray[np.int64]:
    """Row in the store of each recording: ascending, and without gaps where no recording is missing."""
    group = open_store(path)
    return Stored.of(path, group).rows() if in_parts(group) else np.arange(count_recordings(path))


def _open(path: Path, *, collected: bool = False) -> Stored | Recordings:
    """An open store; all recordings, verified, of a store of version 1."""
    group = open_store(path, collected=collected)
    return Stored.of(path, group) if in_parts(group) else store_old.read(path, group)


def _valid(path: Path, recordings: Recordings) -> Recordings:
    try:
        validate(recordings)
    except InputError as error:
        raise InputError(f"{path} holds contradictory recordings: {error}") from error
    return recordings
