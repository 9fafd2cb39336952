"""Reading of a store of version 3: whole, some rows, part by part; what is read is verified.

All functions raise an InputError where what they read is missing, damaged or not yet written.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import wrench_digests
from rcbht_jax._util.untrusted import parse_json
from rcbht_jax.annotations import Annotations
from rcbht_jax.errors import InputError
from rcbht_jax.io import parts
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.checks import VARIABLES, check_padding
from rcbht_jax.io.parts import Field
from rcbht_jax.io.store_schema import (
    ANNOTATIONS,
    COLUMNS,
    GAPS,
    HASH,
    SIMULATION,
    SUMMARIES,
    WRENCH_HASH,
    Schema,
    digested,
    in_parts,
    open_store,
    schema_in,
)
from rcbht_jax.io.summary import COUNTING, Summary, merged, summary_of
from rcbht_jax.types import Recordings

Arrays = dict[str, NDArray[Any]]
UNLIKE = "does not match its checksum"
OTHER_GAPS = "its list of rows without a recording is not that of its rows"


@dataclass(frozen=True)
class Stored:
    """A store that is open for reading."""

    path: Path
    group: zarr_io.Group
    schema: Schema
    finished: bool

    @staticmethod
    def of(path: Path, group: zarr_io.Group) -> Stored:
        """A store that has been opened, finished or not."""
        return Stored(path, group, schema_in(group), HASH in group.attrs)

    def check_finished(self) -> None:
        """Refuse a store that is still being written."""
        if not self.finished:
            there = sum(digest is not None for digest in parts.digests(self.group))
            raise InputError(
                f"{self.path} is still being written: {there} of {len(self.schema.layout)} parts are there. "
                "Run the command that writes it again, or wait for it."
            )

    def rows(self) -> NDArray[np.int64]:
        """The row of each recording."""
        self.check_finished()
        used = np.ones(self.schema.layout.rows, bool)
        try:
            used[np.array(self.group.attrs[GAPS], np.intp)] = False
        except (KeyError, ValueError, TypeError, IndexError, OverflowError):
            raise self.damaged(OTHER_GAPS) from None
        return np.flatnonzero(used)

    def check_unchanged(self) -> None:
        """Refuse a store in whose place another one was put since it was opened, as ``--overwrite`` does."""
        if self.finished and open_store(self.path).attrs.get(HASH) != self.group.attrs[HASH]:
            raise replaced(self.path)

    def damaged(self, why: str) -> InputError:
        """The error for content that contradicts itself, unless it is that of another store."""
        self.check_unchanged()
        return zarr_io.damaged(f"{self.path} is damaged: {why}.")


def replaced(path: Path) -> InputError:
    """The error for a store in whose place another one was put while it was in use."""
    return InputError(f"{path} was replaced by another store while it was read; run the command again.")


def read_all(stored: Stored) -> Recordings:
    """All recordings, padded as they were written."""
    count, at = len(stored.rows()), 0
    wrench = np.zeros((count, padded_to(stored.path, stored.group), len(stored.schema.axes)), np.float32)
    tables = []
    for part in read_parts(stored):
        wrench[at : at + len(part), : part.wrench.shape[1]] = part.wrench
        at += len(part)
        tables.append(replace(part, wrench=part.wrench[:, :0]))
    return replace(Recordings.join(tables), wrench=wrench)


def padded_to(path: Path, group: zarr_io.Group) -> int:
    """Samples to which the recordings of a store of any version are padded."""
    with zarr_io.reading(path):
        padded = int(group["wrench"].shape[1])  # type: ignore[union-attr]
        longest = int(zarr_io.read_array(group, "length", "int32").max(initial=0))
    try:
        check_padding(padded, longest)
    except InputError as error:
        raise InputError(f"{path} holds contradictory recordings: {error}") from None
    return padded


def read_parts(stored: Stored, most: int | None = None) -> Iterator[Recordings]:
    """All recordings in their order, in batches of so many bytes at most, None = whole parts; all is verified."""
    check_whole(stored)
    padded_to(stored.path, stored.group)
    for number in range(len(stored.schema.layout)):
        small = read_small(stored, number)
        length = small["length"]
        step = len(length)
        if most is not None:
            step = max(1, most // max(1, 4 * len(stored.schema.axes) * int(length.max())))
        for first in range(0, len(length), step):
            block = slice(first, min(first + step, len(length)))
            kept = np.flatnonzero(length[block])
            if len(kept):
                some = {name: values[block][kept] for name, values in small.items()}
                start = stored.schema.layout.span(number).start + first
                wrench = _wrench(stored, slice(start, start + block.stop - first), int(length[block].max()))[kept]
                yield _verified(stored, some, wrench)


def read_rows(stored: Stored, numbers: NDArray[np.int64]) -> Recordings:
    """Some recordings, by number, in the given order; of wrenches only their chunks are read."""
    rows = stored.rows()[numbers]
    order = np.argsort(rows, kind="stable")
    found: list[Recordings] = []
    part = rows[order] // stored.schema.layout.part
    for number in np.unique(part).tolist():
        small, wanted = read_small(stored, number), rows[order][part == number]
        some = {name: values[wanted - stored.schema.layout.span(number).start] for name, values in small.items()}
        found.append(_verified(stored, some, _wrench(stored, wanted, int(some["length"].max()))))
    joined = found[0] if len(found) == 1 else Recordings.join(found)
    return joined if (order == np.arange(len(order))).all() else joined.take(np.argsort(order, kind="stable"))


def read_table(stored: Stored) -> Recordings:
    """All recordings without samples (``wrench [recording, 0, axis]``), as far as they are there.

    Chunks are verified by their CRC alone.
    """
    with zarr_io.reading(stored.path):
        small = {name: _whole(stored, name) for name in stored.schema.fields if name not in ("wrench", WRENCH_HASH)}
        used = (small["length"] > 0) & _there(stored)
        stored.check_unchanged()  # all columns are of one store
    if not used.all():
        small = {name: values[used] for name, values in small.items()}
    return _recordings(stored, small, np.zeros((int(used.sum()), 0, len(stored.schema.axes)), np.float32))


def first_trials(path: Path, count: int) -> list[str]:
    """Names of the trials of the first ``count`` recordings; [] = of version 1, or not finished."""
    group = open_store(path)
    if not in_parts(group) or HASH not in group.attrs:
        return []
    stored = Stored.of(path, group)
    rows = stored.rows()
    near = rows[:count][rows[:count] < rows[0] + count]  # gaps between them may be long
    with zarr_io.reading(path):
        names = parts.read(group, "trial", slice(int(rows[0]), int(near[-1]) + 1), stored.schema.fields["trial"])
    return list(dict.fromkeys(names[near - rows[0]].tolist()))


def read_lengths(stored: Stored) -> NDArray[np.int32]:
    """Samples of each recording, as far as they are there."""
    length = _whole(stored, "length")
    return length[(length > 0) & _there(stored)]


def read_summary(stored: Stored) -> Summary:
    """The summary of the parts that are written."""
    with zarr_io.reading(stored.path):
        there = None if stored.finished else parts.digests(stored.group)  # before texts of parts that are finished now
        every = slice(0, len(stored.schema.layout))
        texts = parts.read(stored.group, SUMMARIES, every, Field("string")).tolist()
        return merged(parse_json(text, finite=False) for row, text in enumerate(texts) if there is None or there[row])


def read_digests(stored: Stored) -> NDArray[np.uint8]:
    """Digest of the samples of each recording ``[recording, 32]``."""
    kept = stored.rows()
    with zarr_io.reading(stored.path):
        return _whole(stored, WRENCH_HASH)[kept]


def read_small(stored: Stored, number: int) -> Arrays:
    """The arrays of a part but its wrenches, verified."""
    rows, fields = stored.schema.layout.span(number), digested(stored.schema.fields)
    with zarr_io.reading(stored.path):
        small = {name: parts.read(stored.group, name, rows, made) for name, made in fields.items()}
        stored.check_unchanged()  # wrenches, which are read later, are compared with digests read now
        if parts.digest_of(small, fields) != parts.digest(stored.group, number):
            raise stored.damaged(f"part {number} {UNLIKE}")
    return small


def check_whole(stored: Stored) -> None:
    """Check that the parts are those of which the digest of the store is made, and its times of its rate."""
    stored.check_finished()
    with zarr_io.reading(stored.path):
        _check_sealed(stored, stored.group, stored.schema.header, "its content")
        dt, time = (zarr_io.read_array(stored.group, name, "float64") for name in ("dt", "time"))
        if dt != stored.schema.dt or not np.array_equal(time, np.arange(len(time)) * stored.schema.dt):
            raise stored.damaged("its times are not those of its rate")
        used = np.flatnonzero(_whole(stored, "length"))
    if not np.array_equal(used, stored.rows()):  # no digest covers the list
        raise stored.damaged(OTHER_GAPS)


def check_part(stored: Stored, number: int) -> None:
    """Read a part, its simulation included, and compare it with its digests, and its summary with its rows.

    Summaries of versions that counted other quantities are not compared.
    """
    small, rows = read_small(stored, number), stored.schema.layout.span(number)
    _check_wrench(stored, small, _wrench(stored, rows, int(small["length"].max())))
    _check_summary(stored, number, small)
    if stored.schema.simulation:
        read_simulation_part(stored, number)


def _check_summary(stored: Stored, number: int, small: Arrays) -> None:
    nothing = np.zeros((len(small["length"]), 0, len(stored.schema.axes)), np.float32)
    counted = summary_of(_recordings(stored, small, nothing))
    with zarr_io.reading(stored.path):
        [text] = parts.read(stored.group, SUMMARIES, slice(number, number + 1), Field("string")).tolist()
        found = parse_json(text, finite=False)
    if isinstance(found, dict) and found.pop("counting", 1) != COUNTING:  # the first stores of version 3 have no number
        return
    if json.dumps(found, sort_keys=True) != json.dumps(counted, sort_keys=True):  # texts: a NaN is not equal to itself
        raise stored.damaged(f"the summary of part {number} is not that of its recordings")


def check_simulation(stored: Stored) -> None:
    """Check that the parts of the group ``simulation/`` are those of which its digest is made."""
    with zarr_io.reading(stored.path):
        group, header = zarr_io.subgroup(stored.group, SIMULATION), sorted(stored.schema.simulation)
        _check_sealed(stored, group, header, "its simulation")


def read_simulation_part(stored: Stored, number: int, names: tuple[str, ...] = ()) -> Arrays:
    """Arrays of the group ``simulation/`` of one part: all, which are verified, or some."""
    sub, fields = zarr_io.subgroup(stored.group, SIMULATION), stored.schema.simulation
    with zarr_io.reading(stored.path):
        rows = stored.schema.layout.span(number)
        arrays = {name: parts.read(sub, name, rows, fields[name]) for name in names or sorted(fields)}
        stored.check_unchanged()
        if not names and parts.digest_of(arrays, fields) != parts.digest(sub, number):
            raise stored.damaged(f"the simulation of part {number} {UNLIKE}")
    return arrays


def read_simulation(stored: Stored, names: tuple[str, ...] = ()) -> Iterator[Arrays]:
    """Arrays ``[recording, ...]`` of the group ``simulation/``, of the recordings of one part after the other."""
    kept = stored.rows()
    check_simulation(stored)
    if missing := [name for name in names if name not in stored.schema.simulation]:
        there = ", ".join(sorted(stored.schema.simulation))
        raise InputError(f"{stored.path} has no simulation/{missing[0]}; it has: {there}.")
    layout = stored.schema.layout
    for number in range(len(layout)):
        span = layout.span(number)
        mine = kept[slice(*np.searchsorted(kept, [span.start, span.stop]))] - span.start
        part = read_simulation_part(stored, number, names)
        if len(mine):
            whole = len(mine) == span.stop - span.start
            yield part if whole else {name: values[mine] for name, values in part.items()}


def _whole(stored: Stored, name: str) -> NDArray[Any]:
    """All rows of an array, which must have as many as its parts."""
    return parts.read(stored.group, name, slice(0, stored.schema.layout.rows), stored.schema.fields[name])


def _there(stored: Stored) -> NDArray[np.bool_]:
    """Which rows are in parts that are there ``[row]``."""
    layout = stored.schema.layout
    if stored.finished:
        return np.ones(layout.rows, bool)
    there = np.array([digest is not None for digest in parts.digests(stored.group)])
    return np.repeat(there, layout.part)[: layout.rows]


def _check_sealed(stored: Stored, group: zarr_io.Group, header: Any, what: str) -> None:
    digests = [digest or "" for digest in parts.digests(group)]
    if parts.whole_digest(header, digests) != group.attrs.get(HASH):
        raise stored.damaged(f"{what} {UNLIKE}")


def _wrench(stored: Stored, rows: slice | NDArray[np.int64], width: int) -> NDArray[np.float32]:
    if not width:  # no recording there
        count = rows.stop - rows.start if isinstance(rows, slice) else len(rows)
        return np.zeros((count, 0, len(stored.schema.axes)), np.float32)
    with zarr_io.reading(stored.path):
        return parts.read(stored.group, "wrench", rows, stored.schema.fields["wrench"], width)


def _check_wrench(stored: Stored, small: Arrays, wrench: NDArray[np.float32]) -> None:
    wrong = (wrench_digests(wrench, small["length"]) != small[WRENCH_HASH]).any(1)
    if wrong.any():
        raise stored.damaged(f"the wrench of {small['trial'][int(np.argmax(wrong))]} {UNLIKE}")


def _verified(stored: Stored, small: Arrays, wrench: NDArray[np.float32]) -> Recordings:
    _check_wrench(stored, small, wrench)
    return _recordings(stored, small, wrench)


def _recordings(stored: Stored, small: Arrays, wrench: NDArray[np.float32]) -> Recordings:
    schema = stored.schema
    marks = {name: small[f"{ANNOTATIONS}/{name}"] for name in ("track", "label", "start", "end")}
    recording, place = np.nonzero(marks["track"])
    used = {name: values[recording, place] for name, values in marks.items()}
    return Recordings(
        wrench=wrench, dt=schema.dt, axes=schema.axes, units=schema.units,
        annotations=Annotations(
            recording.astype(np.int32), used["track"] - np.int16(1), used["label"] - np.int32(1),
            used["start"], used["end"], dict(schema.labels),
        ),
        columns={name: small[f"{COLUMNS}/{name}"] for name in schema.columns},
        **{name: small[name] for name in VARIABLES if name != "wrench"},
    )  # fmt: skip
