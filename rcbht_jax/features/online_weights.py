"""Sums over words and runs of words by weights other than one, while the interval grows.

Sums are kept in two single-precision numbers each, as those of :mod:`rcbht_jax.features.online`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from rcbht_jax.types import Array, LabelTrack


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WeighedSums:
    """What the labels of an interval weigh, in samples or in units of the axis."""

    words: Array  # float32 [2, layer, axis, code], sums and what rounding took from them
    runs: Array  # float32 [2, layer, axis, run], the same of runs of labels; [2, layer, axis, 0] where none are needed
    last: Array  # float32 [layer, axis, n - 1], weights of the latest labels, oldest first


def empty(lanes: tuple[int, int], codes: int, runs: int, ngram: int) -> WeighedSums:
    """No label yet, of ``lanes`` (layers, axes)."""
    return WeighedSums(
        words=jnp.zeros((2, *lanes, codes), jnp.float32),
        runs=jnp.zeros((2, *lanes, runs), jnp.float32),
        last=jnp.zeros((*lanes, ngram - 1), jnp.float32),
    )


def weights(kind: str, words: LabelTrack, span: Array) -> Array:
    """Weight float32 ``[layer, axis, slot]``, time or change, of labels of which ``span`` samples count."""
    time = span.astype(jnp.float32)
    if kind == "time":
        return time
    whole = jnp.maximum(words.t1 - words.t0, 1).astype(jnp.float32)
    return (words.vmax - words.vmin) * (time / whole)


def add(sums: WeighedSums, weight: Array, word_hot: Array, run_hot: Array) -> WeighedSums:
    """Add labels.

    Args:
        sums: of the labels before.
        weight: of each label ``[layer, axis, slot]``, any number in empty slots.
        word_hot: bool ``[layer, axis, slot, code]``, which label; none in empty slots.
        run_hot: bool ``[layer, axis, slot, run]``, which run the label ends; none where it ends none.
    """
    used = jnp.any(word_hot, axis=-1)
    last, of_run = sums.last, []
    for slot in range(weight.shape[-1]):
        window = jnp.concatenate([last, weight[..., slot : slot + 1]], axis=-1)
        of_run.append(jnp.sum(window, axis=-1))
        last = jnp.where(used[..., slot : slot + 1], window[..., 1:], last)
    return WeighedSums(
        words=_grown(sums.words, word_hot, weight),
        runs=_grown(sums.runs, run_hot, jnp.stack(of_run, axis=-1)),
        last=last,
    )


def _grown(pair: Array, hot: Array, weight: Array) -> Array:
    return jnp.stack(two_sum(pair[0], pair[1], jnp.sum(jnp.where(hot, weight[..., None], 0), axis=2)))


def share(pair: Array) -> Array:
    """Sums ``[2, layer, axis, column]`` divided by their sum over the columns; zero where that is 0."""
    exact = pair[0] + pair[1]
    total = jnp.broadcast_to(jnp.sum(exact, axis=-1, keepdims=True), exact.shape)
    return jnp.where(total > 0, exact / jnp.where(total > 0, total, 1), 0)


def two_sum(total: Array, lost: Array, value: Array) -> tuple[Array, Array]:
    """Sum and its rounding error (Knuth); exact as long as nothing is reassociated, which XLA does not do."""
    new = total + value
    part = new - total
    return new, lost + ((total - (new - part)) + (value - part))


def needed(weighing: Sequence[str], runs: bool) -> tuple[str, ...]:
    """The weighings that need sums of their own; words are counted and timed anyway, runs only counted."""
    return tuple(kind for kind in weighing if kind == "change" or (kind == "time" and runs))
