"""Stores in object stores: a URL such as ``s3://bucket/trials.zarr`` wherever the path of a store is read.

A URL of a file, such as ``file:///data/trials.zarr``, is only another spelling of a path.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PosixPath
from urllib.parse import unquote_to_bytes

from rcbht_jax._util.values import expect
from rcbht_jax.errors import InputError

_SCHEME = re.compile(r"(?:[a-z]+::)*[a-z][a-z0-9+.-]+:")  # two letters and more: C: is a drive
_FILE = re.compile("(?i:file):(?://(?P<host>[^/]*))?(?P<path>/.*)", re.DOTALL)  # Path leaves one slash of three


class UrlPath(PosixPath):
    """A path below a URL, which is written with its two slashes; there is no such file.

    >>> UrlPath("s3://bucket/trials.zarr") / "labels"
    UrlPath('s3://bucket/trials.zarr/labels')
    """

    def __str__(self) -> str:
        return super().__str__().replace(":/", "://", 1)


def as_path(place: Path | str) -> Path:
    """A path as it is, and text as the path or URL that it names; a URL of a file, as either, as the path of the file.

    >>> as_path("file:///data/my%20trials.zarr")
    PosixPath('/data/my trials.zarr')

    Raises:
        InputError: it is neither, or a file of another computer.
    """
    expect("The path", place, Path, str)
    if file := _FILE.fullmatch(str(place)):
        if file["host"] not in (None, "", "localhost") or "%00" in file["path"]:
            raise InputError(f"{place} is not a file of this computer; expected file:///PATH.")
        return Path(os.fsdecode(unquote_to_bytes(file["path"])))
    if isinstance(place, Path):
        return place
    return UrlPath(place) if "://" in place else Path(place)


def url_of(path: Path) -> str | None:
    """The URL that a path stands for, also one that ``Path`` has folded; None = it is a file or folder.

    >>> url_of(Path("s3://bucket/trials.zarr")), url_of(Path("trials.zarr"))
    ('s3://bucket/trials.zarr', None)

    Raises:
        InputError: it is a chain of URLs, such as zip://trials.zarr::trials.zip.
    """
    first, *rest = path.parts or ("",)
    if not rest or not _SCHEME.fullmatch(first):
        return None
    if "::" in str(path):
        raise InputError(f"{path} is a chain of URLs; expected one URL. Unpack an archive first.")
    return f"{first}{'///' if first == 'file:' else '//'}{'/'.join(rest)}"
