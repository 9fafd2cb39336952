"""Trials that come off the lanes of a device in the order of their end, put back into their shards."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from rcbht_jax.types import LabelTracks
from sim_mjx.assembly.rollout import Rollouts

Arrays = NDArray[Any]
Trial = tuple[Hashable, int]  # key of its shard, and number in it
PADDED = ("wrench", "joints")  # fields of rollouts that are as long as the longest trial


class Shard(NamedTuple):
    """A shard whose trials have all ended."""

    key: Hashable
    trials: Rollouts
    tracks: LabelTracks | None  # [trial * wrist, axis, slot]


class _Piece(NamedTuple):
    rows: Int[np.ndarray, " trial"]  # in the shard
    trials: Rollouts
    tracks: LabelTracks | None


class Regroup:
    """Collects the trials of shards; a shard leaves as soon as it is complete."""

    def __init__(self) -> None:
        self._missing: dict[Hashable, int] = {}
        self._pieces: dict[Hashable, list[_Piece]] = {}

    def expect(self, key: Hashable, count: int) -> None:
        """A shard of so many trials will come."""
        self._missing[key], self._pieces[key] = count, []

    def add(self, trials: Sequence[Trial], out: Rollouts, tracks: LabelTracks | None) -> list[Shard]:
        """Trials that have ended.

        Args:
            trials: shard and number in it of each.
            out: the trials; rows behind the last of them are ignored.
            tracks: their labels ``[trial * wrist, axis, slot]``, or none.

        Returns:
            the shards that are complete now.
        """
        complete = []
        keys = [key for key, _ in trials]
        for key in dict.fromkeys(keys):
            at = np.array([place for place, other in enumerate(keys) if other == key])
            rows = np.array([trials[place][1] for place in at])
            which = slice(0, len(at)) if at[-1] == len(at) - 1 else at  # a view where it can be
            self._pieces[key].append(_Piece(rows, _taken(out, which), _labels_taken(tracks, which, len(out.length))))
            self._missing[key] -= len(rows)
            if not self._missing[key]:
                del self._missing[key]
                complete.append(_joined(key, self._pieces.pop(key)))
        return complete


def _taken(out: Rollouts, at: Arrays | slice) -> Rollouts:
    """Some trials, cut where the longest of them ends."""
    longest = int(out.length[at].max())
    values = {field.name: getattr(out, field.name)[at] for field in fields(Rollouts) if field.name not in PADDED}
    return Rollouts(**values, **{name: getattr(out, name)[at, :longest] for name in PADDED})


def _labels_taken(tracks: LabelTracks | None, at: Arrays | slice, trials: int) -> LabelTracks | None:
    """Labels ``[trial, wrist * axis * slot ...]`` of some trials."""
    if tracks is None:
        return None
    return jax.tree.map(lambda leaf: leaf.reshape(trials, -1, *leaf.shape[1:])[at], tracks)


def _joined(key: Hashable, pieces: list[_Piece]) -> Shard:
    rows = [piece.rows for piece in pieces]
    names = [field.name for field in fields(Rollouts)]
    trials = Rollouts(**{name: _filled(rows, [getattr(piece.trials, name) for piece in pieces]) for name in names})
    labels = [piece.tracks for piece in pieces if piece.tracks is not None]
    if not labels:
        return Shard(key, trials, None)
    tracks = jax.tree.map(lambda *leaves: _filled(rows, list(leaves)), *labels)
    return Shard(key, trials, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), tracks))


def _filled(rows: list[Arrays], parts: list[Arrays]) -> Arrays:
    """Parts ``[trial, ...]`` in their rows, padded with zeros to the largest."""
    if len(parts) == 1 and np.array_equal(rows[0], np.arange(len(parts[0]))):
        return parts[0]  # the shard in one piece, in order: most are
    shape = np.max([part.shape[1:] for part in parts], axis=0).astype(int)
    out = np.zeros((sum(map(len, rows)), *shape), parts[0].dtype)
    for where, part in zip(rows, parts, strict=True):
        place: tuple[Any, ...] = (where, *(slice(size) for size in part.shape[1:]))
        out[place] = part
    return out
