"""Motion compositions: ordered pairs of primitives (paper, section III-B)."""

from __future__ import annotations

from rcbht_jax.labels import MC, PRIMITIVE_GROUP, Group
from rcbht_jax.reference import primitives as prim
from rcbht_jax.reference.rows import Row, Table, outside, ratio, unusable

LABEL, AVG, MX, AMP, P1, P2, T1S, T1E, T2S, T2E, TMID = range(11)

_A, _I, _D, _K, _PC, _NC, _C = (MC(code) for code in range(1, 8))
_IMPULSES = (Group.PIMP, Group.NIMP)

# Rows: group of the first primitive, columns: of the second; both in the order positive, negative,
# constant, positive impulse, negative impulse.
_CLASS = (
    (_I, _A, _I, _PC, _NC),
    (_A, _D, _D, _PC, _NC),
    (_I, _D, _K, _PC, _NC),
    (_PC, _C, _PC, _PC, _C),
    (_C, _NC, _NC, _C, _NC),
)
# Amplitude |M2 - m1| where 1, the extent of both primitives together elsewhere.
_SPAN = (
    (1, 0, 1, 1, 1),
    (1, 0, 0, 0, 0),
    (1, 0, 0, 0, 0),
    (1, 0, 1, 1, 0),
    (1, 0, 0, 1, 0),
)
# The second label to store; 0 = the true one. Some cells store a fixed label instead (Q13).
_SECOND = (
    (0, 0, 7, 8, 9),
    (0, 0, 7, 8, 9),
    (2, 5, 7, 8, 9),
    (2, 5, 7, 2, 9),
    (2, 5, 7, 8, 9),
)
_SINGLE = (_I, _D, _K)


def group_of(label: float) -> int:
    """Group of a primitive label: positive, negative, constant, positive impulse, negative impulse."""
    return int(PRIMITIVE_GROUP[int(label)])


def _compatible(this: Row, partner: Row) -> bool:
    size = ratio(prim.span(partner), prim.span(this))
    time = ratio(prim.duration(partner), prim.duration(this))
    return not (unusable(size) or outside(size, *prim.SAME_SIZE) or outside(time, *prim.SAME_DURATION))


def _amplitude(this: Row, partner: Row, first: int, second: int) -> float:
    if _SPAN[first][second]:
        return abs(partner[prim.MAX] - this[prim.MIN])
    return max(this[prim.MAX], partner[prim.MAX]) - min(this[prim.MIN], partner[prim.MIN])


def _single(this: Row, group: int, amplitude: float) -> Row:
    start, end = this[prim.START], this[prim.END]
    label, tag = float(_SINGLE[group]), this[prim.LABEL]
    middle = (start + end) / 2
    return [label, this[prim.AVG], this[prim.MAX], amplitude, tag, tag, start, start, end, end, middle]


def _pair(this: Row, partner: Row, first: int, second: int, amplitude: float) -> Row:
    average = (this[prim.AVG] + partner[prim.AVG]) / 2
    highest = max(this[prim.MAX], partner[prim.MAX])
    tag = float(_SECOND[first][second]) or partner[prim.LABEL]
    middle = (this[prim.START] + partner[prim.END]) / 2
    times = [this[prim.START], this[prim.END], partner[prim.START], partner[prim.END], middle]
    return [float(_CLASS[first][second]), average, highest, amplitude, this[prim.LABEL], tag, *times]


def compose_motions(primitives: Table, clean: bool = False) -> Table:
    """Motion compositions of filtered primitives: rows of eleven columns.

    The last primitive is paired with itself (Q12). A composition of one primitive has the amplitude of the
    rejected pair (Q14); with ``clean`` its own span.
    """
    rows: Table = []
    i = 0
    while i < len(primitives):
        partner_index = min(i + 1, len(primitives) - 1)
        this, partner = primitives[i], primitives[partner_index]
        first, second = group_of(this[prim.LABEL]), group_of(partner[prim.LABEL])
        amplitude = _amplitude(this, partner, first, second)
        if first in _IMPULSES or second in _IMPULSES or _compatible(this, partner):
            rows.append(_pair(this, partner, first, second, amplitude))
            i = partner_index + 1
        else:
            rows.append(_single(this, first, prim.span(this) if clean else amplitude))
            i += 1
    return rows
