"""Sums of a stream's features over made-up labels: those of the grammar for the same labels, and nothing is lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.features import FAMILIES, WHOLE, FeatureSpec, Intervals, interval_features
from rcbht_jax.features import signal_families as drawn
from rcbht_jax.features.online import RunningStats, _means, add, describe_interval, empty, names, weights
from rcbht_jax.features.online_weights import two_sum
from rcbht_jax.labels import LAYER_SIZES, LAYERS
from rcbht_jax.types import LabelTrack, LabelTracks

DT, AXES, WORDS = 0.01, 2, 12
SUMS = FeatureSpec(tuple(f for f in FAMILIES if f not in {*WHOLE, *drawn.FAMILIES}), weighing=("time", "change"))


def made_up(rng: np.random.Generator, codes: int) -> LabelTrack:
    """Labels that follow each other, some of them level although their values differ."""
    edges = np.sort(rng.permutation(np.arange(1, 200))[: AXES * (WORDS + 1)].reshape(AXES, -1), axis=1).astype(np.int32)
    label = rng.integers(1, codes + 1, (AXES, WORDS)).astype(np.int8)
    avg, half = (rng.normal(size=(2, AXES, WORDS)) * [[1], [1e-3]]).astype(np.float32)  # N, and far less
    slope = rng.choice([-1.0, 0.0, 1.0], (AXES, WORDS)).astype(np.float32)
    return LabelTrack(label, edges[:, :-1], edges[:, 1:], edges[:, 1:], avg + abs(half), avg - abs(half), avg, slope)


def with_gaps(track: LabelTrack, some: slice) -> LabelTrack:
    """Some of the labels, in every other slot."""

    def spread(leaf: np.ndarray) -> np.ndarray:
        return np.stack([np.zeros_like(leaf[:, some]), leaf[:, some]], -1).reshape(AXES, -1)

    return jax.tree.map(spread, track)


def test_any_labels_in_any_parts_give_the_features_of_the_grammar() -> None:
    grown, described = jax.jit(add, static_argnums=(0, 1)), jax.jit(describe_interval, static_argnums=(0, 1))
    for seed in range(3):
        tracks = LabelTracks(*(made_up(np.random.default_rng((seed, size)), size) for size in LAYER_SIZES))
        for begin in (0, 90):
            stats = empty(SUMS, jnp.int32(begin), AXES)
            for first in range(0, WORDS, 4):
                part = partial(with_gaps, some=slice(first, first + 4))
                stats = grown(SUMS, DT, stats, LabelTracks(*(part(getattr(tracks, layer)) for layer in LAYERS)))
            interval = Intervals(np.array([0]), np.array([begin]), np.array([210]), DT)
            whole = jax.tree.map(lambda leaf: leaf[None], tracks)
            expected = interval_features(whole, interval, SUMS).values[0]
            np.testing.assert_allclose(described(SUMS, DT, stats, jnp.int32(210)), expected, atol=2e-6)


def test_levels_that_vanish_beside_their_sum_are_not_lost() -> None:
    """A hundred million and a thousand times 1 N, which single precision alone would round away."""
    spec = FeatureSpec(("offset",), layers=("llb",))
    word = LabelTrack(*(jnp.full((1, 1), x, jnp.int32) for x in (1, 0, 1, 1)), *(jnp.ones((1, 1)),) * 4)
    begun = empty(spec, jnp.int32(0), 1)
    assert begun.values is not None
    begun = replace(begun, values=replace(begun.values, total=begun.values.total.at[0, 0, 0, 2].set(1e8)))

    def more(_: int, stats: RunningStats) -> RunningStats:
        return add(spec, DT, stats, LabelTracks(word, word, word))

    stats = jax.lax.fori_loop(0, 1000, more, begun)
    assert stats.values is not None
    mean, _, level = _means(spec, stats, stats.values)
    np.testing.assert_allclose([mean[0, 0, 0, 2], level[0, 0, 0]], [1e5 + 1] * 2, rtol=2e-7)


def test_columns_weigh_so_that_each_kind_of_family_counts_as_much() -> None:
    spec = FeatureSpec(("histogram", "edges", "elapsed"), weighing=("time",))
    assert weights(replace(spec, balance=False), 3) is None
    found = weights(replace(spec, balance=True), 3)
    assert found is not None
    words, edges = 3 * sum(LAYER_SIZES), 3 * 3 * 4
    total = words + edges + 1
    assert len(found) == len(names(spec, 3)) == total
    expected = {round((total / 3 / columns) ** 0.5, 6): columns for columns in (words, edges, 1)}
    assert Counter(found.round(6).tolist()) == expected


def test_a_sum_and_what_it_lost_are_exact_whichever_is_larger() -> None:
    rng = np.random.default_rng(0)
    total, value = (rng.normal(size=(2, 500)) * 10.0 ** rng.integers(-3, 4, (2, 500))).astype(np.float32)
    for a, b, *parts in zip(total, value, *two_sum(total, np.zeros_like(total), value), strict=True):
        assert Fraction(float(a)) + Fraction(float(b)) == sum(map(Fraction, map(float, parts)))
