"""Families that read the sentence back from its straight lines: shape, order, and axes beside each other.

A primitive is a line, so the sentence can be drawn again from its words alone. It is read at equally spaced moments,
which makes every column free of the sentence's length. Only ``levels`` changes when a constant is added to the
wrench; ``together`` and ``order`` do not change either when wrench and thresholds are scaled together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.features.spans import ClippedSpans, ratio
from rcbht_jax.features.word_families import Block, compressed
from rcbht_jax.labels import AXES, PRIMITIVE_GROUP, Group

MOMENTS = 120  # at which a sentence is read
PARTS = (3, 8)  # equal parts in which a sentence is described, coarse and fine
QUANTILES = 11
NEAR = 1e-6  # of the range or the level: smaller differences are rounding and decide nothing

_FIRST, _SECOND = np.triu_indices(len(AXES), 1)
PAIRS = tuple(f"{AXES[i]}-{AXES[j]}" for i, j in zip(_FIRST, _SECOND, strict=True))

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ResampledSignal:
    """A sentence read at MOMENTS equally spaced moments; zeros where an axis has no word."""

    sign: NDArray[np.int64]  # [sentence, axis, moment] 1 rising, -1 falling, 0 constant
    level: Values  # [sentence, axis, moment] N or Nm
    slope: Values  # [sentence, axis, moment] N/s or Nm/s

    @property
    def relative(self) -> Values:
        """Level minus the sentence's mean level."""
        return _centred(self.level)

    @property
    def range(self) -> Values:
        """Highest minus lowest level, ``[sentence, axis, 1]``."""
        return np.ptp(self.level, axis=-1)[..., None]


def read_back(words: ClippedSpans, dt: float) -> ResampledSignal:
    """Read primitives at the middle of MOMENTS equal slots; between words the one before lasts on."""
    return read_at(words, (np.arange(MOMENTS) + 0.5) / MOMENTS * words.length[:, None], dt)


def read_at(words: ClippedSpans, moment: Values, dt: float) -> ResampledSignal:
    """Read primitives at ``moment`` ``[sentence, MOMENTS]``, samples since the sentence began, increasing."""
    sentences, axes, slots = words.code.shape
    # One search for all lanes: each lane's times are shifted behind those of the lane before.
    far = float(words.length.max(initial=0)) + 2
    lane = np.arange(sentences * axes).reshape(sentences, axes, 1)
    starts = np.where(words.code > 0, words.start, far - 1) + lane * far
    found = np.searchsorted(starts.ravel(), (moment[:, None] + lane * far).ravel(), side="right") - 1
    index = np.maximum(found.reshape(sentences, axes, MOMENTS) - lane * slots, 0)

    def said(values: NDArray[np.float64]) -> Values:
        return np.take_along_axis(values, index, -1)

    offset = (moment[:, None] - said(words.value["middle"])) * dt
    level = said(words.value["avg"]) + said(words.value["grad"]) * offset
    level = np.clip(level, said(words.value["vmin"]), said(words.value["vmax"]))
    flat = np.ptp(level, axis=-1) <= NEAR * np.abs(level).max(-1)
    group = PRIMITIVE_GROUP[np.take_along_axis(words.code, index, -1)]
    rising, falling = (np.isin(group, pair) for pair in ((Group.P, Group.PIMP), (Group.N, Group.NIMP)))
    return ResampledSignal(
        rising.astype(np.int64) - falling,
        np.where(flat[..., None], level[..., :1], level),
        said(words.value["grad"]),
    )


def _centred(values: Values) -> Values:
    """Values minus their mean over the moments, exactly zero where they are all the same."""
    change = values - values[..., :1]
    return change - change.mean(-1, keepdims=True)


def _means(values: NDArray[Any], parts: int) -> Values:
    return np.stack([part.mean(-1) for part in np.array_split(values, parts, axis=-1)], -1)


def piecewise_stats(lines: ResampledSignal) -> Block:
    """The sentence in equal parts: level, slope, activity, range and signs of each."""
    values, columns = [], []
    for count in PARTS:
        level = _means(lines.relative, count)
        ranges = [np.ptp(part, axis=-1) for part in np.array_split(lines.level, count, axis=-1)]
        described = {
            "level": (compressed(level), "mean level minus the sentence's, signed log"),
            "share": (ratio(level, lines.range), "mean level minus the sentence's, as a share of its range"),
            "grad": (compressed(_means(lines.slope, count)), "mean slope, signed log"),
            "activity": (compressed(_means(np.abs(lines.slope), count)), "mean steepness, log"),
            "range": (compressed(np.stack(ranges, -1)), "highest minus lowest level, log"),
            "rising": (_means(lines.sign > 0, count), "share of time spent rising"),
            "falling": (_means(lines.sign < 0, count), "share of time spent falling"),
        }
        for what, (value, meaning) in described.items():
            values.append(value)
            columns += [(f"{what}.{k}of{count}", f"{meaning}, in part {k + 1} of {count}") for k in range(count)]
    return np.concatenate(values, -1), columns


def quantiles(lines: ResampledSignal) -> Block:
    """How levels and slopes are distributed over the time of the sentence."""
    steps = np.linspace(0, 1, QUANTILES)
    level, slope = (np.moveaxis(np.quantile(x, steps, axis=-1), 0, -1) for x in (lines.relative, lines.slope))
    deviations = np.concatenate([x.std(-1, keepdims=True) for x in (lines.level, lines.slope)], -1)
    values = [compressed(level), ratio(level, lines.range), compressed(slope), compressed(deviations)]
    columns = [
        (f"{what}.{step:.0%}", f"{step:.0%} quantile of the {meaning}")
        for what, meaning in (
            ("level", "level minus the sentence's mean, signed log"),
            ("share", "level minus the sentence's mean, as a share of its range"),
            ("grad", "slope, signed log"),
        )
        for step in steps
    ]
    columns += [(f"deviation.{x}", f"standard deviation of the {x}, log") for x in ("level", "slope")]
    return np.concatenate(values, -1), columns


def cross_axis(lines: ResampledSignal) -> Block:
    """What two axes say at the same time; ``[sentence, pair, column]``."""
    signs = {"rising": lines.sign > 0, "falling": lines.sign < 0, "constant": lines.sign == 0}
    values = [(a[:, _FIRST] & b[:, _SECOND]).mean(-1) for a in signs.values() for b in signs.values()]
    columns = [
        (f"{a}.{b}", f"share of time in which the first is {a} while the second is {b}") for a in signs for b in signs
    ]
    # The root keeps a single snap from deciding the correlation of slopes.
    for name, x in (("level", lines.level), ("slope", np.sign(lines.slope) * np.sqrt(np.abs(lines.slope)))):
        values.append(_correlation(x))
        columns.append((f"correlation.{name}", f"correlation of their {name}s over the sentence"))
    return np.stack(values, -1), columns


def _correlation(x: Values) -> Values:
    """Correlation of every pair of axes ``[sentence, pair]``; 0 where one of them does not change."""
    centred = _centred(x)
    product = centred @ np.swapaxes(centred, 1, 2)
    size = np.sqrt(np.einsum("sii->si", product))
    return np.clip(ratio(product[:, _FIRST, _SECOND], size[:, _FIRST] * size[:, _SECOND]), -1, 1)


def timing(lines: ResampledSignal) -> Block:
    """When the highest, steepest, first and last things happen, as shares of the sentence."""
    highest, lowest = _when(lines.level), _when(-lines.level)
    steepest = [_when(lines.slope), _when(-lines.slope), _when(np.abs(lines.slope))]
    columns = [
        (name, f"when the sentence is {meaning}, as a share of it")
        for name, meaning in (
            ("highest", "highest"),
            ("lowest", "lowest"),
            ("rise", "rising most steeply"),
            ("fall", "falling most steeply"),
            ("steepest", "steepest"),
        )
    ]
    values = [highest, lowest, *steepest]
    for name, sign in (("rising", 1), ("falling", -1)):
        values += _times(lines.sign == sign)
        columns += [(f"{what}.{name}", f"{what} moment of {name}, as a share") for what in ("mean", "first", "last")]
    level, quarter = lines.relative, lines.range / 4
    above = [
        level > NEAR * quarter,
        lines.level > lines.level[..., :1] + NEAR * quarter,
        level > quarter,
        level < -quarter,
    ]
    values += [part.mean(-1) for part in above]
    columns += [
        ("above.mean", "share of time above the mean level"),
        ("above.first", "share of time above the first level"),
        ("high", "share of time a quarter of the range or more above the mean level"),
        ("low", "share of time a quarter of the range or more below the mean level"),
    ]
    return np.stack(values, -1), columns


def _when(values: Values) -> Values:
    """First moment at which ``[sentence, axis, moment]`` is (nearly) highest, as a share."""
    close = values >= values.max(-1, keepdims=True) - NEAR * np.ptp(values, axis=-1)[..., None]
    return close.argmax(-1) / MOMENTS


def _times(said: NDArray[np.bool_]) -> list[Values]:
    """Mean, first and last moment at which something is said, as shares; a half, one and zero if never."""
    moment = (np.arange(MOMENTS) + 0.5) / MOMENTS
    count = said.sum(-1)
    mean = np.where(count > 0, ratio((said * moment).sum(-1), count.astype(np.float64)), 0.5)
    return [mean, np.where(said, moment, 1).min(-1), np.where(said, moment, 0).max(-1)]


def levels(lines: ResampledSignal) -> Block:
    """Absolute level of each third, highest and lowest: they give away sensor bias, and what is held against what."""
    ends = [f(lines.level, axis=-1, keepdims=True) for f in (np.max, np.min)]
    named = [(f"mean.{k}of3", f"mean level in part {k + 1} of 3, signed log") for k in range(3)]
    columns = [*named, ("highest", "highest level, signed log"), ("lowest", "lowest level, signed log")]
    return compressed(np.concatenate([_means(lines.level, 3), *ends], -1)), columns


FAMILIES = {"parts": piecewise_stats, "spread": quantiles, "together": cross_axis, "order": timing, "levels": levels}
