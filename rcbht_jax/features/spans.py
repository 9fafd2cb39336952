"""Labels of one layer clipped to time intervals, and the sums that features are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Num, Shaped

from rcbht_jax._util.signals import RATE_TOLERANCE
from rcbht_jax.errors import InputError
from rcbht_jax.labels import LAYER_SIZES, LAYERS
from rcbht_jax.types import Array, LabelTrack, LabelTracks


@dataclass(frozen=True)
class Intervals:
    """Time intervals of recordings; the labels of one interval give one row of features.

    >>> intervals = Intervals(np.array([0, 0]), start=np.array([0, 200]), end=np.array([200, 500]), dt=0.005)
    >>> len(intervals), intervals.take(slice(1, 2)).start.tolist()
    (2, [200])
    """

    recording: Int[np.ndarray, " interval"]  # row of the label tracks
    start: Int[np.ndarray, " interval"]  # first sample
    end: Int[np.ndarray, " interval"]  # one past the last sample
    dt: float  # seconds between samples
    arm: str = ""  # of the recordings; "" = has no name

    def __len__(self) -> int:
        return int(self.start.shape[0])

    def take(self, rows: slice | Int[np.ndarray, " chosen"] | Bool[np.ndarray, " interval"]) -> Intervals:
        """The chosen intervals, in the order given."""
        return Intervals(self.recording[rows], self.start[rows], self.end[rows], self.dt, self.arm)


@dataclass(frozen=True)
class ClippedSpans:
    """Labels of one layer clipped to intervals; used slots first, in time order; code 0 = empty."""

    code: Int[np.ndarray, "interval axis word"]
    start: Int[np.ndarray, "interval axis word"]  # samples from the start of the interval
    end: Int[np.ndarray, "interval axis word"]
    # Attributes, N or Nm (per second); middle, and whole length of the label before the cut, samples.
    value: dict[str, Float[np.ndarray, "interval axis word"]]
    length: Int[np.ndarray, " interval"]  # samples
    size: int  # labels in the alphabet
    layer: str

    @property
    def duration(self) -> Int[np.ndarray, "interval axis word"]:
        """Samples; 0 in empty slots."""
        return self.end - self.start


def check_rate(tracks: LabelTracks, dt: float, where: str) -> None:
    """Raise an error for labels that state another rate than that of ``where``, with ``dt`` s between samples.

    Raises:
        InputError: the rates differ by more than ``RATE_TOLERANCE``.

    Example:
        >>> import rcbht_jax as rj
        >>> check_rate(rj.encode(np.zeros((400, 6)), rate=200), 0.004, "trials.zarr has")
        Traceback (most recent call last):
        rcbht_jax.errors.InputError: The labels are of 200 Hz, trials.zarr has 250 Hz; encode with rate=250.
    """
    if tracks.info is not None and abs(tracks.info.rate * dt - 1) > RATE_TOLERANCE:
        raise InputError(
            f"The labels are of {tracks.info.rate:g} Hz, {where} {1 / dt:g} Hz; encode with rate={1 / dt:g}."
        )


def clip(track: LabelTrack, intervals: Intervals, layer: str, most: int) -> list[ClippedSpans]:
    """Clip the labels of ``track`` (``[recording, axis, slot]``) to intervals, ``most`` of them at a time.

    A label that crosses a boundary keeps its attributes and loses duration.
    """
    first, stop = _overlapping(track, intervals)
    parts = [slice(i, i + most) for i in range(0, max(len(intervals), 1), most)]
    return [_clip(track, intervals.take(part), first[part], stop[part], layer) for part in parts]


def _overlapping(
    track: LabelTrack, intervals: Intervals
) -> tuple[Int[np.ndarray, "interval axis"], Int[np.ndarray, "interval axis"]]:
    """First slot, and one past the last slot, between which all labels lie that overlap an interval."""
    label, t0, t1 = (np.asarray(x) for x in (track.label, track.t0, track.t1))
    first, stop = (np.zeros((len(intervals), label.shape[1]), np.int64) for _ in range(2))
    rows, counts = np.unique(intervals.recording, return_counts=True)
    of_rows = np.split(np.argsort(intervals.recording, kind="stable"), counts.cumsum()[:-1])
    for row, mine in zip(rows.tolist(), of_rows, strict=False):  # without intervals there is one part and no row
        used = label[row] > 0
        # Bounds of all slots before and after, so that empty slots and labels out of order do no harm.
        ended = np.maximum.accumulate(np.where(used, t1[row], -1), axis=1)
        begins = np.where(used, t0[row], np.iinfo(t0.dtype).max)[:, ::-1]
        begins = np.minimum.accumulate(begins, axis=1)[:, ::-1]
        for axis in range(label.shape[1]):
            first[mine, axis] = np.searchsorted(ended[axis], intervals.start[mine], side="right")
            stop[mine, axis] = np.searchsorted(begins[axis], intervals.end[mine], side="left")
    return first, stop


def _clip(
    track: LabelTrack,
    intervals: Intervals,
    lowest: Int[np.ndarray, "interval axis"],
    stop: Int[np.ndarray, "interval axis"],
    layer: str,
) -> ClippedSpans:
    start, end = (x.astype(np.int64)[:, None, None] for x in (intervals.start, intervals.end))
    axes, slots = np.shape(track.label)[1:]
    slot = lowest[..., None] + np.arange(min(slots, max(1, int((stop - lowest).max(initial=0)))))
    place = (intervals.recording[:, None, None], np.arange(axes)[:, None], np.minimum(slot, slots - 1))
    t0, t1 = (np.asarray(x)[place] for x in (track.t0, track.t1))
    code = np.asarray(track.label)[place].astype(np.int64)
    first, last = np.maximum(t0, start) - start, np.minimum(t1, end) - start
    inside = (code > 0) & (last > first) & (slot < stop[..., None])
    # Used slots to the front; the sort is stable, so they stay in time order.
    width = max(1, int(inside.sum(-1).max(initial=0)))
    order = np.argsort(~inside, axis=-1, kind="stable")[..., :width]
    used = np.take_along_axis(inside, order, -1)

    def gather(x: Num[np.ndarray, "interval axis slot"]) -> Num[np.ndarray, "interval axis word"]:
        return np.where(used, np.take_along_axis(x, order, -1), 0)

    forces = {k: np.asarray(getattr(track, k))[place] for k in ("vmax", "vmin", "avg", "grad")}
    value = {k: gather(x.astype(np.float64)) for k, x in forces.items()}
    # A line belongs to the whole span, so its middle stays where it was before the cut.
    value["middle"] = gather((t0.astype(np.float64) + t1) / 2 - start)
    value["whole"] = gather((t1 - t0).astype(np.float64))
    size = LAYER_SIZES[LAYERS.index(layer)]
    return ClippedSpans(gather(code), gather(first), gather(last), value, (end - start)[:, 0, 0], size, layer)


def weighted_counts(
    code: Int[np.ndarray, "interval axis word"], weight: Shaped[np.ndarray, "interval axis word"], size: int
) -> Float[np.ndarray, "interval axis {size}"]:
    """Sum of the weights per code 1 ... ``size``.

    >>> weighted_counts(np.array([[[2, 1, 2, 0]]]), np.array([[[5, 1, 2, 9]]]), 3).tolist()
    [[[1.0, 7.0, 0.0]]]
    """
    lanes = code.shape[0] * code.shape[1]
    index = np.arange(lanes).reshape(code.shape[:2])[..., None] * (size + 1) + code
    sums = np.bincount(index.ravel(), weight.ravel(), minlength=lanes * (size + 1)).astype(np.float64)
    return sums.reshape(*code.shape[:2], size + 1)[..., 1:]


def ratio(a: Float[Array, "*_"], b: Float[Array, "*_"]) -> Float[Array, "*_"]:
    """a / b, and 0 where b is 0; NumPy or JAX."""
    xp = a.__array_namespace__()
    b = xp.broadcast_to(b, a.shape)  # first, so that XLA divides rather than multiplies by a reciprocal
    return xp.where(b != 0, a / xp.where(b != 0, b, 1), 0)


def share(sums: Float[np.ndarray, "*lanes label"]) -> Float[np.ndarray, "*lanes label"]:
    """Divide by the sum over the last axis; all zero where that is 0."""
    return ratio(sums, sums.sum(-1, keepdims=True))
