"""Compiled programs kept on disk between processes: physics on a GPU takes up to a minute to compile."""

from __future__ import annotations

import os
from pathlib import Path

import jax

from rcbht_jax.errors import InputError

SLOW = 2.0  # s of compilation from which a program is kept


def default_folder() -> Path:
    """Where caches of a user belong: ``$XDG_CACHE_HOME`` or ``~/.cache``, in it ``rcbht-jax``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rcbht-jax"


def use(folder: Path | None = None) -> None:
    """Keep programs that this process compiles from now on, and load those that are kept.

    Args:
        folder: made if it is not there; default the user's cache folder. It may be deleted at any time.

    Raises:
        InputError: the folder cannot be made.
    """
    folder = default_folder() if folder is None else folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {folder} for compiled programs cannot be made: {error.strerror}.") from error
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SLOW)
