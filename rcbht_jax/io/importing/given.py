"""Annotations that are given for a whole file: on which clock they are, and of which of its recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rcbht_jax._util.printable import plural
from rcbht_jax.io.importing.clock import DAY
from rcbht_jax.io.importing.table import Interval

_NEAR = 1e-6  # s, by which a rounded time may lie before the first sample


def from_start(
    intervals: Sequence[Interval], origin: float, end: float, period: float
) -> tuple[list[Interval], list[str]]:
    """Annotations in s from the first sample, and a warning if they may be on another clock.

    All are on the recording's clock if one can only be so, since it begins beyond the length of the recording, and none
    can only be in s from the first sample, since it begins before the clock does.

    >>> log = {"origin": 3.2, "end": 20.0, "period": 0.01}
    >>> from_start([("phase", "push", 4.2, 9.0), ("phase", "hold", 21.0, 23.0)], **log)[0][0]
    ('phase', 'push', 1.0, 5.8)
    >>> from_start([("phase", "push", 1.0, 4.0), ("phase", "hold", 21.0, 23.0)], **log)[0][0]
    ('phase', 'push', 1.0, 4.0)

    Args:
        intervals: of one file, about one recording.
        origin: of the first sample on the recording's clock, s.
        end: of the recording, s from its first sample.
        period: between two samples, s.
    """
    starts, ends = (np.array([one[place] for one in intervals], np.float64) for place in (2, 3))
    if origin < DAY and ((starts >= 0) & (starts + DAY < origin + end)).any():
        doubt = "its times pass midnight, and annotations after it were read as seconds from its first sample"
        return list(intervals), [f"{doubt}; if that is wrong, write all times with their dates."]
    beyond, after = starts >= end, starts >= origin - _NEAR
    clocked = (after | (ends > origin)) & (starts < origin + end)
    if (~after & (starts < end)).any() or not clocked.any():
        return list(intervals), []
    if not (beyond & clocked).any():
        doubt = (
            f"annotations fit its clock, which begins at {origin:.6g} s, and were read as seconds from its first "
            'sample; if that is wrong, name their file in a map with clock = "stamps".'
        )
        return list(intervals), [doubt] if origin > 1.5 * period else []
    return [_moved(one, origin) for one in intervals], []


def _moved(interval: Interval, begin: float) -> Interval:
    """An interval in s from a moment; one that lasts beyond it begins there at the earliest."""
    track, label, start, end = interval
    lasts = start >= begin - _NEAR or end > begin
    return track, label, max(start - begin, 0.0) if lasts else start - begin, end - begin


def possible(intervals: Sequence[Interval], end: float) -> tuple[list[Interval], list[str]]:
    """The possible ones of the annotations of a recording that lasts until ``end``, and what was wrong with others.

    An interval that begins after the end, or whose start is missing, is left out; the others stay. An infinite end is
    that of the recording. One of which most lies after the end is named, too.

    >>> possible([("phase", "push", 1.0, np.inf), ("phase", "hold", 9.0, 9.5)], 4.0)[0]
    [('phase', 'push', 1.0, 4.0)]
    """
    kept, problems = [], []
    for track, label, start, stop in intervals:
        if not np.isfinite(start):
            problems.append(f"{track} {label!r} has no start; left out, the other annotations are kept.")
        elif not -1e-9 <= start < end:
            where = "before the beginning" if start < 0 else f"after the end ({end:.6g} s)"
            problems.append(f"{track} {label!r} at {start:.6g} s is {where}; left out, the other annotations are kept.")
        elif stop < start:
            problems.append(
                f"{track} {label!r} ends before it begins ({stop:.6g} < {start:.6g} s); its end is unknown."
            )
            kept.append((track, label, start, float("nan")))
        else:
            if end - start < stop - end < np.inf:  # most of it
                how = f"ends at {stop:.6g} s, after the end ({end:.6g} s). Is the unit of its times right?"
                problems.append(f"{track} {label!r} {how}")
            kept.append((track, label, start, end if stop == np.inf else stop))
    return kept, problems


class Given:
    """The annotations of a file, each for the recording in which it begins.

    >>> given = Given([("phase", "push", 1.5, 1.8), ("phase", "hold", 9.0, 9.5)], (100.0, 4.0, 0.01))
    >>> given.of(101.0, 1.0, 0.01), given.lost
    (([('phase', 'push', 0.5, 0.8)], []), '1 annotation of the file is of none of its recordings, and left out.')
    """

    def __init__(
        self, intervals: Sequence[Interval], whole: tuple[float, float, float] | None = None, shared: bool = False
    ) -> None:
        """Take the annotations of a file, and of one with several recordings on one clock origin, end and period.

        Where these have no clock in common, ``shared``, the annotations are of none.
        """
        self._whole, self._shared, self._intervals, self._doubts = whole, shared, list(intervals), list[str]()
        if whole and intervals:
            self._intervals, self._doubts = from_start(intervals, *whole)
        self._left = set(range(len(intervals))) if whole or shared else set[int]()

    def of(self, origin: float, end: float, period: float) -> tuple[list[Interval], list[str]]:
        """The annotations of a recording in s from its first sample, and warnings; arguments as :func:`from_start`."""
        if self._shared or not self._intervals:
            return [], []
        if not self._whole:
            return from_start(self._intervals, origin, end, period)
        begin = origin - self._whole[0]
        own = [place for place, one in enumerate(self._intervals) if begin - _NEAR <= one[2] < begin + end]
        self._left -= set(own)
        doubts, self._doubts = self._doubts, []
        moved = [_moved(self._intervals[place], begin) for place in own]
        return [(track, label, round(start, 9), round(stop, 9)) for track, label, start, stop in moved], doubts

    @property
    def lost(self) -> str:
        """What is to be said of the annotations that no recording got; "" = there are none."""
        if not self._left:
            return ""
        are = plural(len(self._left), "annotation of the file is", "annotations of the file are")
        why = ", since its time starts anew in each" if self._shared else ""
        return f"{are} of none of its recordings{why}, and left out."
