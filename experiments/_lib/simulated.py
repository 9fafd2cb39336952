"""Simulated trials and arrays that are kept in files, and made only where these are missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.synthesis.pipeline import earlier, synthesise
from sim_mjx.synthesis.plan import SynthesisConfig
from sim_mjx.synthesis.shards import folder_of


def simulated(path: Path, job: SynthesisConfig) -> Recordings:
    """The trials of a store, made if it is missing; one that was interrupted goes on.

    Raises:
        InputError: the store that is there was made by another job or other code; files were made from it, too.
    """
    if earlier(path, job) is None:
        if path.exists() and not folder_of(path).exists():
            raise InputError(f"{path} was made with other options or code; delete it, and the files made from it.")
        path.parent.mkdir(parents=True, exist_ok=True)
        synthesise(path, job)
    return read_recordings(path)


def kept_arrays(path: Path, make: Callable[[], dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Arrays by name."""
    if not path.is_file():
        with atomic_write(path) as draft:
            np.savez(draft, **make())  # type: ignore[arg-type]
    with np.load(path) as kept:
        return dict(kept)


def assembled(
    wrench: NDArray[np.floating], length: NDArray[np.integer], onset: NDArray[np.floating], source: str, **known: Any
) -> Recordings:
    """Simulated trials as recordings, of the right arm and without a deviation unless these columns are ``known``.

    The wrench is ``[trial, time, 6]``, the onset of the four states in s; the source is also the session.
    """
    count = len(length)
    texts = {"arm": "R", "source": source, "session": source, "failure_type": "", "note": ""}
    columns = {name: np.full(count, text) for name, text in texts.items()}
    columns |= {"deviation": np.zeros((count, 3)), "onset_harmonised": onset} | known
    return snap_recordings(wrench, length, CONTROL_PERIOD, onset=onset, **columns)
