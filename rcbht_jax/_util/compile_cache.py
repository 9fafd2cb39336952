"""A disk cache of compiled programs: physics on a GPU takes up to a minute to compile."""

from __future__ import annotations

import contextlib
import glob
import os
import re
import warnings
from pathlib import Path
from typing import Any

import jax

from rcbht_jax.errors import InputError

SLOW = 0.5  # s; programs that compile faster are not stored: the chain of a stream takes from one to three
_FAILED = re.compile(r"Error (?:reading|writing) persistent compilation cache entry for '([^']+)'")


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
    _replace_damaged(folder)


def _replace_damaged(folder: Path) -> None:
    """Delete programs that JAX cannot read or write, in place of its warning; it compiles and stores them anew.

    JAX writes a program in place, so that a killed process or a full disk leaves a part of it. It never replaces a file
    that is there: without this, each later process would warn and compile again.
    """
    show_others = warnings.showwarning

    def show(message: Warning | str, *where: Any, **further: Any) -> None:
        failed = _FAILED.match(str(message))
        if not failed:
            return show_others(message, *where, **further)
        for stored in folder.glob(f"{glob.escape(failed[1])}-*"):
            with contextlib.suppress(OSError):
                stored.unlink()

    warnings.showwarning = show
