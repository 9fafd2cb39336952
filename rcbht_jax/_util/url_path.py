"""Stores in object stores: a URL such as ``s3://bucket/trials.zarr`` wherever the path of a store is read."""

from __future__ import annotations

import re
from pathlib import Path, PosixPath

from rcbht_jax._util.values import expect

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]+:")  # two letters and more: C: is a drive


class UrlPath(PosixPath):
    """A path below a URL, which is written with its two slashes; there is no such file.

    >>> UrlPath("s3://bucket/trials.zarr") / "labels"
    UrlPath('s3://bucket/trials.zarr/labels')
    """

    def __str__(self) -> str:
        return super().__str__().replace(":/", "://", 1)


def as_path(place: Path | str) -> Path:
    """A path as it is, and text as the path or URL that it names.

    Raises:
        InputError: it is neither.
    """
    expect("The path", place, Path, str)
    if isinstance(place, Path):
        return place
    return UrlPath(place) if "://" in place else Path(place)


def url_of(path: Path) -> str | None:
    """The URL that a path stands for, also one that ``Path`` has folded; None = it is a file or folder.

    >>> url_of(Path("s3://bucket/trials.zarr")), url_of(Path("trials.zarr"))
    ('s3://bucket/trials.zarr', None)
    """
    first, *rest = path.parts or ("",)
    return f"{first}//{'/'.join(rest)}" if rest and _SCHEME.fullmatch(first) else None
