"""Ordered pairs: primitives to motion compositions, compositions to low-level behaviours.

A composer holds one segment H per lane; each arrival gives at most one output. Pair tables of
rcbht_jax.labels are packed four bits a cell, because a shift costs less than a gather.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp

from rcbht_jax.encoding.pipe import amplitude, duration, is_contact, is_impulse, keep, merge, once, relabel, select
from rcbht_jax.labels import LLB, MC, MC_PAIR, MC_SINGLE, Group, Primitive
from rcbht_jax.types import Array, Segment


def _packed(cells: Sequence[int]) -> int:
    return sum(int(cell) << (4 * i) for i, cell in enumerate(cells))


_SINGLE_MC = _packed(MC_SINGLE.tolist())
_PAIR_MC = tuple(_packed(row) for row in MC_PAIR.tolist())
# Index = composition code: adjustment, increase, decrease, constant.
_BEHAVIOUR = _packed([0, LLB.AL, LLB.PS, LLB.PL, LLB.FX])


def _look_up(packed: Array | int, index: Array) -> Array:
    return (jnp.asarray(packed, jnp.int32) >> (4 * index)) & 15


def group(label: Array) -> Array:
    """Index into the rows of the pair table (rcbht_jax.labels.Group) of primitive codes."""
    impulse = label - (Primitive.PIMP - Group.PIMP)
    ramp = jnp.where(label <= Primitive.SPOS, jnp.int32(Group.P), jnp.int32(Group.N))
    return jnp.where(label >= Primitive.PIMP, impulse, jnp.where(label == Primitive.CONS, jnp.int32(Group.K), ramp))


def push_primitive(h: Segment, x: Segment, gate: bool, lead: int | None) -> tuple[Segment, Segment]:
    """One primitive arrives (an empty x changes nothing): new H, composition (empty where none is complete).

    Args:
        h: held segment. x: arrival.
        gate: pair ramps only within an amplitude ratio of 2 and a duration ratio of 5.
        lead: samples; a longer primitive does not pair with an impulse that follows it. None: one of any length does.
    """
    both = (x.label > 0) & (h.label > 0)
    first, second = group(h.label), group(x.label)
    ok = jnp.ones_like(both)
    if gate:
        ax, ay, dx, dy = amplitude(h), amplitude(x), duration(h), duration(x)
        ok = (ax <= 2 * ay) & (ay <= 2 * ax) & (dx <= 5 * dy) & (dy <= 5 * dx)
    ok = jnp.where(is_impulse(x.label), True if lead is None else duration(h) <= lead, ok)
    pair = both & (ok | is_impulse(h.label))

    row = jnp.int32(_PAIR_MC[0])
    for index, packed in enumerate(_PAIR_MC[1:], start=1):
        row = jnp.where(first == index, jnp.int32(packed), row)
    label = jnp.where(pair, _look_up(row, second), _look_up(_SINGLE_MC, first))
    return _composed(h, x, pair, jnp.where(both, label, 0))


def single_composition(h: Segment) -> Segment:
    """The composition of a primitive left alone at the end of a stream; empty stays empty."""
    return keep(h.label > 0, relabel(h, _look_up(_SINGLE_MC, group(h.label))))


def push_composition(h: Segment, x: Segment, short: int) -> tuple[Segment, Segment]:
    """One composition arrives: new H, behaviour. Singles shorter than ``short`` samples are noise."""
    both = (x.label > 0) & (h.label > 0)
    contacts = is_contact(h.label) & is_contact(x.label)
    pair = both & (contacts | ((h.label == x.label) & (h.label <= MC.K)))
    grows = (h.label == MC.A) & (amplitude(x) > amplitude(h))
    label = jnp.where(grows, jnp.int32(LLB.SH), _behaviour(h.label))
    label = jnp.where(pair, label, _single(h, short).label)
    return _composed(h, x, pair, jnp.where(both, label, 0))


def _composed(h: Segment, x: Segment, pair: Array, label: Array) -> tuple[Segment, Segment]:
    """New H and output: the pair, or H alone, under a label; 0 = no label yet."""
    word = once(label << 1 | pair.astype(jnp.int32), x.t0)
    pair, label = word & 1 > 0, word >> 1
    out = relabel(select(pair, merge(h, x, label), h), label)
    return select(x.label > 0, keep(~pair, x), h), out


def single_behaviour(h: Segment, short: int) -> Segment:
    """The behaviour of a composition left alone at the end of a stream; empty stays empty."""
    return keep(h.label > 0, _single(h, short))


def _single(h: Segment, short: int) -> Segment:
    noise = ~is_contact(h.label) & ((h.label == MC.U) | (duration(h) < short))
    return relabel(h, jnp.where(noise, jnp.int32(LLB.N), _behaviour(h.label)))


def _behaviour(label: Array) -> Array:
    known = _look_up(_BEHAVIOUR, jnp.minimum(label, MC.K))
    return jnp.where(is_contact(label), jnp.int32(LLB.CT), known)
