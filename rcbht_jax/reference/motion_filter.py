"""Filter of motion compositions: passes 7.0 to 7.7, run four times.

The range of a pass is fixed before it starts; a merged row is not compared again in that pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from rcbht_jax.labels import MC, Group
from rcbht_jax.reference.motion import AMP, AVG, LABEL, MX, P1, P2, T1E, T1S, T2E, T2S, TMID, group_of
from rcbht_jax.reference.rows import Row, Table, compact, near, outside, ratio, run_length, unusable, wipe
from rcbht_jax.reference.versions import Version

ROUNDS = 4
SAME_AMPLITUDE = (0.2, 5.0)
SAME_DURATION = (0.2, 5.0)
_CONTACTS = (MC.PC, MC.NC, MC.C)
_WEAK = 0.1  # contacts below this share of the largest amplitude are relabelled
_BY_GROUP = {Group.P: MC.I, Group.N: MC.D, Group.K: MC.K, Group.PIMP: MC.PC, Group.NIMP: MC.NC}


@dataclass(frozen=True)
class Boundaries:
    """The two times, in seconds, that the filter takes from the state vector."""

    start: float  # S_2: filtering starts with the first row that ends after it
    gate: float  # X: limit of adjustment runs in the gated versions, infinite in the others


def boundaries(states: list[float], version: Version) -> Boundaries:
    """Boundaries from a state vector of at least two times."""
    if not version.gated:
        return Boundaries(states[1], math.inf)
    return Boundaries(states[1], states[3] - 0.002 if len(states) >= 4 else states[-1])


def _close(row: Row, merged: Table) -> None:
    """Set the middle of a row that has its times, and delete what was merged into it."""
    row[TMID] = (row[T1S] + row[T2E]) / 2
    for other in merged:
        wipe(other)


def _absorb(run: Table, average: float) -> None:
    """Merge the rows after the first into it, which keeps its label, amplitude and tags."""
    row, last = run[0], run[-1]
    row[AVG], row[MX] = average, max(other[MX] for other in run)
    row[T2S], row[T2E] = last[T1S], last[T2E]
    row[T1E] = row[T2E]
    _close(row, run[1:])


def absorb_next(rows: Table, i: int, label: MC | None = None) -> None:
    """Merge the next row into row i; with a new label it has the larger amplitude."""
    row, merged = rows[i], rows[i + 1]
    if label is not None:
        row[LABEL], row[AMP] = float(label), max(row[AMP], merged[AMP])
    row[P2] = merged[P2]
    _absorb([row, merged], (row[AVG] + merged[AVG]) / 2)


def absorb_previous(rows: Table, i: int) -> None:
    """Merge the previous row into row i, whose label and amplitude stay."""
    row, merged = rows[i], rows[i - 1]
    row[AVG], row[MX] = (row[AVG] + merged[AVG]) / 2, max(row[MX], merged[MX])
    row[P1] = merged[P1]
    row[T2S] = row[T1S]
    row[T1S], row[T1E] = merged[T1S], merged[T2E]
    _close(row, [merged])


def start_row(rows: Table, bounds: Boundaries, version: Version) -> int:
    """7.0: index of the first row that ends after the second state began.

    Without such a row it is the last row, so that no pass from the start row on runs; one version uses the last
    time in seconds, rounded up here, as a row number (counted from one).
    """
    for i, row in enumerate(rows):
        if row[T2E] > bounds.start:
            return i
    if version.time_as_row:
        return max(math.ceil(rows[-1][T2E]) - 1, 0)
    return len(rows) - 1


def _merge_adjustments(rows: Table, first: int, last: int) -> None:
    run = rows[first : last + 1]
    row = run[0]
    row[LABEL] = float(MC.A)
    row[AVG] = sum(other[AVG] for other in run) / len(run)
    row[MX] = sum(other[MX] for other in run) / len(run)
    row[AMP] = max(other[AMP] for other in run)
    row[T1E] = (run[-1][T2E] + row[T1S]) / 2 - 0.002
    row[T2S] = row[T1E] + 0.001
    row[T2E] = run[-1][T2E]
    _close(row, run[1:])


def merge_adjustments(rows: Table, start: int, gate: float, clean: bool) -> Table:
    """7.1: runs of adjustments of similar average become one.

    The end of a run is tested one row too late, and count and flag survive the gaps between runs (Q17).
    """
    n = len(rows)
    count, armed = 0, False
    for i in range(start, n - 1):
        j = i + 1
        if rows[i][LABEL] != MC.A or rows[j][LABEL] != MC.A or not rows[j][T2E] < gate:
            continue
        if near(rows[i][AVG], rows[j][AVG], 0.5, clean):
            armed, count = True, count + 1
        if not armed or j + 2 >= n:
            continue
        beyond = rows[j + 1]
        if beyond[LABEL] != MC.A or not near(beyond[AVG], rows[j + 2][AVG], 0.5, clean):
            _merge_adjustments(rows, i - count + 1, i + 1)
            armed, count = False, 0
    return compact(rows)


def merge_repeats(rows: Table) -> Table:
    """7.2: one row per run of equal labels other than adjustments, in the whole table."""
    i = 0
    while i < len(rows):
        k = 0 if rows[i][LABEL] == MC.A else run_length(rows, i, LABEL)
        if k == 1:
            absorb_next(rows, i)
        elif k >= 2:
            run = rows[i : i + k + 1]
            _absorb(run, sum(row[AVG] for row in run) / (k + 1))
        i += k + 1
    return compact(rows)


def _compared(rows: Table, start: int, version: Version) -> Iterator[int]:
    """The rows, other than contacts, whose next row has a similar amplitude."""
    for i in range(start, len(rows) - 1):
        if rows[i][LABEL] in _CONTACTS:
            continue
        size = ratio(abs(rows[i + 1][AMP]), abs(rows[i][AMP]))
        if unusable(size):
            continue
        if not outside(size, *SAME_AMPLITUDE):
            yield i
        elif version.amplitude_ends_pass:
            return


def relabel_halves(rows: Table, start: int, version: Version) -> float:
    """7.3: a row whose halves last very unequally takes the label of its longer half.

    Returns:
        the largest amplitude of the compared rows, which excludes contacts and rows of one primitive (Q18).
    """
    largest = 0.0
    for i in _compared(rows, start, version):
        row = rows[i]
        first, second = row[T1E] - row[T1S], row[T2E] - row[T2S]
        if first == 0.0 or second == 0.0:
            continue
        if outside(first / second, *SAME_DURATION):
            tag = row[P1] if first / second > SAME_DURATION[1] else row[P2]
            row[LABEL] = float(_BY_GROUP[Group(group_of(tag))])
        largest = max(largest, row[AMP])
    return largest


def merge_short(rows: Table, start: int, version: Version) -> Table:
    """7.4: neighbours of similar amplitude and very different duration merge."""
    for i in _compared(rows, start, version):
        first, second = (row[T2E] - row[T1S] for row in rows[i : i + 2])
        if first == 0.0 or second == 0.0:
            continue
        if first / second > SAME_DURATION[1]:
            absorb_next(rows, i)
        elif first / second < SAME_DURATION[0]:
            absorb_previous(rows, i + 1)
    return compact(rows)


def demote_contacts(rows: Table, largest: float) -> None:
    """7.5: contacts much weaker than the largest amplitude become increases or decreases."""
    for row in rows:
        if abs(row[AMP]) < _WEAK * largest:
            if row[LABEL] == MC.PC:
                row[LABEL] = float(MC.I)
            elif row[LABEL] == MC.NC:
                row[LABEL] = float(MC.D)


def _alike(this: Row, following: Row, amplitude: float, average: float, clean: bool) -> bool:
    return near(this[AMP], following[AMP], amplitude, clean) and near(this[AVG], following[AVG], average, clean)


def merge_into_adjustments(rows: Table, start: int, clean: bool) -> Table:
    """7.6: an adjustment and a neighbouring increase or decrease of similar size become an adjustment."""
    for i in range(start, len(rows) - 1):
        labels = {rows[i][LABEL], rows[i + 1][LABEL]}
        if labels in ({MC.A, MC.I}, {MC.A, MC.D}) and _alike(rows[i], rows[i + 1], 0.5, 0.5, clean):
            absorb_next(rows, i, MC.A)
    return compact(rows)


def merge_into_constants(rows: Table, start: int, clean: bool) -> Table:
    """7.7: different neighbours among increase, decrease and constant become a constant.

    The amplitude tolerance of 1.5 is always met (Q19); ``clean`` uses that of pass 7.6.
    """
    amplitude = 0.5 if clean else 1.5
    for i in range(start, len(rows) - 1):
        labels = {rows[i][LABEL], rows[i + 1][LABEL]}
        changing = len(labels) == 2 and labels < {MC.I, MC.D, MC.K}
        if changing and _alike(rows[i], rows[i + 1], amplitude, 1.0, clean):
            absorb_next(rows, i, MC.K)
    return compact(rows)


def filter_motions(raw: Table, bounds: Boundaries, version: Version, clean: bool = False) -> Table:
    """Filtered copy of raw motion compositions; ``clean`` corrects Q15 and Q19."""
    rows = [row[:] for row in raw]
    for _ in range(ROUNDS):
        start = start_row(rows, bounds, version)
        rows = merge_adjustments(rows, start, bounds.gate, clean)
        rows = merge_repeats(rows)
        largest = relabel_halves(rows, start, version)
        rows = merge_short(rows, start, version)
        demote_contacts(rows, largest)
        rows = merge_into_adjustments(rows, start, clean)
        rows = merge_into_constants(rows, start, clean)
    return rows
