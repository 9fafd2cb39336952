"""Scores of a segmentation: labels of every sample compared with annotated intervals.

A segment is a maximal run of one label. F1 at an overlap and the edit score are those of Lea et al. 2016, "Segmental
spatiotemporal CNNs for fine-grained action segmentation"; covering is that of Arbelaez et al. 2011, over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError

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
        covering: mean over annotated segments, weighted by length, of the best overlap with a predicted segment.
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
    if [len(part) for part in truth] != [len(part) for part in predicted]:
        raise InputError("The predicted labels are of other recordings than the true ones: lengths differ.")
    # A predicted label where nothing is annotated is neither right nor wrong.
    masked = [np.where(true == UNKNOWN, UNKNOWN, guess) for true, guess in zip(truth, predicted, strict=True)]
    y, p = np.concatenate(truth), np.concatenate(masked)
    y, p = y[y != UNKNOWN], p[y != UNKNOWN]
    if not len(y):
        raise InputError("No sample is annotated; there is nothing to compare with.")
    pairs = [(Segments.of(true), Segments.of(guess)) for true, guess in zip(truth, masked, strict=True)]
    overlaps = [overlap_matrix(*pair) for pair in pairs]
    best = np.concatenate([matrix.max(1, initial=0) for matrix in overlaps])
    length = np.concatenate([true.end - true.start for true, _ in pairs])
    delays = np.concatenate([_delays(true, part) for (true, _), part in zip(pairs, masked, strict=True)])
    hit = np.isfinite(delays)
    return SegmentationScore(
        accuracy=float((y == p).mean()),
        macro_f1=float(np.mean([2 * ((y == c) & (p == c)).sum() / ((y == c).sum() + (p == c).sum()) for c in set(y)])),
        f1=tuple(_f1(pairs, overlaps, least) for least in OVERLAPS),
        edit=float(np.mean([_edit_score(true.label, guess.label) for true, guess in pairs if len(true)])),
        covering=float((best * length).sum() / length.sum()),
        delay=float(np.median(delays[hit]) * dt) if hit.any() else float("nan"),
        found=float(hit.mean()),
    )


def overlap_matrix(true: Segments, guess: Segments) -> NDArray[np.float64]:
    """Intersection over union ``[true segment, predicted segment]``; 0 where the labels differ."""
    low = np.maximum(true.start[:, None], guess.start)
    high = np.minimum(true.end[:, None], guess.end)
    union = np.maximum(true.end[:, None], guess.end) - np.minimum(true.start[:, None], guess.start)
    return np.where(true.label[:, None] == guess.label, np.maximum(high - low, 0) / union, 0.0)


def _f1(pairs: Sequence[tuple[Segments, Segments]], overlaps: Sequence[NDArray[np.float64]], least: float) -> float:
    """F1 of segments: a predicted one is right if it overlaps enough with a true one that none before it took."""
    right = 0
    for matrix in overlaps:
        taken = np.zeros(len(matrix), bool)
        for column in matrix.T if len(matrix) else ():
            best = int(column.argmax())
            if column[best] >= least and not taken[best]:
                taken[best] = True
                right += 1
    total = sum(len(true) + len(guess) for true, guess in pairs)
    return 2 * right / total if total else 0.0


def _edit_score(true: NDArray[np.integer[Any]], guess: NDArray[np.integer[Any]]) -> float:
    return 1 - edit_distance(true, guess) / max(len(true), len(guess))


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
