"""Filter of low-level behaviours: passes 9.1 to 9.6, run five times (section 9).

A pass fixes its range before it begins; a merged row is not compared again in that pass.
"""

from __future__ import annotations

from collections.abc import Callable

from rcbht_jax.labels import LLB
from rcbht_jax.offline.behaviours import (
    AMP, AMP2, AVG, AVG2, LABEL, M1, M2, MX, MX1, MX2, NONE, T1E, T1S, T2E, T2S, TMID,
)  # fmt: skip
from rcbht_jax.offline.rows import Row, Table, compact, near, ratio, unusable, wipe

ROUNDS = 5
_LARGER = 5.0  # ratio of amplitudes that ends pass 9.1
_LONGER = 5.0  # ratio of durations beyond which pass 9.1 merges
_BLOCKING_TAGS = (8.0, NONE)
_TRUNCATED_TAG = 6.0
_FORCED = (LLB.PS, LLB.PL)
_ADJUSTING = (LLB.AL, LLB.SH)

Rule = Callable[[Row, Row], bool]


def absorb(rows: Table, i: int, label: LLB | None = None) -> None:
    """Merge the next row into row i, with a new label if given; the order of the steps matters."""
    row, gone = rows[i], rows[i + 1]
    if label is not None:
        row[LABEL] = float(label)
    row[AVG2] = gone[AVG2]
    row[AVG] = (row[AVG] + gone[AVG]) / 2
    row[MX1] = max(row[MX1], row[MX2])
    row[MX] = max(row[MX], gone[MX])
    row[AMP2] = gone[AMP2]
    row[AMP] = max(row[AMP], gone[AMP])
    row[M1] = row[M2] = row[LABEL]
    row[T1E] = row[T2E]
    row[T2S], row[T2E] = gone[T1S], gone[T2E]
    # The repairs put the times back in order when the absorbed row is the earlier one.
    if gone[T2E] == row[T1S]:
        row[T1S] = gone[T1S]
    if row[T1E] > row[T2E]:
        row[T2E] = row[T1E]
    if row[T2S] < row[T1S]:
        row[T1S] = row[T2S]
    if row[T2E] < gone[T1S]:
        row[T1S] = row[T2S]
    row[TMID] = (row[T1S] + row[T2E]) / 2
    wipe(gone)


def _durations(this: Row, following: Row) -> tuple[float, float]:
    first, second = this[T2E] - this[T1S], following[T2E] - following[T1S]
    if this[M2] == _TRUNCATED_TAG:
        first = this[T1E] - this[T1S]
    elif following[M2] == _TRUNCATED_TAG:
        second = following[T1E] - following[T1S]
    return first, second


def merge_short(rows: Table) -> Table:
    """9.1: the much longer of two neighbours absorbs the other; the first pair that does not ends the pass.

    The last pair is never compared (Q23). A pair with an amplitude of zero, on which the reference never
    returns (Q24), is passed over.
    """
    i = 0
    while i < len(rows) - 2:
        this, following = rows[i], rows[i + 1]
        blocked = any(row[LABEL] == LLB.CT or row[M2] in _BLOCKING_TAGS for row in (this, following))
        size = ratio(abs(following[AMP]), abs(this[AMP]))
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
        merged = merge_where(rows, lambda p, q: p[LABEL] == q[LABEL])
        if len(merged) == len(rows):
            return merged
        rows = merged


def push_and_pull(p: Row, q: Row, clean: bool = False) -> bool:
    """9.2: the reference compares the amplitude twice, which is always met (Q19); ``clean`` the average too."""
    column = AVG if clean else AMP
    return (
        {p[LABEL], q[LABEL]} == set(_FORCED)
        and near(p[AMP], q[AMP], 1.5, clean)
        and near(p[column], q[column], 1.0, clean)
    )


def decreasing(p: Row, q: Row) -> bool:
    """9.3: alignment or shift followed by a smaller one."""
    return p[LABEL] in _ADJUSTING and q[LABEL] in _ADJUSTING and q[AMP] < p[AMP]


def adjusted(p: Row, q: Row, clean: bool = False) -> bool:
    """9.5: alignment or shift followed by push or pull of like size; ``clean`` in either order (Q26)."""
    ordered = p[LABEL] in _ADJUSTING and q[LABEL] in _FORCED
    mirrored = clean and p[LABEL] in _FORCED and q[LABEL] in _ADJUSTING
    return (ordered or mirrored) and near(p[AMP], q[AMP], 0.5, clean) and near(p[AVG], q[AVG], 1.0, clean)


def fixed(p: Row, q: Row, clean: bool = False) -> bool:
    """9.6: fixed beside anything but contact and noise, of like size and average."""
    others = (*_FORCED, *_ADJUSTING)
    beside = (p[LABEL] == LLB.FX and q[LABEL] in others) or (q[LABEL] == LLB.FX and p[LABEL] in others)
    return beside and near(p[AMP], q[AMP], 0.75, clean) and near(p[AVG], q[AVG], 0.75, clean)


def filter_behaviours(raw: Table, clean: bool = False) -> Table:
    """Filtered copy of raw low-level behaviours; ``clean`` fixes Q15, Q19 and Q26."""
    rows = [row[:] for row in raw]
    for _ in range(ROUNDS):
        rows = merge_short(rows)
        rows = merge_where(rows, lambda p, q: push_and_pull(p, q, clean), LLB.AL)
        rows = merge_where(rows, decreasing, LLB.AL)
        rows = merge_repeats(rows)
        rows = merge_where(rows, lambda p, q: adjusted(p, q, clean), LLB.AL)
        rows = merge_where(rows, lambda p, q: fixed(p, q, clean), LLB.FX)
    return rows
