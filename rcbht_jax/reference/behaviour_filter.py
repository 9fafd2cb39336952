"""Filter of low-level behaviours: passes 9.1 to 9.6, run five times.

The range of a pass is fixed before it starts; a merged row is not compared again in that pass.
"""

from __future__ import annotations

from collections.abc import Callable

from rcbht_jax.labels import LLB
from rcbht_jax.reference import behaviours as llb
from rcbht_jax.reference.rows import Row, Table, compact, near, ratio, unusable, wipe

ROUNDS = 5
_LARGER = 5.0  # ratio of amplitudes that ends pass 9.1
_LONGER = 5.0  # ratio of durations beyond which pass 9.1 merges
_BLOCKING_TAGS = (8.0, llb.NONE)
_TRUNCATED_TAG = 6.0
_FORCED = (LLB.PS, LLB.PL)
_ADJUSTING = (LLB.AL, LLB.SH)

Rule = Callable[[Row, Row], bool]


def absorb(rows: Table, i: int, label: LLB | None = None) -> None:
    """Merge the next row into row i, with a new label if given; the order of the steps matters."""
    row, merged = rows[i], rows[i + 1]
    if label is not None:
        row[llb.LABEL] = float(label)
    row[llb.AVG2] = merged[llb.AVG2]
    row[llb.AVG] = (row[llb.AVG] + merged[llb.AVG]) / 2
    row[llb.MX1] = max(row[llb.MX1], row[llb.MX2])
    row[llb.MX] = max(row[llb.MX], merged[llb.MX])
    row[llb.AMP2] = merged[llb.AMP2]
    row[llb.AMP] = max(row[llb.AMP], merged[llb.AMP])
    row[llb.M1] = row[llb.M2] = row[llb.LABEL]
    row[llb.T1E] = row[llb.T2E]
    row[llb.T2S], row[llb.T2E] = merged[llb.T1S], merged[llb.T2E]
    # The repairs put the times back in order when the absorbed row is the earlier one.
    if merged[llb.T2E] == row[llb.T1S]:
        row[llb.T1S] = merged[llb.T1S]
    if row[llb.T1E] > row[llb.T2E]:
        row[llb.T2E] = row[llb.T1E]
    if row[llb.T2S] < row[llb.T1S]:
        row[llb.T1S] = row[llb.T2S]
    if row[llb.T2E] < merged[llb.T1S]:
        row[llb.T1S] = row[llb.T2S]
    row[llb.TMID] = (row[llb.T1S] + row[llb.T2E]) / 2
    wipe(merged)


def _durations(this: Row, following: Row) -> tuple[float, float]:
    first, second = this[llb.T2E] - this[llb.T1S], following[llb.T2E] - following[llb.T1S]
    if this[llb.M2] == _TRUNCATED_TAG:
        first = this[llb.T1E] - this[llb.T1S]
    elif following[llb.M2] == _TRUNCATED_TAG:
        second = following[llb.T1E] - following[llb.T1S]
    return first, second


def merge_short(rows: Table) -> Table:
    """9.1: the much longer of two neighbours absorbs the other; the first pair that does not ends the pass.

    The last pair is never compared (Q23). A pair with an amplitude of zero, on which the original
    program never returns (Q24), is skipped.
    """
    i = 0
    while i < len(rows) - 2:
        this, following = rows[i], rows[i + 1]
        blocked = any(row[llb.LABEL] == LLB.CT or row[llb.M2] in _BLOCKING_TAGS for row in (this, following))
        size = ratio(abs(following[llb.AMP]), abs(this[llb.AMP]))
        if blocked or unusable(size):
            i += 1
            continue
        time = ratio(*_durations(this, following))
        if size > _LARGER or not (time > _LONGER or time < 1 / _LONGER):
            break
        if time < 1 / _LONGER:
            rows[i], rows[i + 1] = following, this
        absorb(rows, i)
        i += 3
    return compact(rows)


def merge_where(rows: Table, rule: Rule, label: LLB | None = None) -> Table:
    """One pass over neighbours: absorb the second into the first wherever the rule holds."""
    for i in range(len(rows) - 1):
        if rule(rows[i], rows[i + 1]):
            absorb(rows, i, label)
    return compact(rows)


def merge_repeats(rows: Table) -> Table:
    """9.4: until no equal labels are neighbours."""
    while True:
        merged = merge_where(rows, lambda p, q: p[llb.LABEL] == q[llb.LABEL])
        if len(merged) == len(rows):
            return merged
        rows = merged


def _alike(p: Row, q: Row, amplitude: float, average: float, clean: bool) -> bool:
    return near(p[llb.AMP], q[llb.AMP], amplitude, clean) and near(p[llb.AVG], q[llb.AVG], average, clean)


def push_and_pull(p: Row, q: Row, clean: bool = False) -> bool:
    """9.2: push next to pull. The original program compares the amplitude twice, within a tolerance always met (Q19).

    ``clean`` compares amplitudes and averages, within the tolerances of pass 7.6.
    """
    if {p[llb.LABEL], q[llb.LABEL]} != set(_FORCED):
        return False
    return not clean or _alike(p, q, 0.5, 0.5, clean)


def decreasing(p: Row, q: Row) -> bool:
    """9.3: alignment or shift followed by a smaller one."""
    return p[llb.LABEL] in _ADJUSTING and q[llb.LABEL] in _ADJUSTING and q[llb.AMP] < p[llb.AMP]


def adjusted(p: Row, q: Row, clean: bool = False) -> bool:
    """9.5: alignment or shift followed by push or pull of similar size; ``clean`` in either order (Q26)."""
    ordered = p[llb.LABEL] in _ADJUSTING and q[llb.LABEL] in _FORCED
    mirrored = clean and p[llb.LABEL] in _FORCED and q[llb.LABEL] in _ADJUSTING
    return (ordered or mirrored) and _alike(p, q, 0.5, 1.0, clean)


def fixed(p: Row, q: Row, clean: bool = False) -> bool:
    """9.6: fixed next to anything but contact and noise, of similar size and average."""
    labels = {p[llb.LABEL], q[llb.LABEL]}
    others = {LLB.FX, *_FORCED, *_ADJUSTING}
    return len(labels) == 2 and LLB.FX in labels and labels <= others and _alike(p, q, 0.75, 0.75, clean)


def filter_behaviours(raw: Table, clean: bool = False) -> Table:
    """Filtered copy of raw low-level behaviours; ``clean`` corrects Q15, Q19 and Q26."""
    rows = [row[:] for row in raw]
    for _ in range(ROUNDS):
        rows = merge_short(rows)
        rows = merge_where(rows, lambda p, q: push_and_pull(p, q, clean), LLB.AL)
        rows = merge_where(rows, decreasing, LLB.AL)
        rows = merge_repeats(rows)
        rows = merge_where(rows, lambda p, q: adjusted(p, q, clean), LLB.AL)
        rows = merge_where(rows, lambda p, q: fixed(p, q, clean), LLB.FX)
    return rows
