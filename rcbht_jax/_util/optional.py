"""Packages of the extras: imported where they are used, and named with their extra where they are missing."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from rcbht_jax.errors import InputError

_OURS = ("rcbht_jax", "sim_mjx")


class MissingPackage(InputError, ImportError):
    """A package of an extra is not installed: an :class:`InputError` and an ``ImportError`` in one sentence."""

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f'{package} is not installed: pip install "rcbht-jax[{extra}]".')


@contextmanager
def needs_extra(name: str) -> Iterator[None]:
    """Name the extra to install when an import inside the block fails.

    >>> with needs_extra("report"):
    ...     import missing
    Traceback (most recent call last):
    rcbht_jax._util.optional.MissingPackage: missing is not installed: pip install "rcbht-jax[report]".

    Raises:
        MissingPackage: a package is missing.
    """
    try:
        yield
    except MissingPackage:
        raise
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package in _OURS:
            raise
        raise MissingPackage(package, name) from error


def require(module: str, extra: str) -> ModuleType:
    """Import a package of an extra.

    Args:
        module: what to import, such as ``"pyarrow.parquet"``.
        extra: the extra that brings it, such as ``"export"``.

    Raises:
        MissingPackage: it is not installed.
    """
    with needs_extra(extra):
        return importlib.import_module(module)
