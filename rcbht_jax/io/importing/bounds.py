"""Annotations that are possible for their recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rcbht_jax.io.importing.record import Record


def bounded(record: Record) -> tuple[Record, list[str]]:
    """The recording without its impossible intervals, and what was wrong with them.

    An interval that begins after the end, or whose start is missing, is left out; the others stay. An infinite end is
    that of the recording. One of which most lies after the end is named, too.
    """
    last = record.end
    kept, problems = [], []
    for track, label, start, end in record.intervals:
        if not np.isfinite(start):
            problems.append(f"{track} {label!r} has no start; left out, the other annotations are kept.")
        elif not -1e-9 <= start < last:
            where = "before the beginning" if start < 0 else f"after the end ({last:.6g} s)"
            problems.append(f"{track} {label!r} at {start:.6g} s is {where}; left out, the other annotations are kept.")
        elif end < start:
            problems.append(f"{track} {label!r} ends before it begins ({end:.6g} < {start:.6g} s); its end is unknown.")
            kept.append((track, label, start, float("nan")))
        else:
            if last - start < end - last < np.inf:  # most of it
                how = f"ends at {end:.6g} s, after the end ({last:.6g} s). Is the unit of its times right?"
                problems.append(f"{track} {label!r} {how}")
            kept.append((track, label, start, last if end == np.inf else end))
    return replace(record, intervals=kept), problems
