"""Tables in parts: Zarr arrays of one row per recording that are written part by part, in any order.

A part is a fixed number of consecutive rows. Shapes of chunks and Zarr shards are fixed when the table is made, and no
file holds rows of two parts, so that processes can write parts at the same time and the bytes do not depend on their
order. A dimension that differs from row to row (samples, slots) grows to the widest row: what lies beyond a
row's own width is never written. ``part_sha256`` holds the digest of each part; it is written last, so that a part
whose writing was interrupted counts as missing.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_write, delete, flush_all, uninterrupted
from rcbht_jax._util.digest import content_hash
from rcbht_jax._util.untrusted import MAX_FILES, MAX_ROWS, read_object
from rcbht_jax.errors import InputError
from rcbht_jax.io import chunk_files, chunk_reader
from rcbht_jax.io import zarr as zarr_io

DIGESTS, HASH = "part_sha256", "content_sha256"  # of each part, and of a table that is finished
CHUNK_BYTES = 2**18  # of a chunk of an array that grows: what reading one row costs
CHUNKS = 8  # along the dimension that grows, in one file
AT_ONCE = 4  # parts that are verified at the same time: more would fill the memory
_DIGEST = 32  # bytes of a SHA-256
T = TypeVar("T")


@dataclass(frozen=True)
class Field:
    """One array of a table."""

    dtype: str  # "string", or the name of a NumPy dtype
    dimensions: tuple[str, ...] = ()  # names of those of a row
    shape: tuple[int | None, ...] = ()  # of a row; None = grows with the widest row
    chunk: int = 64  # length of a chunk along the dimension that grows
    attrs: Mapping[str, str] = field(default_factory=dict)

    @property
    def grows(self) -> int | None:
        """The dimension of the array that grows, None = none does."""
        return 1 + self.shape.index(None) if None in self.shape else None


@dataclass(frozen=True)
class Layout:
    """How many rows a table has, and how many of them are in one part."""

    rows: int
    part: int

    def __len__(self) -> int:
        return -(-self.rows // self.part)

    def span(self, number: int) -> slice:
        """Rows of a part.

        Raises:
            InputError: there is no such part.
        """
        if not 0 <= number < len(self):
            raise InputError(f"there is no part {number}; there are {len(self)}, from 0.")
        return slice(number * self.part, min((number + 1) * self.part, self.rows))


@dataclass(frozen=True)
class Part:
    """One part of a table, to be written.

    Attributes:
        folder: of the table. layout: of the table.
        number: of the part. fields: of the table.
        values: by name, arrays ``[row of the part, ...]``; the dimension that grows may have any length.
        hashed: fields that its digest covers; none = the table has no digests of its own.
    """

    folder: Path
    layout: Layout
    number: int
    fields: Mapping[str, Field]
    values: Mapping[str, Any]
    hashed: tuple[str, ...] = ()


def layout_of(group: zarr_io.Group) -> Layout:
    """The layout that the attributes of a table state.

    Raises:
        InputError: it cannot be, or is not that of its parts.
    """
    layout = Layout(int(group.attrs["rows"]), int(group.attrs["part_rows"]))  # type: ignore[arg-type]
    if layout.rows < 0 or layout.part < 1 or zarr_io.member(group, DIGESTS).shape != (len(layout), _DIGEST):
        raise zarr_io.damaged(
            f"{zarr_io.path_of(group)} declares {layout.rows} rows in parts of {layout.part}, but has others."
        )
    _check_size(group, layout)
    return layout


def _check_size(group: zarr_io.Group, layout: Layout) -> None:
    """Raise an error for a table that no reader takes: each of its rows costs memory, and each of its parts files."""
    if layout.rows > MAX_ROWS or len(layout) > MAX_FILES:
        raise InputError(
            f"{zarr_io.path_of(group)} has {layout.rows} rows in {len(layout)} parts; expected at most {MAX_ROWS} in "
            f"{MAX_FILES}. Split it."
        )


@uninterrupted()
def create(group: zarr_io.Group, layout: Layout, fields: Mapping[str, Field]) -> None:
    """Create the arrays of a table, without rows; a name such as ``columns/mass`` is an array of a group inside.

    Raises:
        InputError: it has too many rows or parts.
    """
    _check_size(group, layout)
    for folder in sorted({name.rpartition("/")[0] for name in fields} - {""}):
        group.require_group(folder)
    for name, made in fields.items():
        folder, _, last = name.rpartition("/")
        zarr_io.create_array(
            zarr_io.subgroup(group, folder) if folder else group, last,
            (layout.rows, *(size or 0 for size in made.shape)), made.dtype, ("trial", *made.dimensions), made.attrs,
            *_chunks(layout, made),
        )  # fmt: skip
    zarr_io.create_array(group, DIGESTS, (len(layout), _DIGEST), "uint8", ("part", "byte"), {}, (1, _DIGEST))
    group.update_attributes({"rows": layout.rows, "part_rows": layout.part})


def put(path: Path, parts: Sequence[Part]) -> None:
    """Write parts of tables below a folder and flush them to disk; their digests last, in this order.

    Raises:
        InputError: an array has another shape or dtype than its table, or a table is finished with other content.
    """
    for part in parts:  # all before any is written: a refused part must not change one that is there
        check(part)
    for part in parts:
        _unseal(part)
    for part in parts:
        write(part)
    for number in {part.number for part in parts}:
        flush(path, number)
    for part in parts:
        if part.hashed:
            seal(part)


def check(part: Part) -> None:
    """Compare the arrays of a part with its table.

    Raises:
        InputError: an array has another shape or dtype, or there is no such part.
    """
    span = part.layout.span(part.number)
    for name, made in part.fields.items():
        array = np.asarray(part.values[name])
        shape = [span.stop - span.start, *("any" if size is None else size for size in made.shape)]
        right = array.ndim == len(shape) and all(map(lambda size, want: want in ("any", size), array.shape, shape))
        if not right or dtype_of(array) != made.dtype:
            raise InputError(
                f"{name} of a part is {dtype_of(array)} of shape {array.shape}; expected {made.dtype} of shape {shape}."
            )


def write(part: Part) -> None:
    """Write the arrays of a part, all but its digest.

    Raises:
        InputError: an array has another shape or dtype than the table.
    """
    check(part)
    group = zarr_io.open_group(part.folder, "r+")
    for name, made in part.fields.items():
        write_array(group, name, part.layout, part.number, made, np.asarray(part.values[name]))
    if any(made.grows for made in part.fields.values()):
        with zarr_io.locked(part.folder):  # others may be growing the same arrays
            for name, made in part.fields.items():
                if (axis := made.grows) is not None:
                    _widen(part.folder / name / zarr_io.META, axis, np.shape(part.values[name])[axis])


@uninterrupted()
def seal(part: Part) -> None:
    """Write the digest of a part, all of whose arrays are written: from then on the part counts."""
    group = zarr_io.open_group(part.folder, "r+")
    zarr_io.member(group, DIGESTS)[part.number] = np.frombuffer(bytes.fromhex(_digest_of(part)), np.uint8)


def _unseal(part: Part) -> None:
    """Remove the digest of a part that is about to be written with other content: until the new one it is missing."""
    if not part.hashed:
        return
    group = zarr_io.open_group(part.folder)
    stored = digest(group, part.number)
    if stored is not None and stored != _digest_of(part):  # the same content: another process may have written it
        if HASH in group.attrs:
            raise InputError(
                f"{part.folder} is finished, and its part {part.number} has other content; write another store."
            )
        file = part.folder / digest_file(part.number)
        delete(file)
        flush_all([file.parent])


def _digest_of(part: Part) -> str:
    return digest_of(part.values, {name: part.fields[name] for name in part.hashed})


def digest_of(values: Mapping[str, Any], fields: Mapping[str, Field]) -> str:
    """Digest of the arrays of a part, whatever their padding."""
    return content_hash(_trimmed(np.asarray(values[name]), fields[name].grows) for name in sorted(fields))


def discard(folder: Path, number: int) -> None:
    """Delete a part of all tables in a folder, whether it is damaged or not; its digests go first.

    Raises:
        InputError: the description of a table is damaged, so that its parts cannot be written again.
    """
    files = [chunks / str(number) for chunks in _chunk_folders(folder)]
    for file in sorted(files, key=lambda file: file.parents[1].name != DIGESTS):
        delete(file)


def flush(path: Path, number: int) -> None:
    """Flush a part to disk, in all tables below a folder."""
    written = [chunks / str(number) for chunks in _chunk_folders(path)]
    flush_all(entry for part in written if part.exists() for entry in (*part.rglob("*"), part))


def flush_rest(path: Path) -> None:
    """Flush what :func:`flush` leaves out: descriptions, digests, and arrays that are not in parts."""
    flushed = {chunks for chunks in _chunk_folders(path) if chunks.parent.name != DIGESTS}
    entries = [path]
    for folder, inside, files in os.walk(path):
        if Path(folder) in flushed:
            inside.clear()
            files.clear()
        entries += [Path(folder, name) for name in (*inside, *files)]
    flush_all(entries)


def _chunk_folders(path: Path) -> Iterator[Path]:
    """Folders of the chunks of the arrays below a folder that are written part by part."""
    for folder, inside, files in os.walk(path):
        if zarr_io.META in files:
            dimensions = read_object(Path(folder, zarr_io.META)).get("dimension_names") or [""]
            if dimensions[0] in ("trial", "part"):
                inside.clear()
                yield Path(folder, "c")


def digest_file(number: int) -> str:
    """Path, in the folder of a table, of a part's digest: a file that appears atomically once the part is written."""
    return f"{DIGESTS}/c/{number}/0"


def digests(group: zarr_io.Group) -> list[str | None]:
    """Digest of each part, None = it is missing."""
    layout_of(group)  # has as many parts as it declares
    stored = np.asarray(zarr_io.member(group, DIGESTS)[...])
    return [row.tobytes().hex() if row.any() else None for row in stored]


def digest(group: zarr_io.Group, number: int) -> str | None:
    """Digest of one part, None = it is missing."""
    row = np.asarray(zarr_io.member(group, DIGESTS)[number])
    return row.tobytes().hex() if row.any() else None


def whole_digest(header: Any, parts: list[str]) -> str:
    """Digest of a table: of its header, which holds for all rows, and of its parts in their order."""
    return hashlib.sha256(json.dumps([header, *parts], sort_keys=True).encode()).hexdigest()


@uninterrupted()
def read(
    group: zarr_io.Group, name: str, rows: slice | NDArray[np.int64], made: Field, width: int | None = None
) -> NDArray[Any]:
    """Some rows of an array, as far as ``width`` along the dimension that grows; text as NumPy strings.

    Raises:
        InputError: the array is missing or has another dtype.
    """
    array = zarr_io.member(group, name)
    if _dtype_in(array) != made.dtype:
        raise InputError(f"{zarr_io.path_of(group)}: {name} is {_dtype_in(array)}; expected {made.dtype}.")
    stops = list(array.shape[1:])
    if (axis := made.grows) is not None and width is not None:
        stops[axis - 1] = min(width, stops[axis - 1])
    values = _rows(array, rows, tuple(stops))
    wanted = rows.stop - rows.start if isinstance(rows, slice) else len(rows)
    if len(values) != wanted:
        where = zarr_io.path_of(group)
        raise zarr_io.damaged(f"{where}: {name} has {len(values)} of {wanted} rows.")
    return zarr_io.fixed_width(values, zarr_io.path_of(array)) if made.dtype == "string" else values


def each(check: Callable[[int], T], numbers: Iterable[int]) -> list[T]:
    """What a function finds in each of several parts, a few of which it reads at the same time.

    Raises:
        any exception that the function raises, for the first of the parts.
    """
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(check, numbers))


def _rows(array: zarr_io.Array[Any], rows: slice | NDArray[np.int64], stops: tuple[int, ...]) -> NDArray[Any]:
    chosen = np.arange(*rows.indices(array.shape[0])) if isinstance(rows, slice) else rows
    if len(chosen) > MAX_FILES * (array.shards or array.chunks)[0]:  # a file holds the rows of a part
        raise zarr_io.damaged(f"{zarr_io.path_of(array)} has {len(chosen)} rows, in more than {MAX_FILES} files.")
    zarr_io.check_size(array, (len(chosen), *stops))
    chunks = chunk_reader.chunks_of(array)
    if chunks is not None and (not len(chosen) or 0 <= chosen.min() <= chosen.max() < array.shape[0]):
        return chunk_reader.read(chunks, chosen, stops)
    within = [slice(0, stop) for stop in stops]
    return np.asarray(array[(rows, *within)] if isinstance(rows, slice) else array.oindex[(rows, *within)])


def fields_in(group: zarr_io.Group) -> dict[str, Field]:
    """The fields of the arrays of a group, all of fixed shape, by name."""
    found = {}
    for name, array in sorted(group.arrays()):
        if name != DIGESTS:
            dimensions = tuple(map(str, array.metadata.dimension_names[1:]))  # type: ignore[union-attr,index]
            found[name] = Field(_dtype_in(array), dimensions, tuple(array.shape[1:]))
    return found


def dtype_of(values: NDArray[Any]) -> str:
    """The dtype of a field that holds these values."""
    return "string" if values.dtype.kind == "U" else str(values.dtype)


def _dtype_in(array: zarr_io.Array[Any]) -> str:
    """The dtype of the field that an array holds; the kind of its texts depends on the version of Zarr."""
    return "string" if array.dtype.kind in "TUO" else str(array.dtype)


def _chunks(layout: Layout, made: Field) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Shapes of chunks and of the files that hold them (None = a file holds one chunk)."""
    inner = tuple(made.chunk if size is None else max(1, size) for size in made.shape)
    if made.grows is None:
        return (layout.part, *inner), None
    most = max(1, CHUNK_BYTES // (math.prod(inner) * np.dtype(made.dtype).itemsize))
    rows = max(rows for rows in range(1, min(most, layout.part) + 1) if layout.part % rows == 0)
    outer = tuple(size * CHUNKS if made.shape[n] is None else size for n, size in enumerate(inner))
    return (rows, *inner), (layout.part, *outer)


@uninterrupted()
def write_array(
    group: zarr_io.Group, name: str, layout: Layout, number: int, made: Field, values: NDArray[Any]
) -> None:  # fmt: skip
    """Write a part of one array, as far as the values reach along the dimension that grows."""
    chunk, shard = _chunks(layout, made)
    folder = zarr_io.path_of(group) / name / "c"
    if made.dtype == "string":
        zarr_io.member(group, name)[layout.span(number)] = values.astype(np.dtypes.StringDType())
    elif shard is None:
        chunk_files.write_chunk(folder.joinpath(str(number), *["0"] * (values.ndim - 1)), values, chunk)
    else:
        axis = made.grows or 0
        chunk_files.write_shards(folder, (number, *[0] * (axis - 1)), values, axis, chunk, shard)


def _widen(metadata: Path, axis: int, width: int) -> None:
    """Make an array at least ``width`` wide, by its metadata alone."""
    content = json.loads(metadata.read_text())
    if content["shape"][axis] < width:
        content["shape"][axis] = width
        with atomic_write(metadata) as draft:
            draft.write_text(json.dumps(content, indent=2))


def _trimmed(values: NDArray[Any], axis: int | None) -> NDArray[Any]:
    """Values without what is zero at the end of the dimension that grows, in all rows."""
    if axis is None or not values.size:
        return values
    bits = np.moveaxis(np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}"), axis, 0)
    used = np.flatnonzero(bits.reshape(len(bits), -1).any(1))
    return values[(slice(None),) * axis + (slice(0, 1 + used[-1] if len(used) else 0),)]
