"""Zarr helpers shared by the store and the label tracks: groups and arrays, of which an InputError names damage."""

from __future__ import annotations

import fcntl
import json
import math
import os
import stat
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import uninterrupted
from rcbht_jax._util.optional import MissingPackage, needs_extra, require
from rcbht_jax._util.untrusted import MAX_BYTES, MAX_JSON_BYTES, MAX_RATIO, load_json
from rcbht_jax._util.url_path import url_of
from rcbht_jax.errors import InputError

with needs_extra("store"):
    import zarr
    import zarr.storage
    from zarr.abc.store import ByteRequest
    from zarr.codecs import Crc32cCodec, ZstdCodec
    from zarr.core.buffer import Buffer, BufferPrototype
    from zarr.core.group import GroupMetadata
    from zarr.core.metadata import ArrayV3Metadata
    from zarr.storage import LocalStore

    from rcbht_jax.io.chunk_files import LEVEL
    from rcbht_jax.io.chunk_reader import bounded

Group = zarr.Group
Array = zarr.Array
META = "zarr.json"  # of a group or an array


def check_target(path: Path, kind: str, overwrite: bool) -> None:
    """Check that a group of format ``kind`` can be written at ``path``; see :func:`store.check_target`."""
    check_writable(path)
    if os.path.islink(path):
        raise InputError(f"{path} is a link; name the place that it leads to: {os.path.realpath(path)}.")
    if not path.name:
        raise InputError(f'"{path}" is not a name for a store; expected for example trials.zarr.')
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder; create it first, or choose another place for {path.name}.")
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise InputError(f"{path} exists already; choose another name, or pass --overwrite to replace it.")
    # Only stores made by this program are ever deleted.
    try:
        ours = open_group(path).attrs.get("format") == kind
    except InputError:
        ours = False
    if not ours:
        raise InputError(f"{path} exists and is not a store made by rcbht; move it away or choose another name.")


def check_writable(path: Path) -> None:
    """Raise an error for an object store, which cannot rename: a store in it would not appear atomically."""
    if url_of(path) is not None:
        raise InputError(
            f"{path} can be read, not written: stores are written in folders alone. Write into a folder, and copy it "
            "there when it is complete."
        )


@uninterrupted()
def create_group(path: Path, attrs: Mapping[str, Any]) -> Group:
    """A new group with attributes.

    Raises:
        InputError: the attributes are not JSON values.
    """
    try:
        json.dumps(attrs, allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise InputError(f"The attributes cannot be stored as JSON: {error}.") from error
    return zarr.create_group(path, zarr_format=3, attributes=dict(attrs))


def open_group(path: Path, mode: Literal["r", "r+"] = "r", *, collected: bool = False) -> Group:
    """Open a group, for reading or for changing it.

    Args:
        path: of the group, a folder or a URL.
        mode: "r" to read, "r+" to change.
        collected: take the metadata of its members from its own, where :func:`consolidate` collected them: quicker, but
            lost members are not noticed.
    """
    if url_of(path) is not None:
        return _open_remote(path, mode)
    try:
        if not path.is_dir():
            missing = "is a file" if path.exists() else "does not exist"
            raise InputError(f'{path} {missing}; expected a folder made by "rcbht import" or "rcbht simulate".')
        files = _Files(path, read_only=mode == "r")
        return zarr.open_group(files, mode=mode, zarr_format=3, use_consolidated=None if collected else False)
    except InputError:
        raise
    except Exception as error:  # a foreign folder can fail in any way inside zarr
        raise InputError(f'{path} is not a Zarr group; expected a store made by "rcbht import".') from error


def path_of(member: Group | Array[Any]) -> Path:
    """Path of a group or an array, as it was given."""
    return Path(str(member.store_path).removeprefix("file://"))


def subfolders(path: Path) -> list[str]:
    """Names of the folders inside a folder, or below a URL; none where there is none."""
    if (url := url_of(path)) is None:
        return [entry.name for entry in path.iterdir() if entry.is_dir()] if path.is_dir() else []
    with reading(path):
        files, root = _fsspec(path).url_to_fs(url)
        entries = files.ls(root, detail=True) if files.isdir(root) else []
        return [entry["name"].rstrip("/").rpartition("/")[2] for entry in entries if entry["type"] == "directory"]


def _open_remote(path: Path, mode: Literal["r", "r+"]) -> Group:
    """A group in an object store; its metadata are collected, since each request takes its time."""
    if mode != "r":
        check_writable(path)
    _fsspec(path)
    try:
        store = zarr.storage.FsspecStore.from_url(str(url_of(path)), read_only=True)
        return zarr.open_group(store, mode="r", zarr_format=3)
    except ImportError as error:  # the package of this kind of URL
        brings = ' pip install "rcbht-jax[cloud]" brings s3fs.' if str(path).startswith("s3:") else ""
        raise InputError(f"{path} cannot be read: {str(error).rstrip('.')}.{brings}") from error
    except Exception as error:  # anything may be wrong with a network, rights and what is there
        detail = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path} cannot be read as a store ({type(error).__name__}: {detail}).") from error


def _fsspec(path: Path) -> Any:
    try:
        return require("fsspec.core", "cloud")
    except MissingPackage as error:
        raise InputError(f"{path} is a URL, and {error}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a group, which one process has at a time; the kernel releases it however the process ends.

    It is on the description of the group, opened for writing: NFS and Lustre know no locks of folders. A description
    without write permission is opened for reading, which is enough on local file systems.
    """
    file = folder / META
    with ExitStack() as handles:
        while True:
            try:
                handle: IO[bytes] = file.open("rb+")
            except PermissionError:
                handle = file.open("rb")
            handles.enter_context(handle)
            fcntl.flock(handle, fcntl.LOCK_EX)
            if os.path.samestat(os.fstat(handle.fileno()), file.stat()):  # else replaced by who held the lock
                break
        yield


class _Files(LocalStore):
    """The files of a store, which may be pipes, devices or links in an untrusted store."""

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        self.check(key)
        return await super().get(key, prototype, byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        wanted = list(key_ranges)
        for key, _ in wanted:
            self.check(key)
        return await super().get_partial_values(prototype, wanted)

    def check(self, key: str) -> None:
        """Raise an error for a file that is not regular or too large, before it is read.

        Raises:
            ValueError: it is; the reader of the store then reports damage.
        """
        try:
            status = (self.root / key).stat()
        except OSError:  # it does not exist: the reader handles that
            return
        most = MAX_JSON_BYTES if key.endswith(".json") else MAX_BYTES
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)) or status.st_size > most:
            raise ValueError(f"{key} is not a regular file of at most {most} bytes")


class _Readable(_Files):
    """The files of a store, without the groups and arrays whose metadata are damaged."""

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        if not key.endswith(f"/{META}"):
            return await super().get(key, prototype, byte_range)
        try:
            if (found := await super().get(key, prototype, byte_range)) is not None:
                content = json.loads(found.to_bytes())
                (ArrayV3Metadata if content["node_type"] == "array" else GroupMetadata).from_dict(content)
        except Exception:  # damaged metadata can fail in any way inside zarr
            return None
        return found


def damaged(fault: str) -> InputError:
    """The error for a store that cannot be used, with the advice of a reader that does not know how it was made.

    >>> damaged("a.zarr lacks a part.").fault
    'a.zarr lacks a part.'
    """
    return InputError(fault, "Import or copy it again.")


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn any exception of a damaged store into one InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # a damaged store can fail in any way inside zarr and its codecs
        detail = (str(error).splitlines() or [type(error).__name__])[0]
        raise damaged(f"{path} is damaged or incomplete ({detail}).") from error


@uninterrupted()
def create_array(
    group: Group,
    name: str,
    shape: tuple[int, ...],
    dtype: str,
    dimensions: tuple[str, ...],
    attrs: Mapping[str, str],
    chunks: tuple[int, ...],
    shards: tuple[int, ...] | None = None,
) -> Array[Any]:
    """An array of zeros or empty texts, compressed, with a CRC per chunk; an array of that name is replaced."""
    return group.create_array(
        name,
        shape=shape,
        dtype=np.dtypes.StringDType() if dtype == "string" else dtype,
        chunks=chunks,
        shards=shards,
        compressors=[ZstdCodec(level=LEVEL), Crc32cCodec()],
        dimension_names=dimensions,
        attributes=dict(attrs),
        overwrite=True,
    )


@uninterrupted()
def write_array(
    group: Group,
    name: str,
    values: NDArray[Any] | np.generic,
    dimensions: tuple[str, ...],
    dtype: str,
    attrs: Mapping[str, str],
) -> None:
    """Write one small array in one piece."""
    values = np.asarray(values)
    array = create_array(group, name, values.shape, dtype, dimensions, attrs, tuple(max(1, n) for n in values.shape))
    array[...] = values.astype(np.dtypes.StringDType()) if dtype == "string" else values


def member(group: Group, name: str) -> Array[Any]:
    """An array of a group, whose chunks are bounded."""
    array = _local_array(group, name)
    if array is None:
        array = group.get(name)  # type: ignore[assignment]
    if not isinstance(array, zarr.Array):
        raise damaged(f"{path_of(group)} has no array {name}; it is incomplete.")
    return bounded(array)


def _local_array(group: Group, name: str) -> Array[Any] | None:
    """An array of local files, which Zarr would open in a task of its event loop; None if it is no such array."""
    place = group.store_path / name
    if not isinstance(place.store, _Files) or group.metadata.consolidated_metadata is not None:
        return None
    key = f"{place.path}/{META}"
    if not (file := place.store.root / key).exists():
        return None
    place.store.check(key)
    content = json.loads(file.read_bytes())
    if content["node_type"] != "array":
        return None
    return Array(zarr.AsyncArray(ArrayV3Metadata.from_dict(content), place))


@uninterrupted()
def read_array(group: Group, name: str, dtype: str | None) -> NDArray[Any]:
    """Read a whole array, strings as fixed-width NumPy strings; ``dtype`` None accepts any."""
    array = member(group, name)
    check_size(array, array.shape)
    values = np.asarray(array[...])
    if dtype == "string":
        return fixed_width(values, path_of(array))
    if dtype is not None and values.dtype != dtype:
        raise InputError(f"{path_of(group)}: {name} is {values.dtype}; expected {dtype}.")
    return values


def check_size(array: Array[Any], shape: tuple[int, ...]) -> None:
    """Raise an error before as much of an array is read, if that is large and its files cannot hold it."""
    declared = math.prod(shape) * array.dtype.itemsize
    if declared > MAX_BYTES and declared > MAX_RATIO * array.nbytes_stored():
        raise damaged(f"{path_of(array)} declares {declared} bytes, far more than its files hold.")


def fixed_width(texts: NDArray[Any], path: Path) -> NDArray[np.str_]:
    """Texts of any length as NumPy strings, all of which take the memory of the longest.

    Raises:
        InputError: that is too much.
    """
    values = texts.reshape(-1).tolist()
    sizes = list(map(len, values))
    longest = max(sizes, default=0)
    if 4 * longest * len(values) > max(MAX_BYTES, MAX_RATIO * sum(sizes)):  # names of many trials may be long
        raise damaged(f"{path} has {len(values)} texts, the longest of {longest} characters; that is no table.")
    return np.array(values, np.str_).reshape(texts.shape)


def subgroup(group: Group, name: str) -> Group:
    """A group inside a group."""
    sub = group.get(name)
    if not isinstance(sub, Group):
        raise damaged(f"{path_of(group)} has no group {name}; it is incomplete.")
    return sub


@uninterrupted()
def consolidate(path: Path) -> None:
    """Collect the metadata of all members in the root group, which makes opening by xarray one read.

    Members whose metadata are damaged, such as a damaged label track beside a new one, are left out.
    """
    with warnings.catch_warnings():
        # Consolidated metadata is an extension of Zarr v3; readers without it ignore it.
        warnings.simplefilter("ignore")
        try:
            zarr.consolidate_metadata(path, zarr_format=3)
        except Exception:  # damaged metadata can fail in any way inside zarr; checking each member takes time
            zarr.consolidate_metadata(_Readable(path), zarr_format=3)


def check_collected(path: Path, chosen: Callable[[str], bool]) -> None:
    """Compare the metadata of members with what :func:`consolidate` collected of them, which xarray reads.

    Of a URL, only what was collected is read.

    Args:
        path: of the root group.
        chosen: whether a member is compared, by its name in the group, such as "columns/mass".
    """
    if url_of(path) is not None:
        return
    with reading(path):
        for name, found in _collected(path).items():
            # without a file its readers miss it, or it is a label track that was deleted
            if not (chosen(name) and (path / name / META).exists()):
                continue
            own = load_json(path / name / META)
            if {**found, "consolidated_metadata": None} != {**own, "consolidated_metadata": None}:
                raise damaged(f"{path} is damaged: {name}/{META} is not as in {META}.")


def uncollected(path: Path, folder: str) -> list[str]:
    """Members in a folder of a root group whose metadata :func:`consolidate` has not collected: xarray misses them.

    Where nothing is collected, xarray finds everything: none. Neither are there any below a URL.
    """
    if url_of(path) is not None:
        return []
    with reading(path):
        there = [file.parent.relative_to(path).as_posix() for file in (path / folder).rglob(META)]
        collected = _collected(path)
    return sorted(set(there) - set(collected)) if collected else []


def _collected(path: Path) -> dict[str, Any]:
    """What :func:`consolidate` collected in a root group: metadata by name of the member."""
    return (load_json(path / META).get("consolidated_metadata") or {"metadata": {}})["metadata"]
