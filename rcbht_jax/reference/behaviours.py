"""Low-level behaviours: ordered pairs of motion compositions (paper, section III-C)."""

from __future__ import annotations

from rcbht_jax.labels import LLB, MC
from rcbht_jax.reference import motion as mc
from rcbht_jax.reference.rows import Row, Table

LABEL, AVG1, AVG2, AVG, MX1, MX2, MX, AMP1, AMP2, AMP, M1, M2, T1S, T1E, T2S, T2E, TMID = range(17)

LONG = 0.10  # s; a composition at least this long ends the noise stage of an axis
NOISY, NONE = 9.0, 10.0  # second tags of rows made from one composition

_SAME = {MC.K: LLB.FX, MC.I: LLB.PS, MC.D: LLB.PL}
_CONTACTS = (MC.PC, MC.NC, MC.C)


def _pair(label: LLB, this: Row, partner: Row) -> Row:
    a, b = this[mc.AVG], partner[mc.AVG]
    x, y = this[mc.MX], partner[mc.MX]
    p, q = this[mc.AMP], partner[mc.AMP]
    values = [a, b, (a + b) / 2, x, y, max(x, y), p, q, max(p, q)]
    times = [this[mc.T1S], this[mc.T2E], partner[mc.T1S], partner[mc.T2E]]
    middle = (this[mc.TMID] + partner[mc.TMID]) / 2
    return [float(label), *values, this[mc.LABEL], partner[mc.LABEL], *times, middle]


def _single(label: LLB, this: Row, tag: float = NONE) -> Row:
    values = [this[mc.AVG]] * 3 + [this[mc.MX]] * 3 + [this[mc.AMP]] * 3
    times = this[mc.T1S : mc.T2E + 1]
    return [float(label), *values, this[mc.LABEL], tag, *times, (this[mc.T1S] + this[mc.T2E]) / 2]


def _second_adjustment(motions: Table, i: int) -> int | None:
    """Index of the adjustment that pairs with adjustment i: the next row, or the one after a short row i."""
    last = len(motions) - 1
    if i == last:
        return i
    short = motions[i][mc.T2E] - motions[i][mc.T1S] <= LONG
    for candidate in range(i + 1, min(i + 2 if short else i + 1, last) + 1):
        if motions[candidate][mc.LABEL] == MC.A:
            return candidate
    return None


def _behaviour(motions: Table, i: int, long: bool) -> tuple[Row, int]:
    """Row that starts at composition i, and the index of the last composition it uses."""
    this = motions[i]
    label = this[mc.LABEL]
    following = min(i + 1, len(motions) - 1)
    if label in _SAME:
        kind = _SAME[MC(int(label))]
        if motions[following][mc.LABEL] == label:
            return _pair(kind, this, motions[following]), following
        return _single(kind if long else LLB.N, this), i
    if label in _CONTACTS:
        second = motions[following][mc.LABEL]
        if second == MC.C or {label, second} == {MC.PC, MC.NC}:
            return _pair(LLB.CT, this, motions[following]), following
        return _single(LLB.CT, this), i
    if label == MC.A:
        partner = _second_adjustment(motions, i)
        if partner is None:
            return _single(LLB.AL if long else LLB.N, this), i
        kind = LLB.AL if motions[partner][mc.AMP] < this[mc.AMP] else LLB.SH
        return _pair(kind, this, motions[partner]), partner
    return _single(LLB.N, this, NOISY), i


def compose_behaviours(motions: Table) -> Table:
    """Low-level behaviours of filtered motion compositions: rows of seventeen columns.

    The last composition is paired with itself (Q12); once one composition other than a contact has lasted
    ``LONG``, short ones are no longer noise (Q20); an adjustment paired with the row after the next drops the row
    in between (Q21).
    """
    rows: Table = []
    long = False
    i = 0
    while i < len(motions):
        this = motions[i]
        if this[mc.LABEL] in (*_SAME, MC.A) and this[mc.T2E] - this[mc.T1S] >= LONG:
            long = True
        row, used = _behaviour(motions, i, long)
        rows.append(row)
        i = used + 1
    return rows
