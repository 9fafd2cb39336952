"""Trials that come off the lanes of a device in the order of their end, put back into their shards."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from rcbht_jax.types import LabelTracks
from sim_mjx.synthesis.records import Arrays

Trial = tuple[Hashable, int]  # key of its shard, and number in it
PADDED = "wrench"  # the array that is as long as the longest trial


class Shard(NamedTuple):
    """A shard whose trials have all ended."""

    key: Hashable
    rows: Arrays  # of its trials, as of ``records.of_trials``
    tracks: LabelTracks | None  # [trial * wrist, axis, slot]


class _Piece(NamedTuple):
    at: Int[np.ndarray, " trial"]  # in the shard
    rows: Arrays
    tracks: LabelTracks | None


class Regroup:
    """Collects the trials of shards; a shard leaves as soon as it is complete."""

    def __init__(self) -> None:
        self._missing: dict[Hashable, int] = {}
        self._pieces: dict[Hashable, list[_Piece]] = {}

    def expect(self, key: Hashable, count: int) -> None:
        """Announce a shard of ``count`` trials."""
        self._missing[key], self._pieces[key] = count, []

    def add(self, trials: Sequence[Trial], rows: Arrays, tracks: LabelTracks | None) -> list[Shard]:
        """Add trials that have ended.

        Args:
            trials: shard and number in it of each.
            rows: arrays of the trials; rows beyond the last trial are ignored.
            tracks: their labels ``[trial * wrist, axis, slot]``, or none.

        Returns:
            the shards that are complete now.
        """
        complete = []
        keys = [key for key, _ in trials]
        for key in dict.fromkeys(keys):
            places = np.array([place for place, other in enumerate(keys) if other == key])
            at = np.array([trials[place][1] for place in places])
            together = places[-1] - places[0] == len(at) - 1
            which = slice(int(places[0]), int(places[-1]) + 1) if together else places  # a view where it can be
            labels = _labels_taken(tracks, which, len(rows["length"]))
            piece = _Piece(at, _taken(rows, which), labels)
            self._missing[key] -= len(at)
            # a view would keep the arrays of all trials in memory for as long as the shard waits
            self._pieces[key].append(jax.tree.map(np.copy, piece) if self._missing[key] else piece)
            if not self._missing[key]:
                del self._missing[key]
                complete.append(_joined(key, self._pieces.pop(key)))
        return complete


def _taken(rows: Arrays, which: NDArray[Any] | slice) -> Arrays:
    """Some trials, cut where the longest of them ends."""
    taken = {name: values[which] for name, values in rows.items()}
    return taken | {PADDED: taken[PADDED][:, : int(taken["length"].max())]}


def _labels_taken(tracks: LabelTracks | None, which: NDArray[Any] | slice, trials: int) -> LabelTracks | None:
    """Labels ``[trial, wrist * axis * slot ...]`` of some trials."""
    if tracks is None:
        return None
    return jax.tree.map(lambda leaf: leaf.reshape(trials, -1, *leaf.shape[1:])[which], tracks)


def _joined(key: Hashable, pieces: list[_Piece]) -> Shard:
    at = [piece.at for piece in pieces]
    rows = {name: _filled(at, [piece.rows[name] for piece in pieces]) for name in pieces[0].rows}
    labels = [piece.tracks for piece in pieces if piece.tracks is not None]
    if not labels:
        return Shard(key, rows, None)
    tracks = jax.tree.map(lambda *leaves: _filled(at, list(leaves)), *labels)
    return Shard(key, rows, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), tracks))


def _filled(at: list[NDArray[Any]], parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Parts ``[trial, ...]`` in their rows, padded with zeros to the largest."""
    if len(parts) == 1 and np.array_equal(at[0], np.arange(len(parts[0]))):
        return parts[0]  # the shard in one piece, in order: most are
    shape = np.max([part.shape[1:] for part in parts], axis=0).astype(int)
    out = np.zeros((sum(map(len, at)), *shape), np.result_type(*parts))
    for where, part in zip(at, parts, strict=True):
        place: tuple[Any, ...] = (where, *(slice(size) for size in part.shape[1:]))
        out[place] = part
    return out
