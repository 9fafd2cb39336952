"""A disk cache of compiled programs: physics on a GPU takes up to a minute to compile."""

from __future__ import annotations

import os
from pathlib import Path

import jax

from rcbht_jax.errors import InputError

SLOW = 2.0  # s; programs that compile faster are not stored


def default_folder() -> Path:
    """``rcbht-jax`` in the user's cache folder: ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rcbht-jax"


def use(folder: Path | None = None) -> None:
    """Store the programs that this process compiles from now on, and load stored ones.

    Args:
        folder: created if it does not exist; default :func:`default_folder`, and no cache where that cannot be
            created. It may be deleted at any time.

    Raises:
        InputError: the folder that was named cannot be created.
    """
    named = folder
    try:
        folder = named or default_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: a user without a home
        if named is None:
            return
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"The folder {named} for compiled programs cannot be created: {reason}.") from error
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SLOW)
