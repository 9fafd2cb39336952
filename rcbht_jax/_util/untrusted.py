"""Untrusted files: the one place that opens them, with all limits of size and shape.

A file is checked before it is read: it must be a regular one (a pipe or a device might never end), of a size that
fits in memory, and must not unpack to more than measured signals do. Numbers must be finite. Whatever is wrong is an
``InputError`` or another ValueError.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import stat
import types
import typing
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

# Bytes. Larger files must be split.
MAX_BYTES = 2**31  # of a file that is read whole, and of the arrays that it declares
MAX_TEXT_BYTES = 2**29  # of a table as text
MAX_JSON_BYTES = 2**26
MAX_MAP_BYTES = 2**20  # of a mapping
MAX_BAG_INFO_BYTES = 2**17  # of the metadata of a bag, some 550 per topic, for which the YAML parser takes seconds
MAX_BAG_BYTES = 2**34  # of a bag, which is read message by message
MAX_CHUNK = 2**26  # of a chunk or record of a bag; recorders write chunks of 1 to 4 MiB
MAX_SCHEMA = 2**17  # of the description of a message in a bag; of the largest in use, some 50 kB
MAX_LINE = 2**16  # of a line of a stream
MAX_TABLE_LINE = 2**20  # of a line of a table
SMALL = 2**26  # below this the ratio of compression is not checked
MAX_RATIO = 200  # of bytes that a file declares to its own: far above what measured signals reach
# Of a process that decodes what other libraries read (HDF5, MATLAB, Parquet).
DECODER_SECONDS = 2.0  # of a processor, and one more for every DECODER_SPEED bytes that the file may unpack to
DECODER_SPEED = 2**26
DECODER_PATIENCE = 300.0  # s by the clock, or 10 times as long as the processor may take: a busy machine, a slow disk
DECODER_MEMORY = 2**30  # bytes beyond those of its arrays, of which it may hold three copies
# Counts.
MAX_FILES = 200_000  # in a folder
MAX_ROWS = 10_000_000  # of a table in parts
MAX_MEMBERS = 10_000  # arrays of a file
MAX_COLUMNS = 4096  # of a table
MAX_CHANNELS = 10_000  # records of channels and their schemas in a bag
MAX_NAME = 1000  # characters of a name in a model
MAX_DIGITS = 300  # of a whole number, which a float must hold
MAX_VALUES = 2**27  # numbers kept of one bag, and samples of one recording
MAX_PADDED = 2**20  # samples to which recordings may be padded; beyond, MAX_RATIO times those of the longest

# Errors of the machine: what could not be read now may be sound.
_MACHINE = (
    errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.ESTALE, errno.ETIMEDOUT,
)  # fmt: skip

_HEADERS: Mapping[tuple[int, int], Any] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def check_file(path: Path, most: int = MAX_BYTES, *, empty: bool = False) -> int:
    """Size of a regular file in bytes, before anything is read.

    Args:
        path: the file.
        most: bytes that it may have.
        empty: whether it may have none.

    Raises:
        InputError: it is missing, a folder, a pipe or a device, or of another size.

    Example:
        >>> check_file(Path("/dev/zero"))
        Traceback (most recent call last):
        rcbht_jax.errors.InputError: /dev/zero is not a regular file; expected one, not a folder, a pipe or a device.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}.") from error
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path} is not a regular file; expected one, not a folder, a pipe or a device.")
    if not (status.st_size or empty):
        raise InputError(f"{path} is empty.")
    if status.st_size > most:
        raise InputError(f"{path} has {status.st_size} bytes; expected at most {most}. Split it.")
    return status.st_size


def check_readable(error: BaseException | None) -> None:
    """Raise the error of the machine behind an error of reading: what it kept from being read is not damaged.

    >>> check_readable(InputError("a.zarr is damaged."))

    Raises:
        OSError, MemoryError: rights, memory, open files or a disk were the reason.
    """
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _MACHINE):
            raise error
        error = error.__cause__


def check_inside(path: Path, root: Path) -> None:
    """Raise an error for a link that leads out of the folder that was given to read.

    A snapshot in a Hugging Face cache is made of links to the blobs of its repository, which belong to it.

    >>> check_inside(Path("runs/a.csv"), Path("runs"))

    Args:
        path: a file or a folder, with all that is in it.
        root: the folder, which may itself be a link, since the user named it.
    """
    within = ((here, name) for here, folders, files in os.walk(path) for name in (*folders, *files))
    for one in (path, *(Path(here, name) for here, name in within)):
        if leads_out(one, root):
            raise InputError(f"{one} is a link out of the folder; copy what it leads to, if it belongs there.")


def leads_out(path: Path, root: Path) -> bool:
    """Whether a path is, or has on its way, a link out of a folder, and of the blobs of a Hugging Face cache.

    >>> leads_out(Path("runs/../secret"), Path("runs"))
    True
    """
    try:
        real, given = path.resolve(), root.resolve()
    except (OSError, RuntimeError):  # a loop of links leads nowhere
        return False
    return not any(real.is_relative_to(place) for place in (given, *_blobs(given)))


def _blobs(folder: Path) -> list[Path]:
    """Where the files of a snapshot are, ``datasets--NAME/snapshots/REVISION``, if the folder is one or in one."""
    revisions = [one for one in (folder, *folder.parents) if one.parent.name == "snapshots"]
    repositories = [one.parent.parent for one in revisions]
    return [one / "blobs" for one in repositories if one.name.startswith(("datasets--", "models--"))]


def check_declared(path: Path, declared: int, size: int) -> None:
    """Check how many bytes a file declares to unpack to, before it is unpacked.

    Args:
        path: the file.
        declared: bytes of its arrays.
        size: bytes of the file.
    """
    if declared < 0 or declared > MAX_BYTES:
        raise InputError(f"{path} declares arrays of {declared} bytes; expected at most {MAX_BYTES}. Split it.")
    if declared > max(SMALL, MAX_RATIO * size):
        raise InputError(f"{path} has {size} bytes and declares arrays of {declared}; that is not a recording.")


def decoder_limits(size: int) -> tuple[int, float]:
    """Bytes of memory and seconds of a processor that a process may take to decode a file of a size in bytes.

    >>> decoder_limits(1000)
    (1275068416, 3.0)
    """
    unpacked = min(MAX_BYTES, max(SMALL, MAX_RATIO * size))
    return DECODER_MEMORY + 3 * unpacked, DECODER_SECONDS + unpacked / DECODER_SPEED


def read_bytes(path: Path, most: int = MAX_BYTES, *, empty: bool = False) -> bytes:
    """The content of a file."""
    check_file(path, most, empty=empty)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error


def parse_json(text: str | bytes, finite: bool = True) -> Any:
    """The value of a JSON text.

    >>> parse_json('[1, 2.5, "NaN"]')
    [1, 2.5, 'NaN']

    Raises:
        ValueError: it is not JSON, is nested too deeply, holds text that is not valid Unicode, or, where numbers must
            be ``finite``, one is not.
    """
    try:
        value = (
            json.loads(text, parse_constant=_refused, parse_float=_finite, parse_int=_whole)
            if finite
            else json.loads(text)
        )
        json.dumps(value, ensure_ascii=False).encode()  # half a surrogate pair could never be written
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except UnicodeEncodeError:
        raise ValueError("it holds text that is not valid Unicode") from None
    return value


def load_json(path: Path, finite: bool = True) -> Any:
    """The value in a JSON file.

    >>> load_json(Path("limits.json"))
    {'grip': [70.0, 46.0]}

    Raises:
        FileNotFoundError: there is none.
        ValueError: see :func:`check_file` and :func:`parse_json`.
    """
    path.stat()
    return parse_json(read_bytes(path, MAX_JSON_BYTES), finite)


def read_json(path: Path) -> Any:
    """The value in a JSON file of an import, where NaN stands for what is unknown."""
    content = read_bytes(path, MAX_JSON_BYTES)
    try:
        return parse_json(content, finite=False)
    except ValueError as error:
        raise InputError(f"{path} is not JSON: {error}.") from None


def read_object(path: Path) -> dict[str, Any]:
    """As :func:`read_json` for a JSON object."""
    value = read_json(path)
    if not isinstance(value, dict):
        raise InputError(f"{path} is not a JSON object.")
    return value


def read_arrays(path: Path, objects: list[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of an NPZ file; nothing is unpacked before it is known how much that is.

    Args:
        path: the file.
        objects: gets the names of arrays of Python objects, which are left out; None = they are an error.

    Raises:
        InputError: not a regular file, too many arrays, arrays too large for it, or nothing but Python objects.
        Exception: a damaged archive can fail in any way inside zipfile and NumPy.
    """
    size = check_file(path)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > MAX_MEMBERS:
            raise InputError(f"{path} holds {len(members)} arrays; expected at most {MAX_MEMBERS}.")
        declared, unpacked = 0, sum(entry.file_size for entry in members)
        for member in members:
            with archive.open(member) as file:
                try:
                    declared += declared_bytes(file)
                except InputError:
                    if objects is None or len(objects) == len(members) - 1:
                        raise
                    objects.append(member.filename.removesuffix(".npy"))
            # What is unpacked is the member's size; an array is read up to the size of its header.
            check_declared(path, max(declared, unpacked), size)
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
        return {key: arrays[key] for key in arrays.files if key not in (objects or ())}


def declared_bytes(file: Any) -> int:
    """Bytes of the array that the header of an NPY stream declares; -1 = an impossible shape."""
    version = np.lib.format.read_magic(file)
    shape, _, dtype = _HEADERS[(1, 0) if version == (1, 0) else (2, 0)](file)
    if dtype.hasobject:
        raise InputError("it holds Python objects, which are never loaded; save its arrays with numpy.savez")
    return math.prod(map(int, shape)) * max(dtype.itemsize, 1) if min(shape, default=0) >= 0 else -1


def checked_fields(kind: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """JSON values as the fields of a dataclass: each of the type that the class states, numbers finite.

    >>> from rcbht_jax.learning.svm import SvmSpec
    >>> checked_fields(SvmSpec, {"kernel": "rbf", "cost": 10})
    {'kernel': 'rbf', 'cost': 10}
    """
    hints = typing.get_type_hints(kind)
    known = {one.name for one in dataclasses.fields(kind)}
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{name} is not one of the fields of {kind.__name__}: {', '.join(sorted(known))}")
        if not fits(value, hints[name]):
            raise InputError(f"{name} is {str(value)[:40]!r}, which is not of the type that {kind.__name__} has for it")
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}


def checked_number(what: str, value: Any) -> float:
    """A number of a file, finite: no text that could be read as one, since float("inf") is no error.

    >>> checked_number("the level", 3)
    3.0
    """
    if not fits(value, float):
        raise InputError(f"{what} is {str(value)[:40]!r}, no finite number.")
    return float(value)


def checked_texts(what: str, values: Any, different: bool = False) -> tuple[str, ...]:
    """Texts of a file that become names: all of them texts that can be written, none absurdly long.

    >>> checked_texts("the classes", ["a", "b"])
    ('a', 'b')

    Args:
        what: their name in the error message.
        values: a JSON value.
        different: whether no two may be equal.
    """
    if not isinstance(values, list | tuple) or not all(map(_is_name, values)):
        raise InputError(f"{what} are not texts of at most {MAX_NAME} characters")
    if different and len(set(values)) < len(values):
        raise InputError(f"{what} are not all different")
    return tuple(values)


def _is_name(value: Any) -> bool:
    try:
        return isinstance(value, str) and len(value) <= MAX_NAME and bool(value.encode() or True)
    except UnicodeEncodeError:
        return False


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain value is of the type that a field of a dataclass states; numbers must be finite.

    >>> fits(5, int | None), fits("5", float), fits([1, 2], tuple[int, ...])
    (True, False, True)
    """
    origin, within = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in within)
    if origin is Literal:
        return isinstance(value, str | int) and value in within
    if origin is tuple:
        if not isinstance(value, list | tuple) or (Ellipsis not in within and len(value) != len(within)):
            return False
        return all(fits(one, within[0]) for one in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e300
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**31
    return isinstance(value, hint) if isinstance(hint, type) else True


def _refused(constant: str) -> float:
    raise ValueError(f"it holds {constant}, which is no number")


def _whole(text: str) -> int:
    return int(text) if len(text) <= MAX_DIGITS else int(_refused(text[:20] + "..."))


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refused(text[:20])
