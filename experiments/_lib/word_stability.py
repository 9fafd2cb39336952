"""Stability of words: do they stay when the same signal is recorded with other noise, or at another rate?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from experiments._lib.arrays import Floats, Ints
from experiments._lib.intervals import of_sums
from experiments._lib.piecewise import Sums, bottom_up, left_over
from rcbht_jax.labels import Primitive
from rcbht_jax.learning.segment_metrics import edit_distance
from rcbht_jax.types import LabelTrack, Recordings, padded

LONG = 0.1  # s: shorter words are not counted


@dataclass(frozen=True)
class Words:
    """Words of one axis in order."""

    label: Ints
    start: Floats  # s
    end: Floats  # s


def words_of(track: LabelTrack, dt: float) -> list[Words]:
    """The words of every recording and axis, those of a recording together."""
    found = []
    for row, axis in np.ndindex(track.label.shape[:2]):
        used = np.asarray(track.label[row, axis]) > 0
        label, t0, t1 = (np.asarray(values[row, axis])[used] for values in (track.label, track.t0, track.t1))
        found.append(Words(label.astype(np.int64), t0 * dt, t1 * dt))
    return found


def agreement(pairs: Iterable[tuple[Words, Words]], within: float, lanes: int = 1) -> dict[str, Any]:
    """How well the words of two copies agree, all pairs together.

    Args:
        pairs: words of the first and of the second copy.
        within: seconds that a break may move.
        lanes: pairs of one recording, which follow each other.

    Returns:
        ``edit``: edit distance of the labels over the longer sequence, mean over pairs, 0 = equal; ``kept``: share of
        the words longer than 0.1 s, of both copies, that the other one has with the same label and both breaks;
        ``breaks``: the share that the other one has with both breaks, whatever its label; ``words``: how many words
        were that long, without which both shares are None; ``time``: share of time in which both copies have one
        label. The three scores with an ``interval`` have it from recordings drawn with replacement, if there are
        several.
    """
    rows = np.array([_pair(*pair, within) for pair in pairs])
    edits, (kept, breaks, words), (same, both) = rows[:, 0], rows[:, 1:4].T, rows[:, 4:].T
    shares = {"edit": (edits, np.ones_like(edits)), "kept": (kept, words), "time": (same, both)}
    found = {name: _share(*sums, lanes, equal=not edits.any()) for name, sums in shares.items()}
    count = int(words.sum())
    return {
        **{name: value for name, (value, _) in found.items()},
        "breaks": float(breaks.sum()) / count if count else None,
        "words": count,
        **{f"{name} interval": interval for name, (_, interval) in found.items() if interval},
    }


def _pair(first: Words, second: Words, within: float) -> tuple[float, ...]:
    """Edit distance; long words with the same label and both breaks, with both breaks, all; seconds alike, and all."""
    longest = max(len(first.label), len(second.label))
    kept = breaks = count = 0
    for ours, other in ((first, second), (second, first)):
        long = ours.end - ours.start > LONG + 1e-9
        near = _near(ours.start, other.start, within) & _near(ours.end, other.end, within)
        kept += int((near & (ours.label[:, None] == other.label)).any(1)[long].sum())
        breaks += int(near.any(1)[long].sum())
        count += int(long.sum())
    edit = edit_distance(first.label, second.label) / longest if longest else 0.0
    return edit, kept, breaks, count, *_same_time(first, second)


def _share(part: Floats, whole: Floats, lanes: int, equal: bool) -> tuple[float | None, list[float] | None]:
    """A share over pairs, and its interval by recording; an equal copy cannot vary."""
    if not whole.any():
        return None, None
    of_recordings = [values.reshape(-1, lanes).sum(-1) for values in (part, whole)]
    drawn = of_sums(*of_recordings) if len(of_recordings[0]) > 1 and not equal else None
    return float(part.sum() / whole.sum()), [drawn["low"], drawn["high"]] if drawn else None


def _same_time(first: Words, second: Words) -> tuple[float, float]:
    """Seconds in which both have the same label, and in which both have any."""
    if not (len(first.label) and len(second.label)):
        return 0.0, 0.0
    edges = np.unique(np.concatenate([words.start for words in (first, second)] + [first.end, second.end]))
    middle, length = (edges[:-1] + edges[1:]) / 2, np.diff(edges)
    labels = [_label_at(words, middle) for words in (first, second)]
    both = (labels[0] > 0) & (labels[1] > 0)
    return float(length[both & (labels[0] == labels[1])].sum()), float(length[both].sum())


def _label_at(words: Words, time: Floats) -> Ints:
    """The label at each time, 0 between words."""
    place = np.maximum(np.searchsorted(words.start, time, "right") - 1, 0)
    inside = (words.start[place] <= time) & (time < words.end[place])
    return np.where(inside, words.label[place], 0)


def _near(first: Floats, second: Floats, within: float) -> NDArray[np.bool_]:
    return np.abs(first[:, None] - second) <= within + 1e-9


def noisy(recordings: Recordings, deviation: Floats, rng: np.random.Generator) -> Recordings:
    """A copy with white noise of a deviation for each axis."""
    noise = rng.normal(size=recordings.wrench.shape) * deviation
    return replace(recordings, wrench=(recordings.wrench + noise).astype(recordings.wrench.dtype))


def resampled(recordings: Recordings, rate: float) -> Recordings:
    """A copy at another rate, band-limited: windowed sinc filters as scipy has them."""
    ratio = Fraction(rate * recordings.dt).limit_denominator(1000)
    if ratio == 1:
        return recordings
    parts = [
        resample_poly(one[:samples].astype(np.float64), ratio.numerator, ratio.denominator, padtype="line")
        for one, samples in zip(recordings.wrench, recordings.length, strict=True)
    ]
    wrench, length = padded([part.astype(recordings.wrench.dtype) for part in parts])
    return replace(recordings, wrench=wrench, length=length, dt=1 / rate)


def best_lines(y: Floats, pieces: int, dt: float, limits: Floats, tolerance: float) -> Words:
    """Words of the bottom-up fit with so many pieces, named as the fit rule names its runs (impulses apart)."""
    edges = np.concatenate([[0], left_over(bottom_up(y), pieces), [len(y)]]).astype(np.int64)
    start, stop = edges[:-1], edges[1:]
    return named(Sums(y).line(start, stop)[1], start, stop, dt, limits, tolerance * tolerance)


def named(slope: Floats, start: Ints, stop: Ints, dt: float, limits: Floats, tolerated: float) -> Words:
    """Words of lines of one axis; a line whose values vary by less than ``tolerated`` (squared) is constant.

    ``limits`` are the four gradient limits, largest first.
    """
    n = stop - start
    rank = np.maximum((np.abs(slope / dt)[:, None] < limits).sum(1), 1)  # 1 big, 2 medium, 3 small, 4 constant
    label = np.where(slope > 0, Primitive.BPOS, Primitive.BNEG) + rank - 1
    level = (slope * slope * (n * n - 1.0) / 12 <= tolerated) | (rank == len(limits))
    return Words(np.where(level, Primitive.CONS, label).astype(np.int64), start * dt, stop * dt)
