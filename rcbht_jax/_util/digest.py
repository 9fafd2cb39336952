"""SHA-256 digests, in hexadecimal, of arrays, data sets and files.

Stores, models and committed results hold these digests: what is hashed must not change.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8
from numpy.typing import NDArray


def content_hash(arrays: Iterable[NDArray[Any] | np.generic]) -> str:
    """Digest of shapes and values; strings as UTF-8, so that the width of their dtype does not matter."""
    digest = hashlib.sha256()
    for values in arrays:
        array = np.ascontiguousarray(values)
        digest.update(repr(array.shape).encode())
        digest.update(json.dumps(array.tolist()).encode() if array.dtype.kind == "U" else array.data)
    return digest.hexdigest()


# Tracks of annotations under which version 0.1 kept its start times of sub-tasks, and its names for them.
_V1_TRACKS = {"states": "onset", "states-harmonised": "onset_harmonised", "states-merged": ""}


def data_hash(recordings: Any, wrenches: Iterable[NDArray[Any]] | None = None, samples: int = 0) -> str:
    """Digest of the wrenches, lengths, annotations, names and classes of a :class:`rcbht_jax.types.Recordings`.

    Args:
        recordings: the data set; where ``wrenches`` are given, its own are not used.
        wrenches: of all recordings, in batches ``[recording, time, axis]``, where they are not in memory.
        samples: to which all batches are padded.

    Of data with the annotations of version 0.1 it is the digest of that version, which stands in its models.
    """
    marks = recordings.annotations
    if set(marks.labels) == set(_V1_TRACKS):
        starts = {name: recordings.starts(track) for track, name in _V1_TRACKS.items() if name}
        columns = {"failure_type": recordings.column("failure_type")}
    else:
        order = [name for track in marks.labels for name in ("", track, *marks.labels[track])]
        starts = {"labels": np.array(order, np.str_)}
        starts |= {name: getattr(marks, name) for name in ("recording", "track", "code", "start", "end")}
        columns = {name: recordings.columns[name] for name in sorted(recordings.columns)}
    fields = {name: getattr(recordings, name) for name in ("trial", "arm", "session", "outcome")}
    fields = {"length": recordings.length} | starts | fields | columns
    digest = hashlib.sha256()
    if wrenches is None:
        wrenches, samples = [recordings.wrench], recordings.wrench.shape[1]
    digest.update(f"wrench {(len(recordings.length), samples, recordings.wrench.shape[2])} ".encode())
    for wrench in wrenches:
        rest = bytes((samples - wrench.shape[1]) * wrench[0, :1].nbytes) if len(wrench) else b""
        for row in wrench:  # a copy of a whole padded batch would take several times its memory
            digest.update(np.ascontiguousarray(row).data)
            digest.update(rest)
    for name, values in fields.items():
        digest.update(f"{name} {values.shape} ".encode())
        digest.update("\n".join(values.tolist()).encode() if values.dtype.kind == "U" else values.tobytes())
    return digest.hexdigest()


def wrench_digests(
    wrench: Float32[np.ndarray, "recording time axis"], length: Int32[np.ndarray, " recording"]
) -> UInt8[np.ndarray, "recording byte"]:
    """Digest of each recording's samples ``[recording, 32]``."""
    rows = zip(wrench, length.tolist(), strict=True)
    found = b"".join(hashlib.sha256(row[:samples].tobytes()).digest() for row, samples in rows)
    return np.frombuffer(found, np.uint8).reshape(len(length), 32)


def among(
    digests: UInt8[np.ndarray, "recording byte"], others: UInt8[np.ndarray, "other byte"]
) -> Bool[np.ndarray, " recording"]:
    """Which digests of :func:`wrench_digests` are among others."""
    known = set(map(bytes, others))
    return np.array([bytes(one) in known for one in digests], bool)


def files_hash(root: Path, paths: Iterable[Path]) -> str:
    """Digest of files below ``root``, by relative name and content, in the given order; unreadable ones are skipped."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            if not path.is_file():  # a pipe or a device might never end
                continue
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").digest()
        except OSError:
            continue
        digest.update(path.relative_to(root).as_posix().encode("utf-8", "replace") + content)
    return digest.hexdigest()
