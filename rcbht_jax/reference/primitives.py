"""Filter of primitives: merge repeats, then neighbours of similar size and very different duration."""

from __future__ import annotations

from rcbht_jax.labels import Primitive
from rcbht_jax.reference.rows import Row, Table, compact, outside, ratio, run_length, unusable, wipe

AVG, MAX, MIN, START, END, SLOPE, LABEL = range(7)
_IMPULSES = (Primitive.PIMP, Primitive.NIMP)
SAME_SIZE = (0.5, 2.0)  # ratio of spans within which two primitives may merge
SAME_DURATION = (0.2, 5.0)  # ratio of durations beyond which the longer absorbs the shorter


def span(row: Row) -> float:
    """Largest minus smallest value."""
    return row[MAX] - row[MIN]


def duration(row: Row) -> float:
    """Seconds from start to end."""
    return row[END] - row[START]


def _merge_run(rows: Table, i: int, k: int, clean: bool) -> None:
    """Merge the k rows after row i into it; the original program divides sums of k+1 >= 3 rows by k (Q9)."""
    run = rows[i : i + k + 1]
    count = k if k >= 2 and not clean else k + 1
    for column in (AVG, SLOPE):
        rows[i][column] = sum(row[column] for row in run) / count
    rows[i][MAX] = max(row[MAX] for row in run)
    rows[i][MIN] = min(row[MIN] for row in run)
    rows[i][END] = run[-1][END]
    for row in run[1:]:
        wipe(row)


def merge_repeats(rows: Table, clean: bool = False) -> Table:
    """5.1: one row per run of equal labels; one scan is enough, because merged rows keep their label."""
    rows = compact(rows)
    i = 0
    while i < len(rows):
        k = run_length(rows, i, LABEL)
        if k > 0:
            _merge_run(rows, i, k, clean)
        i += k + 1
    return compact(rows)


def merge_short(rows: Table) -> Table:
    """5.2: neighbours of similar span and very different duration merge; a merged row is not compared again."""
    for i in range(len(rows) - 1):
        this, following = rows[i], rows[i + 1]
        if this[LABEL] in _IMPULSES:
            continue
        size = ratio(span(following), span(this))
        if unusable(size) or outside(size, *SAME_SIZE):
            continue
        time = ratio(duration(this), duration(following))
        if unusable(time) or not outside(time, *SAME_DURATION):
            continue
        if time < SAME_DURATION[0]:
            this[LABEL] = following[LABEL]
        _merge_run(rows, i, 1, clean=False)
    return compact(rows)


def filter_primitives(raw: Table, clean: bool = False) -> Table:
    """Filtered copy of raw primitives; ``clean`` averages long runs correctly (Q9)."""
    return merge_short(merge_repeats([row[:] for row in raw], clean))
