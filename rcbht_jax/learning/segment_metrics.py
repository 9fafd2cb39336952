"""Scores of a segmentation: labels of every sample compared with annotated intervals.

A segment is a maximal run of one label. F1 at an overlap and the edit score are those of Lea et al. 2016, "Segmental
spatiotemporal CNNs for fine-grained action segmentation"; covering is that of Arbelaez et al. 2011, over time, except
that only segments of the same label cover each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.learning.metrics import has_width, percentile_interval, wilson

RESAMPLES = 1000
FEWEST_GROUPS = 8  # of fewer, drawn groups vary too little: half of the intervals from two groups hold the truth
OVERLAPS = (0.1, 0.25, 0.5)
UNKNOWN = -1  # of a sample without annotation: it counts nowhere

Labels = NDArray[np.integer[Any]]  # [sample]


@dataclass(frozen=True)
class Segments:
    """Maximal runs of equal labels."""

    label: NDArray[np.integer[Any]]
    start: NDArray[np.integer[Any]]  # samples
    end: NDArray[np.integer[Any]]  # one past the last

    @classmethod
    def of(cls, labels: Labels) -> Segments:
        """The runs of ``labels``; those of unknown samples are left out."""
        first = np.flatnonzero(np.diff(labels, prepend=labels[:1] - 1))
        last = np.append(first[1:], len(labels))
        known = labels[first] != UNKNOWN
        return cls(labels[first][known], first[known], last[known])

    def __len__(self) -> int:
        return len(self.label)


@dataclass(frozen=True)
class SegmentationScore:
    """Scores of several recordings together; every one lies between 0 and 1 but the delay.

    Attributes:
        accuracy: share of the annotated samples.
        macro_f1: F1 of the samples of each class, averaged over the classes that are annotated.
        f1: of segments, per overlap of OVERLAPS.
        edit: one minus the edit distance of the sequences of labels, over the length of the longer one.
        covering: mean over annotated segments, weighted by length, of the best overlap with a predicted segment of the
            same label.
        delay: median over annotated segments that are found at all, s from their start to the first sample with their
            label.
        found: share of the annotated segments in which their label occurs.
    """

    accuracy: float
    macro_f1: float
    f1: tuple[float, ...]
    edit: float
    covering: float
    delay: float
    found: float

    def to_json(self) -> dict[str, float]:
        """Every score by its name, for example ``f1@25``."""
        overlaps = {f"f1@{overlap * 100:.0f}": value for overlap, value in zip(OVERLAPS, self.f1, strict=True)}
        rest = {name: getattr(self, name) for name in ("edit", "covering", "delay", "found")}
        return {"accuracy": self.accuracy, "macro_f1": self.macro_f1, **overlaps, **rest}


def segmentation_score(truth: Sequence[Labels], predicted: Sequence[Labels], dt: float) -> SegmentationScore:
    """Score of predicted labels.

    Args:
        truth: class of each sample, one array per recording; UNKNOWN = not annotated.
        predicted: the same shapes.
        dt: seconds between samples.

    Raises:
        InputError: different shapes, or no annotated sample.

    Example:
        >>> truth = [np.array([0, 0, 0, 0, 1, 1, 1, 1])]
        >>> score = segmentation_score(truth, [np.array([0, 0, 0, 0, 0, 1, 1, 1])], dt=0.1)
        >>> score.accuracy, score.f1, score.edit, round(score.delay, 3)
        (0.875, (1.0, 1.0, 1.0), 1.0, 0.05)
    """
    sums = _Sums.of(truth, predicted)
    return sums.score(np.ones(len(truth), np.int64), dt)


def score_and_interval(
    truth: Sequence[Labels], predicted: Sequence[Labels], dt: float, groups: NDArray[Any], seed: int = 0
) -> tuple[SegmentationScore, dict[str, tuple[float, float]]]:
    """Score of predicted labels, and its 95 % interval: percentiles of scores of groups drawn with replacement.

    The percentiles are expanded ones. With fewer than eight groups, or without width, as without a mistake, the
    interval is Wilson's, with each group counting once. The delay, which is no share, then has none: both ends are NaN.

    Args:
        truth: class of each sample, one array per recording; UNKNOWN = not annotated.
        predicted: the same shapes.
        dt: seconds between samples.
        groups: of each recording ``[recording]``; or ``[recording, way]``, where several models labelled each recording
            (the group of the training recording and that of the labelled one): a row counts as often as the product of
            its groups' draws, as in Owen 2007, "The pigeonhole bootstrap"; but there the two ways are drawn separately,
            here once for both, which have the same groups.
        seed: of the draws.

    Raises:
        InputError: different shapes, or no annotated sample.

    Example:
        >>> truth = [np.repeat([0, 1], 10)] * 8
        >>> predicted = [np.repeat([0, 1], (first, 20 - first)) for first in (10, 10, 11, 11, 11, 12, 12, 14)]
        >>> _, interval = score_and_interval(truth, predicted, 0.1, np.arange(8))
        >>> [round(float(end), 3) for end in interval["accuracy"]]
        [0.869, 0.975]
    """
    sums = _Sums.of(truth, predicted)
    names, number = np.unique(groups, return_inverse=True)
    whole = sums.score(np.ones(len(truth), np.int64), dt)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), RESAMPLES)  # [draw, group]
    counts = drawn[:, number.reshape(np.shape(groups))].reshape(RESAMPLES, len(truth), -1).prod(-1)
    scores = [sums.score(count, dt).to_json() for count in counts if (count @ sums.samples) > 0]
    out = {}
    for name, value in whole.to_json().items():
        known = [score[name] for score in scores if not np.isnan(score[name])]
        enough = len(known) > 0 and len(names) >= FEWEST_GROUPS
        low, high = percentile_interval(known, len(names)) if enough else (np.nan, np.nan)
        if not has_width(low, high):
            low, high = (np.nan, np.nan) if name == "delay" else wilson(value * len(names), len(names))
        out[name] = (float(low), float(high))
    return whole, out


@dataclass(frozen=True)
class _Sums:
    """Sums over each recording, from which the scores of any of them together follow."""

    samples: NDArray[np.int64]  # [recording], annotated
    classes: NDArray[np.int64]  # [recording, class, 3]: samples of the class, predicted ones, both
    matches: NDArray[np.int64]  # [recording, overlap]: predicted segments that are right
    segments: NDArray[np.int64]  # [recording]: annotated and predicted ones together
    edit: NDArray[np.float64]  # [recording]; 0 without an annotated segment
    covered: NDArray[np.float64]  # [recording], samples
    delays: list[NDArray[np.float64]]  # [segment] of each recording, in samples; NaN = not found

    @classmethod
    def of(cls, truth: Sequence[Labels], predicted: Sequence[Labels]) -> _Sums:
        if [len(part) for part in truth] != [len(part) for part in predicted]:
            raise InputError("The predicted labels are of other recordings than the true ones: lengths differ.")
        # A predicted label where nothing is annotated is neither right nor wrong.
        masked = [np.where(true == UNKNOWN, UNKNOWN, guess) for true, guess in zip(truth, predicted, strict=True)]
        samples = np.array([(true != UNKNOWN).sum() for true in truth], np.int64)
        if not samples.sum():
            raise InputError("No sample is annotated; there is nothing to compare with.")
        every = np.setdiff1d(np.concatenate(truth), [UNKNOWN])
        same = [(true[:, None] == every, guess[:, None] == every) for true, guess in zip(truth, masked, strict=True)]
        pairs = [(Segments.of(true), Segments.of(guess)) for true, guess in zip(truth, masked, strict=True)]
        overlaps = [overlap_matrix(*pair) for pair in pairs]
        return cls(
            samples=samples,
            classes=np.array([np.stack([a.sum(0), b.sum(0), (a & b).sum(0)], 1) for a, b in same], np.int64),
            matches=np.array([[_matches(matrix, least) for least in OVERLAPS] for matrix in overlaps], np.int64),
            segments=np.array([len(true) + len(guess) for true, guess in pairs], np.int64),
            edit=np.array([
                1 - edit_distance(true.label, guess.label) / max(len(true), len(guess)) if len(true) else 0.0
                for true, guess in pairs
            ]),
            covered=np.array([
                float((matrix.max(1, initial=0) * (true.end - true.start)).sum())
                for matrix, (true, _) in zip(overlaps, pairs, strict=True)
            ]),
            delays=[_delays(true, guess) for (true, _), guess in zip(pairs, masked, strict=True)],
        )  # fmt: skip

    def score(self, count: NDArray[np.int64], dt: float) -> SegmentationScore:
        """Scores where each recording counts ``count`` times ``[recording]``."""
        samples = int(count @ self.samples)
        true, guess, both = np.tensordot(count, self.classes, 1).T
        known = true > 0
        segments = int(count @ self.segments)
        delays = np.repeat(np.concatenate(self.delays), np.repeat(count, [len(part) for part in self.delays]))
        hit = np.isfinite(delays)
        return SegmentationScore(
            accuracy=float(both.sum() / samples),
            macro_f1=float(np.mean(2 * both[known] / (true + guess)[known])),
            f1=tuple((2 * (count @ self.matches) / segments).tolist()),
            edit=float(count @ self.edit / (count @ (self.samples > 0))),
            covering=float(count @ self.covered / samples),
            delay=float(np.median(delays[hit]) * dt) if hit.any() else float("nan"),
            found=float(hit.mean()),
        )


def overlap_matrix(true: Segments, guess: Segments) -> NDArray[np.float64]:
    """Intersection over union ``[true segment, predicted segment]``; 0 where the labels differ."""
    low = np.maximum(true.start[:, None], guess.start)
    high = np.minimum(true.end[:, None], guess.end)
    union = np.maximum(true.end[:, None], guess.end) - np.minimum(true.start[:, None], guess.start)
    return np.where(true.label[:, None] == guess.label, np.maximum(high - low, 0) / union, 0.0)


def _matches(overlaps: NDArray[np.float64], least: float) -> int:
    """Predicted segments that are right: they overlap enough with a true one that none before them took."""
    right = 0
    taken = np.zeros(len(overlaps), bool)
    for column in overlaps.T if len(overlaps) else ():
        best = int(column.argmax())
        if column[best] >= least and not taken[best]:
            taken[best] = True
            right += 1
    return right


def edit_distance(first: NDArray[np.integer[Any]], second: NDArray[np.integer[Any]]) -> int:
    """Fewest insertions, deletions and replacements that turn one sequence into the other (Levenshtein).

    >>> edit_distance(np.array([1, 2, 3]), np.array([1, 3]))
    1
    """
    row = np.arange(len(second) + 1)
    for number, item in enumerate(first, 1):
        changed = np.minimum(row[1:] + 1, row[:-1] + (second != item))
        # An insertion costs one per place, so that the running minimum is taken of the cost less the place.
        start = np.concatenate([[number], changed]) - np.arange(len(second) + 1)
        row = np.minimum.accumulate(start) + np.arange(len(second) + 1)
    return int(row[-1])


def _delays(true: Segments, labels: Labels) -> NDArray[np.float64]:
    """Samples from the start of each true segment to the first with its label; NaN where there is none."""
    hits = [np.flatnonzero(labels[a:b] == c) for c, a, b in zip(true.label, true.start, true.end, strict=True)]
    return np.array([float(hit[0]) if len(hit) else np.nan for hit in hits])
