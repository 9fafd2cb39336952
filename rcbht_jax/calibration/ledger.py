"""The scores of a search on disk, so that it can be interrupted; always a whole file or none."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.errors import InputError


class ScoreCheckpoint:
    """Scores ``[evaluation, score]`` in order; in memory only when there is no path.

    Args:
        path: file to go on from and to keep, ``.npz``.
        fingerprint: of everything the scores depend on.

    Raises:
        InputError: the file is no ledger or belongs to another search.
    """

    def __init__(self, path: Path | None, fingerprint: str) -> None:
        self._path, self._fingerprint = path, fingerprint
        self._scores: NDArray[np.float32] | None = None
        if path is not None and path.exists():
            try:
                with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                    kept, self._scores = str(stored["fingerprint"]), stored["scores"]
            except (OSError, ValueError, KeyError, zipfile.BadZipFile):
                raise InputError(f"{path} is not a ledger of a search; choose another file or remove it.") from None
            if kept != fingerprint:
                raise InputError(
                    f"{path} belongs to a search with other trials or options; choose another file or remove it."
                )

    def read(self, first: int, count: int) -> NDArray[np.float32]:
        """Scores of the evaluations ``first`` ... that are known, at most ``count``."""
        if self._scores is None:
            return np.zeros((0, 0), np.float32)
        return self._scores[first : first + count]

    def write(self, first: int, scores: NDArray[np.float32]) -> None:
        """Append the scores of the evaluations ``first`` ...; they follow the last known one."""
        known = scores[:0] if self._scores is None else self._scores
        if first != len(known):
            raise ValueError(f"evaluation {first} does not follow the {len(known)} known ones")
        self._scores = np.concatenate([known, scores])
        if self._path is not None:
            with atomic_write(self._path) as draft, draft.open("wb") as file:
                np.savez(file, fingerprint=np.array(self._fingerprint), scores=self._scores)
