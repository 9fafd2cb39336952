"""Rows on the stability of words: copies of recordings with other noise, and at other rates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from experiments._lib.benchmarks import rounded
from experiments._lib.word_stability import Words, agreement, best_lines, noisy, resampled, words_of
from experiments.words.sets import OURS, Part, part
from rcbht_jax.labels import LAYERS
from rcbht_jax.types import Recordings

NOISE = (0.125, 0.25, 0.5, 1.0, 2.0)  # deviation, as a share of the tolerance
RATES = (40, 100, 200, 500, 1000)  # Hz
WINDOW = 0.025  # s, at every rate, but at least two samples
PAPER, KEPT, OWN, BEST = "published rules", "fit", "fit, tolerance of each copy", "bottom-up, as many as fit"


def rows(seed: int) -> dict[str, Callable[[], Any]]:
    """How to make each row."""
    noise = {
        f"noise | {name} | {rule}": partial(of_noise, name, rule, seed)
        for name in OURS
        for rule in (PAPER, KEPT, OWN, BEST)
    }
    return noise | {
        f"resampled | {name} | {rule}": partial(of_rates, name, rule) for name in OURS for rule in (PAPER, KEPT)
    }


def of_noise(name: str, rule: str, seed: int) -> dict[str, Any]:
    """Agreement of two copies at every level of noise; the same copies for every rule."""
    data, found = part(name), {}
    window = round(WINDOW / data.recordings.dt)
    for level in NOISE:
        first, second = (_words(data, rule, copy, window) for copy in noisy_copies(data, level, seed))
        found[f"{level:g}"] = _agreement(first, second, data, WINDOW)
    return found


def noisy_copies(data: Part, level: float, seed: int) -> list[Recordings]:
    """Two copies with independent noise, its deviation a share of the tolerance."""
    rng = np.random.default_rng([seed, round(1000 * level)])
    return [noisy(data.recordings, data.tolerance * level, rng) for _ in range(2)]


def of_rates(name: str, rule: str) -> dict[str, Any]:
    """Agreement with the recordings at their own rate; breaks may move by the longer one of both windows."""
    data, found = part(name), {}
    own = _words(data, rule, data.recordings, round(WINDOW / data.recordings.dt))
    for rate in RATES:
        copy, window = resampled(data.recordings, rate), max(2, round(WINDOW * rate))
        found[f"{rate}"] = _agreement(own, _words(data, rule, copy, window), data, max(WINDOW, window / rate))
    return found


def _words(data: Part, rule: str, copy: Recordings, window: int) -> dict[str, list[Words]]:
    """Words of each layer; the bottom-up lines are primitives alone."""
    if rule == BEST:
        return {"primitive": _best(data, copy, window)}
    tolerance = None if rule == OWN else data.tolerance
    tracks = data.words("paper" if rule == PAPER else "fit", window, tolerance, copy)
    return {layer: words_of(getattr(tracks, layer), copy.dt) for layer in LAYERS}


def _agreement(
    first: dict[str, list[Words]], second: dict[str, list[Words]], data: Part, within: float
) -> dict[str, Any]:
    pairs = {layer: zip(words, second[layer], strict=True) for layer, words in first.items()}
    return {layer: rounded(agreement(both, within, len(data.tolerance))) for layer, both in pairs.items()}


def _best(data: Part, copy: Recordings, window: int) -> list[Words]:
    counts = np.asarray(data.words("fit", window, data.tolerance, copy).primitive.label > 0).sum(-1)
    limits, tolerance = data.limits(window), data.tolerance.tolist()
    return [
        best_lines(y.astype(np.float64), count, copy.dt, limit, most)
        for one, samples, of_row in zip(copy.wrench, copy.length, counts.tolist(), strict=True)
        for y, count, limit, most in zip(one[:samples].T, of_row, limits, tolerance, strict=True)
    ]
