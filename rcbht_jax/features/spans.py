"""Words: the spans of one layer clipped to their sentences, and the sums that every feature is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.labels import LAYER_SIZES, LAYERS
from rcbht_jax.types import LabelTrack


@dataclass(frozen=True)
class Intervals:
    """Where the sentences are."""

    recording: NDArray[np.integer[Any]]  # [sentence] row of the label tracks
    start: NDArray[np.integer[Any]]  # [sentence] first sample
    end: NDArray[np.integer[Any]]  # [sentence] one past the last sample
    dt: float  # seconds between samples

    def __len__(self) -> int:
        return int(self.start.shape[0])

    def take(self, rows: slice | NDArray[np.integer[Any]]) -> Intervals:
        """The chosen sentences, in the order given."""
        return Intervals(self.recording[rows], self.start[rows], self.end[rows], self.dt)


@dataclass(frozen=True)
class ClippedSpans:
    """Spans of one layer clipped to their sentences; used slots first, in time order; code 0 = empty."""

    code: NDArray[np.int64]  # [sentence, axis, word]
    start: NDArray[np.int64]  # [sentence, axis, word] samples from the start of the sentence
    end: NDArray[np.int64]  # [sentence, axis, word]
    value: dict[str, NDArray[np.float64]]  # [sentence, axis, word] attributes, N or Nm (per second); middle, samples
    length: NDArray[np.int64]  # [sentence] samples in the sentence
    size: int  # labels in the alphabet
    layer: str

    @property
    def duration(self) -> NDArray[np.int64]:
        """[sentence, axis, word] samples; 0 in empty slots."""
        return self.end - self.start


def clip(track: LabelTrack, intervals: Intervals, layer: str) -> ClippedSpans:
    """Cut the spans of ``track`` (``[recording, axis, slot]``) to the sentences."""
    rows = intervals.recording
    start, end = (x.astype(np.int64)[:, None, None] for x in (intervals.start, intervals.end))
    code = np.asarray(track.label)[rows].astype(np.int64)
    first = np.maximum(np.asarray(track.t0)[rows], start) - start
    last = np.minimum(np.asarray(track.t1)[rows], end) - start
    kept = (code > 0) & (last > first)
    # Used slots to the front; the sort is stable, so they stay in time order.
    width = max(1, int(kept.sum(-1).max(initial=0)))
    order = np.argsort(~kept, axis=-1, kind="stable")[..., :width]
    used = np.take_along_axis(kept, order, -1)

    def gather(x: NDArray[Any]) -> NDArray[Any]:
        return np.where(used, np.take_along_axis(x, order, -1), 0)

    value = {k: gather(np.asarray(getattr(track, k), np.float64)[rows]) for k in ("vmax", "vmin", "avg", "grad")}
    # A line belongs to the whole span, so its middle stays where it was before the cut.
    value["middle"] = gather((np.asarray(track.t0)[rows].astype(np.float64) + np.asarray(track.t1)[rows]) / 2 - start)
    size = LAYER_SIZES[LAYERS.index(layer)]
    return ClippedSpans(gather(code), gather(first), gather(last), value, (end - start)[:, 0, 0], size, layer)


def weighted_counts(code: NDArray[np.int64], weight: NDArray[Any], size: int) -> NDArray[np.float64]:
    """Weights summed per code 1..size: ``[sentence, axis, word]`` -> ``[sentence, axis, size]``."""
    lanes = code.shape[0] * code.shape[1]
    index = np.arange(lanes).reshape(code.shape[:2])[..., None] * (size + 1) + code
    sums = np.bincount(index.ravel(), weight.ravel(), minlength=lanes * (size + 1)).astype(np.float64)
    return sums.reshape(*code.shape[:2], size + 1)[..., 1:]


def ratio(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """a / b, and 0 where b is 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b != 0)


def share(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divide by the sum over the last axis; all zero where that is 0."""
    return ratio(sums, sums.sum(-1, keepdims=True))
