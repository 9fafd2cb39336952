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
from numpy.typing import NDArray


def content_hash(arrays: Iterable[NDArray[Any] | np.generic]) -> str:
    """Digest of shapes and values; strings as UTF-8, so that the width of their dtype does not matter."""
    digest = hashlib.sha256()
    for values in arrays:
        array = np.ascontiguousarray(values)
        digest.update(repr(array.shape).encode())
        digest.update(json.dumps(array.tolist()).encode() if array.dtype.kind == "U" else array.data)
    return digest.hexdigest()


def data_hash(recordings: Any) -> str:
    """Digest of the wrenches, lengths, state times, names and classes of a :class:`rcbht_jax.types.Recordings`."""
    digest = hashlib.sha256()
    names = ("wrench", "length", "onset", "onset_harmonised", "trial", "arm", "session", "outcome", "failure_type")
    for name in names:
        values = getattr(recordings, name)
        digest.update(f"{name} {values.shape} ".encode())
        digest.update("\n".join(values.tolist()).encode() if values.dtype.kind == "U" else values.tobytes())
    return digest.hexdigest()


def files_hash(root: Path, paths: Iterable[Path]) -> str:
    """Digest of files below ``root``, by relative name and content, in the given order; unreadable ones are skipped."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            content = hashlib.sha256(path.read_bytes()).digest()
        except OSError:
            continue
        digest.update(path.relative_to(root).as_posix().encode("utf-8", "replace") + content)
    return digest.hexdigest()
