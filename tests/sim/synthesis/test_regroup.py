"""Trials in the order of their end become shards again, whatever the order."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

from rcbht_jax.types import LabelTrack, LabelTracks
from sim_mjx.synthesis import records
from sim_mjx.synthesis.regroup import Regroup

SIZES = {"a": 7, "b": 5, "c": 1}
ALL = [(key, row) for key, size in SIZES.items() for row in range(size)]


def trials_of(which: list[tuple[str, int]]) -> tuple[records.Arrays, LabelTracks]:
    """Made-up trials of two wrists that tell their shard and number, with notes and labels."""
    number = np.array([ALL.index(one) for one in which])
    length = (3 + number % 4).astype(np.int32)
    longest = int(length.max())
    inside = np.arange(longest) < length[:, None]
    wrench = np.where(inside[..., None], number[:, None, None] + np.arange(1, 13), 0).astype(np.float32)
    onset = np.stack([number * 1.0, number * 2.0], 1)
    notes = np.array(["moved" * int(n) for n in number])
    out = {
        "wrench": wrench, "length": length, "onset": onset, "note": notes, "seated": (number % 2 == 0)[:, None],
        "diverged": number % 5 == 0,
    }  # fmt: skip
    slots = int((number % 3).max()) + 1
    labels = np.where(np.arange(slots) <= (number % 3)[:, None], number[:, None] + 1, 0)
    tracks = np.repeat(labels, 2, 0)[:, None] * np.ones((1, 6, 1), int)
    whole, real = tracks.astype(np.int32), tracks.astype(np.float32)
    track = LabelTrack(tracks.astype(np.int8), whole, whole, whole, real, real, real, real)
    return out, LabelTracks(track, track, track)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("labelled", [True, False])
def test_shards_are_those_of_trials_in_order(seed: int, labelled: bool) -> None:
    rng = np.random.default_rng(seed)
    order = [ALL[place] for place in rng.permutation(len(ALL))]
    cuts = np.sort(rng.choice(np.arange(1, len(ALL)), seed, replace=False))
    group, found = Regroup(), dict[Any, Any]()
    for key, size in SIZES.items():
        group.expect(key, size)
    for part in np.split(np.arange(len(ALL)), cuts):
        which = [order[place] for place in part]
        out, tracks = trials_of(which)
        for shard in group.add(which, out, tracks if labelled else None):
            assert shard.key not in found
            found[shard.key] = shard
    assert set(found) == set(SIZES)
    for key, size in SIZES.items():
        out, tracks = trials_of([(key, row) for row in range(size)])
        assert set(found[key].rows) == set(out)
        for name, expected in out.items():
            np.testing.assert_array_equal(found[key].rows[name], expected)
        if labelled:
            again = records.of_labels(found[key].tracks, size)
            for name, expected in records.of_labels(tracks, size).items():
                np.testing.assert_array_equal(again[name], expected)
        else:
            assert found[key].tracks is None


def test_trials_that_wait_for_their_shard_keep_no_others_in_memory() -> None:
    group = Regroup()
    for key, size in SIZES.items():
        group.expect(key, size)
    out, tracks = trials_of(ALL[:10])  # all of "a" and three of "b"
    (whole,) = group.add(ALL[:10], out, tracks)
    assert whole.key == "a"
    assert np.shares_memory(whole.rows["wrench"], out["wrench"])  # it is written at once
    (waiting,) = group._pieces["b"]
    for leaf in jax.tree.leaves((waiting.rows, waiting.tracks)):
        assert leaf.base is None or leaf.base.nbytes == leaf.nbytes
