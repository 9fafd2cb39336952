"""Recordings to store, and what tests of the store and of its label tracks look for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np

from rcbht_jax._util.digest import content_hash
from rcbht_jax.cli.main import main
from rcbht_jax.io.store import write_recordings
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings

WORDS = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\x00"), max_size=6)
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


@st.composite
def some_fields(draw: st.DrawFn) -> dict[str, Any]:
    """Arguments of snap_recordings."""
    count, samples = draw(st.integers(1, 4)), draw(st.integers(1, 30))
    length = draw(hnp.arrays(np.int32, count, elements=st.integers(1, samples)))
    finite = st.floats(-1e5, 1e5, width=32)
    wrench = draw(hnp.arrays(np.float32, (count, samples, 6), elements=finite))
    for row, end in zip(wrench, length, strict=True):
        row[end:] = 0
    numbers = st.one_of(st.floats(-1e3, 1e3), st.just(np.nan))

    def words(elements: st.SearchStrategy[str]) -> np.ndarray:
        return np.array(draw(st.lists(elements, min_size=count, max_size=count)), np.str_)

    onset, better, deviation = (draw(hnp.arrays(np.float64, (count, width), elements=numbers)) for width in (4, 4, 3))
    return {
        "wrench": wrench,
        "length": length,
        "dt": draw(st.floats(1e-4, 1.0)),
        "onset": onset,
        "onset_harmonised": better,
        "trial": words(WORDS),
        "arm": words(st.sampled_from(["R", "L"])),
        "source": words(WORDS),
        "session": words(WORDS),
        "outcome": words(st.sampled_from(["success", "failure", "unknown"])),
        "failure_type": words(WORDS),
        "deviation": deviation,
        "note": words(WORDS),
    }


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
