"""The filter pipe between two layers: merges repeats, absorbs the negligible.

A pipe holds a closed run A and an open run B per lane and publishes at most one segment per arrival.
Pure, elementwise, no loop: every lane does the same few selects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from rcbht_jax.labels import LLB, MC, Primitive
from rcbht_jax.types import Array, Segment


def is_impulse(label: Array) -> Array:
    """Whether primitive codes are impulses."""
    return label >= Primitive.PIMP


def is_contact(label: Array) -> Array:
    """Whether composition codes are contacts of any sign."""
    return (label >= MC.PC) & (label <= MC.C)


def is_contact_behaviour(label: Array) -> Array:
    """Whether behaviour codes are contacts."""
    return label == LLB.CT


@dataclass(frozen=True)
class PipeRules:
    """What one layer's pipe may do.

    Attributes:
        contact: marks labels that are never absorbed and never wait.
        exempt: a label whose repeats stay apart (adjustments), or None.
        rule: "paper" absorbs what is 5 times smaller and 5 times shorter; "similar" is the reference's older
            rule, which absorbs what has a similar amplitude (within 5 times) and is more than 5 times shorter.
        cap: publish A at the latest on the first arrival that makes B longer than this many samples, or None.
        one_slot: compare each arrival with the accumulator B only; A stays empty.
    """

    contact: Callable[[Array], Array]
    exempt: int | None = None
    rule: Literal["paper", "similar"] = "paper"
    cap: int | None = None
    one_slot: bool = False


def amplitude(x: Segment) -> Array:
    """Height of the fitted lines, never negative."""
    return x.vmax - x.vmin


def duration(x: Segment) -> Array:
    """Length in samples."""
    return x.t1 - x.t0


def select(condition: Array, x: Segment, y: Segment) -> Segment:
    """Lane-wise choice between two segments."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), x, y)


def keep(condition: Array, x: Segment) -> Segment:
    """The segment where the condition holds, an empty slot elsewhere."""
    return relabel(x, jnp.where(condition, x.label, 0))


def relabel(x: Segment, label: Array) -> Segment:
    """The same span under another label."""
    return Segment(label, x.t0, x.t1, x.vmax, x.vmin, x.area, x.rise)


def merge(x: Segment, y: Segment, label: Array) -> Segment:
    """The span of two neighbours, x first; associative but for rounding.

    In single precision n merges may move a sum by n / 2^24 of what was added, signs aside: the mean of a word of a
    million samples in windows of five is right to a few thousandths, and after tens of millions of windows a sum hardly
    changes any more. What :func:`rcbht_jax.encoding.encoder.track_of` publishes as the mean therefore stays between the
    extremes of the word, however long it is; the slope of so long a word is right in its order of magnitude at first,
    then tends to 0.
    """
    vmax, vmin = jnp.maximum(x.vmax, y.vmax), jnp.minimum(x.vmin, y.vmin)
    return Segment(label, x.t0, y.t1, vmax, vmin, x.area + y.area, x.rise + y.rise)


def over(x: Segment, y: Segment, rule: str) -> Array:
    """Whether x may absorb y by the time-amplitude rule."""
    ax, ay, dx, dy = amplitude(x), amplitude(y), duration(x), duration(y)
    if rule == "paper":
        return (ax >= 5 * ay) & (dx >= 5 * dy)
    return (ax <= 5 * ay) & (ay <= 5 * ax) & (dx > 5 * dy)


def push(a: Segment, b: Segment, x: Segment, rules: PipeRules) -> tuple[Segment, Segment, Segment]:
    """One arrival (an empty x changes nothing): new A, new B, published segment (empty where nothing leaves)."""
    if rules.one_slot:
        return _push_one_slot(a, b, x, rules)
    arrived, same, absorb, a_wins, fire, rejoin = _decide(a, b, x, rules)
    run = select(same, merge(b, x, b.label), b)
    joint = merge(a, run, jnp.where(a_wins, a.label, b.label))
    new_b = select(arrived, x, b)
    new_b = select(same, select(absorb, joint, run), new_b)
    new_b = select(rejoin, merge(joint, x, x.label), new_b)
    new_a = select(arrived & ~same, select(absorb, joint, b), a)
    new_a = keep(~(rejoin | (same & (absorb | fire))), new_a)
    return new_a, new_b, keep(fire, a)


def _decide(a: Segment, b: Segment, x: Segment, rules: PipeRules) -> list[Array]:
    """Whether x arrived; continues B; A and B merge; under A's label; A leaves; x joins the merged segment."""
    arrived, both = x.label > 0, (x.label > 0) & (a.label > 0)
    same = arrived & _same(b.label, x.label, rules)
    run = select(same, merge(b, x, b.label), b)  # B as it stands after the arrival

    contact = rules.contact(a.label) | rules.contact(b.label)
    b_wins = ~contact & over(run, a, rules.rule)
    a_wins = ~contact & ~same & ~b_wins & over(a, run, rules.rule)
    absorb = both & (b_wins | a_wins)
    late = contact | (duration(run) >= 5 * duration(a))
    if rules.cap is not None:
        late = late | (duration(run) > rules.cap)
    fire = both & ~absorb & (~same | late)
    rejoin = absorb & ~same & _same(jnp.where(a_wins, a.label, b.label), x.label, rules)
    word = once(packed(arrived, same, absorb, a_wins, fire, rejoin), x.t0)
    return [word >> bit & 1 > 0 for bit in range(6)]


def packed(*bits: Array) -> Array:
    """Booleans as the bits of one int32, the first the lowest."""
    return sum((bit.astype(jnp.int32) << place for place, bit in enumerate(bits)), jnp.int32(0))


def once(word: Array, time: Array) -> Array:
    """The same small int32 numbers (below 2^24), computed once.

    A compiler that fuses the encoder into one loop per output repeats what leads to a decision in each of them; it
    does not repeat a division. This makes a step many times faster. The divisor is 1, which the compiler cannot
    know: ``time`` is an int32 that is never negative.
    """
    return settled(word.astype(jnp.float32), time).astype(jnp.int32)


def settled(value: Array, time: Array) -> Array:
    """The same real numbers, computed once; see :func:`once`."""
    return value / jnp.where(time < 0, 2, 1).astype(value.dtype)


def _push_one_slot(a: Segment, b: Segment, x: Segment, rules: PipeRules) -> tuple[Segment, Segment, Segment]:
    both = (x.label > 0) & (b.label > 0)
    same = both & _same(b.label, x.label, rules)
    contact = rules.contact(b.label) | rules.contact(x.label)
    x_wins = both & ~contact & over(x, b, rules.rule)
    b_wins = both & ~contact & over(b, x, rules.rule)
    join = same | x_wins | b_wins
    label = jnp.where(x_wins & ~same, x.label, b.label)
    new_b = select(join, merge(b, x, label), select(x.label > 0, x, b))
    return a, new_b, keep(both & ~join, b)


def drain(a: Segment, b: Segment, rules: PipeRules) -> tuple[Segment, Segment]:
    """What the pipe still holds at the end of a stream, decided as if B were closed: two segments, maybe empty."""
    both = (a.label > 0) & (b.label > 0)
    contact = rules.contact(a.label) | rules.contact(b.label)
    b_wins = ~contact & over(b, a, rules.rule)
    a_wins = ~contact & ~b_wins & over(a, b, rules.rule)
    absorb = both & (b_wins | a_wins)
    joint = merge(a, b, jnp.where(a_wins, a.label, b.label))
    return keep(both & ~absorb, a), select(absorb, joint, b)


def _same(x: Array, y: Array, rules: PipeRules) -> Array:
    equal = x == y
    return equal if rules.exempt is None else equal & (x != rules.exempt)
