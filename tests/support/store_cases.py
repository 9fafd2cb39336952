"""Recordings to store, and what tests of the store and of its label tracks look for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rcbht_jax._util.digest import content_hash
from rcbht_jax.cli.main import main
from rcbht_jax.io.store import write_recordings
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings

INTERVALS = ("recording", "track", "code", "start", "end")


def simple(count: int = 3, samples: int = 50) -> Recordings:
    """Recordings with random wrenches, all of full length."""
    name = np.array([f"t{k}" for k in range(count)])
    return snap_recordings(
        wrench=np.random.default_rng(0).normal(size=(count, samples, 6)).astype(np.float32),
        length=np.full(count, samples, np.int32),
        dt=0.005,
        onset=np.tile([0.0, 0.1, 0.15, np.nan], (count, 1)),
        onset_harmonised=np.tile([0.0, 0.1, 0.15, np.nan], (count, 1)),
        trial=name,
        arm=np.full(count, "R"),
        source=np.full(count, "set"),
        session=np.full(count, "A"),
        outcome=np.full(count, "success"),
        failure_type=np.full(count, ""),
        deviation=np.full((count, 3), np.nan),
        note=np.full(count, ""),
    )


def encoded_store(path: Path, recordings: Recordings, attrs: dict[str, str] | None = None) -> Path:
    """A store with the label tracks online-W5."""
    write_recordings(path, recordings, attrs or {})
    assert main(["encode", str(path)]) == 0
    return path


def same(one: Recordings, two: Recordings) -> None:
    assert one.annotations.labels == two.annotations.labels
    assert sorted(one.columns) == sorted(two.columns)
    pairs = [(getattr(one, name), getattr(two, name)) for name in vars(one) if name not in ("annotations", "columns")]
    pairs += [(one.columns[name], two.columns[name]) for name in one.columns]
    pairs += [(getattr(one.annotations, name), getattr(two.annotations, name)) for name in INTERVALS]
    for left, right in ((np.asarray(left), np.asarray(right)) for left, right in pairs):
        assert left.dtype.kind == right.dtype.kind
        assert left.shape == right.shape
        # Bit for bit: the sign of zero counts, the width of a string's dtype does not.
        assert content_hash([left]) == content_hash([right])


def folder_is_clean(folder: Path, *expected: str) -> None:
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(expected)


def files(path: Path) -> Iterator[Path]:
    return (entry for entry in sorted(path.rglob("*")) if entry.is_file())
