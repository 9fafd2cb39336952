"""MATLAB files: of version 7.3 as HDF5, of earlier ones by their arrays, structures and cells."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import decoded
from rcbht_jax._util.optional import require
from rcbht_jax._util.untrusted import MAX_BYTES, MAX_MEMBERS, check_declared, check_file
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.arrays import hdf5_tables, reading, texts_of, unpadded, without_objects
from rcbht_jax.io.importing.isolated import apart
from rcbht_jax.io.importing.table import Table


@apart("scipy.io", "h5py")
def read_matlab(path: Path, name: str) -> Iterator[Table]:
    """Tables of a MATLAB file: of version 7.3 as HDF5, of earlier ones by their arrays and structures.

    >>> from scipy.io import savemat
    >>> savemat("a.mat", {"t": np.arange(9) * 0.01, "F": np.zeros((9, 3))})
    >>> [list(table.columns) for table in read_matlab(Path("a.mat"), "a.mat")]
    [['t', 'F_0', 'F_1', 'F_2']]

    Raises:
        InputError: not a regular file, damaged, declares arrays too large for it, or scipy or h5py is missing.
    """
    size = check_file(path)
    with path.open("rb") as file:
        head = file.read(128)
    if head.startswith(b"\x89HDF") or b"MATLAB 7.3" in head:
        yield from hdf5_tables(path, name, turned=True)
        return
    io = require("scipy.io", "import")
    with reading(path, "MATLAB"):
        if head[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
            raise InputError(f"{path} is not a MATLAB file of version 5 or later; save it with -v7.")
        check_declared(path, _unpacked(path, head), size)
        content = io.loadmat(path, squeeze_me=True, struct_as_record=True, chars_as_strings=True)
        arrays: dict[str, NDArray[Any]] = {}
        for key, value in content.items():
            if not key.startswith("__"):
                _flatten(key, np.asarray(value), arrays)
    objects = [key for key, array in arrays.items() if array.dtype.kind == "O"]
    yield from without_objects(path, name, {key: one for key, one in arrays.items() if key not in objects}, objects)


def _unpacked(path: Path, head: bytes) -> int:
    """Bytes of the elements of a MATLAB file once they are unpacked, in constant memory."""
    order, total = ("<" if head[126:128] == b"IM" else ">"), 0
    with path.open("rb") as file:
        file.seek(128)
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind != 15:
                file.seek(length, 1)
                total += length
                continue
            unpacker, left = zlib.decompressobj(), length
            while left and (block := file.read(min(left, 2**16))):
                left -= len(block)
                while block and total <= MAX_BYTES:
                    total += len(unpacker.decompress(block, 2**20))
                    block = unpacker.unconsumed_tail
                if total > MAX_BYTES:
                    return total
                check_declared(path, total, max(path.stat().st_size, 1))
    return total


def _flatten(key: str, value: NDArray[Any], into: dict[str, NDArray[Any]], depth: int = 0) -> None:
    """Fields of structures and elements of cells as arrays alone: STRUCT.FIELD, STRUCT.NUMBER.FIELD, CELL.NUMBER."""
    if len(into) > MAX_MEMBERS:
        raise InputError(f"it holds more than {MAX_MEMBERS} arrays; split it.")
    if depth > 8:
        return
    names = value.dtype.names or ()
    kind_at = "_Class" if "_ObjectMetadata" in names else "s2"  # an object, as scipy shows it from 1.18 on and before
    if kind_at == "_Class" or names[:3] == ("s0", "s1", "s2"):
        title, kind = (str(decoded(np.asarray(value.reshape(-1)[0][field]).item())) for field in (names[0], kind_at))
        into[f"{key if key != 'None' else title} ({kind})"] = np.empty((), object)
    elif names:
        records = value.reshape(-1)
        for field in names:
            for number, record in enumerate(records):
                name = f"{key}.{field}" if len(records) == 1 else f"{key}.{number}.{field}"
                _flatten(name, np.asarray(record[field]), into, depth + 1)
    elif value.dtype.kind == "O":
        if (texts := texts_of(value.flat)) is not None:
            into[key] = texts.reshape(value.shape)
        elif value.ndim == 0:
            _flatten(key, np.asarray(value.item()), into, depth + 1)
        else:
            for number, item in enumerate(value.flat):
                _flatten(f"{key}.{number}", np.asarray(item), into, depth + 1)
    else:
        into[key] = unpadded(value) if value.dtype.kind == "U" and value.ndim else value
