"""The worked examples of the specification (section 4.9) and the pipe's rules one by one."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax import labels
from rcbht_jax.encoding import composition, encoder, pipe
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.types import Segment
from tests.support import oracle

W, DT = 20, 0.005
CODES = {"bpos": 1, "mpos": 2, "spos": 3, "bneg": 4, "mneg": 5, "sneg": 6, "cons": 7, "pimp": 8, "nimp": 9}
config = EncoderConfig(window=W)


def feed(spans: list[tuple[str, int, float]], options: EncoderConfig = config) -> tuple[list, list, list]:
    """Windows of given labels and amplitudes through the chain: per layer (label, seconds, published at)."""
    state = encoder.init((1,))
    words: tuple[list, list, list] = ([], [], [])

    def keep(tracks: encoder.LabelTracks) -> None:
        for rows, layer, track in zip(words, labels.LAYERS, (tracks.primitive, tracks.mc, tracks.llb), strict=True):
            for slot in np.flatnonzero(np.asarray(track.label)):
                code, t0, t1, emit = (int(np.ravel(getattr(track, f))[slot]) for f in ("label", "t0", "t1", "emit"))
                rows.append((labels.name(layer, code), round(t0 * DT, 3), round(t1 * DT, 3), round(emit * DT, 3)))

    for name, windows, amp in spans:
        for _ in range(windows):
            values = [jnp.full(1, v, jnp.float32) for v in (amp / 2, -amp / 2, 0.0, 0.0)]
            x = Segment(jnp.full(1, CODES[name], jnp.int32), state.time, state.time + W, *values)
            state, out = advance(options, state, x, jnp.full(1, W, jnp.int32))
            keep(encoder.unpack(out))
    keep(jax.jit(encoder.drain, static_argnums=0)(options, state))
    return words


advance = jax.jit(encoder._advance, static_argnums=0)


def words(rows: list) -> list[tuple[str, float, float]]:
    return [row[:3] for row in rows]


def test_e1_contact() -> None:
    spans = [("cons", 6, 0.08), ("pimp", 1, 8.0), ("sneg", 2, 0.6), ("cons", 8, 0.08)]
    prims, mcs, llbs = feed(spans)
    assert prims[:2] == [("cons", 0.0, 0.6, 0.8), ("pimp", 0.6, 0.7, 0.9)]
    assert words(prims[2:]) == [("sneg", 0.7, 0.9), ("cons", 0.9, 1.7)]
    assert words(mcs) == [("pc", 0.0, 0.7), ("d", 0.7, 0.9), ("k", 0.9, 1.7)]
    assert words(llbs) == [("CT", 0.0, 0.7), ("PL", 0.7, 0.9), ("FX", 0.9, 1.7)]
    _, mcs, _ = feed(spans, EncoderConfig(window=W, contact_first=True))
    assert words(mcs)[:2] == [("k", 0.0, 0.6), ("c", 0.6, 0.9)]


def test_e2_absorption() -> None:
    prims, mcs, llbs = feed([("spos", 6, 3.0), ("cons", 1, 0.05), ("spos", 4, 0.5), ("cons", 2, 0.05)])
    assert words(prims) == [("spos", 0.0, 1.3)]
    assert words(mcs) == [("i", 0.0, 1.3)]
    assert words(llbs) == [("PS", 0.0, 1.3)]


@pytest.mark.parametrize(("amps", "behaviour"), [((0.4, 0.9), "SH"), ((0.9, 0.4), "AL")])
def test_e3_shift_and_alignment(amps: tuple[float, float], behaviour: str) -> None:
    first, second = amps
    spans = [("spos", 1, first), ("sneg", 1, first), ("spos", 1, second), ("sneg", 1, second), ("cons", 2, 0.05)]
    _, mcs, llbs = feed(spans)
    assert words(mcs) == [("a", 0.0, 0.2), ("a", 0.2, 0.4), ("k", 0.4, 0.6)]
    assert words(llbs) == [(behaviour, 0.0, 0.4), ("FX", 0.4, 0.6)]


def test_e4_gate() -> None:
    spans = [("cons", 10, 0.1), ("spos", 2, 1.6), ("sneg", 2, 0.6), ("cons", 6, 0.1)]
    _, mcs, llbs = feed(spans)
    assert [row[0] for row in mcs] == ["k", "i", "d", "k"]
    assert [row[0] for row in llbs] == ["FX", "PS", "PL", "FX"]
    _, mcs, _ = feed(spans, EncoderConfig(window=W, gate=False))
    assert words(mcs) == [("i", 0.0, 1.2), ("d", 1.2, 2.0)]


RULES = {
    "primitive": (pipe.PipeRules(pipe.is_impulse), oracle.Pipe(0), 9),
    "composition": (pipe.PipeRules(pipe.is_contact, exempt=1), oracle.Pipe(1), 8),
    "behaviour": (pipe.PipeRules(pipe.is_contact_behaviour), oracle.Pipe(2), 8),
    "one slot": (pipe.PipeRules(pipe.is_impulse, one_slot=True), oracle.Pipe(0, slots=1), 9),
    "similar": (pipe.PipeRules(pipe.is_contact_behaviour, rule="similar"), oracle.Pipe(2, rule="similar"), 8),
    "capped": (pipe.PipeRules(pipe.is_impulse, cap=7), oracle.Pipe(0, cap=7), 9),
}
items = st.lists(st.tuples(st.integers(1, 8), st.integers(1, 12), st.integers(0, 12)), min_size=1, max_size=24)


def run_pipe(rules: pipe.PipeRules, arrivals: Segment) -> tuple[Segment, Segment]:
    empty = jax.tree.map(lambda leaf: jnp.zeros_like(leaf[0]), arrivals)

    def body(held: tuple[Segment, Segment], x: Segment) -> tuple[tuple[Segment, Segment], Segment]:
        a, b, out = pipe.push(*held, x, rules)
        return (a, b), out

    (a, b), out = jax.lax.scan(body, (empty, empty), arrivals)
    rest = jax.tree.map(lambda *leaves: jnp.stack(leaves), *pipe.drain(a, b, rules))
    return out, rest


run_pipe = jax.jit(run_pipe, static_argnums=0)


@pytest.mark.parametrize("name", RULES)
@given(spans=items)
def test_pipe_rules_equal_brute_force(name: str, spans: list[tuple[int, int, int]]) -> None:
    rules, slow, alphabet = RULES[name]
    rows, t = [], 0
    for label, duration, amp in spans:
        rows.append(oracle.It(min(label, alphabet), t, t + duration, amp / 4, -amp / 4, 0.25, 0.5))
        t += duration
    expected = [out for row in rows for out in slow.push(row)] + slow.drain()
    table = np.zeros((7, 24))
    table[:, : len(rows)] = np.array(
        [(r.label, r.t0, r.t1, r.vmax, r.vmin, r.avg * r.dur, r.grad * r.dur) for r in rows]
    ).T
    arrivals = Segment(*(jnp.asarray(column, jnp.int32) for column in table[:3]), *jnp.asarray(table[3:], jnp.float32))
    got = []
    for part in run_pipe(rules, arrivals):
        used = np.asarray(part.label) > 0
        got += list(zip(*(np.asarray(leaf)[used].tolist() for leaf in jax.tree.leaves(part)), strict=True))
    assert got == [
        (r.label, r.t0, r.t1, r.vmax, r.vmin, pytest.approx(r.avg * r.dur), pytest.approx(r.grad * r.dur))
        for r in expected
    ]


LIMIT_RULES = {
    "paper": (pipe.PipeRules(pipe.is_impulse), {}),
    "similar": (pipe.PipeRules(pipe.is_impulse, rule="similar"), {"rule": "similar"}),
    "capped": (pipe.PipeRules(pipe.is_impulse, cap=20), {"cap": 20}),
    "one slot": (pipe.PipeRules(pipe.is_impulse, one_slot=True), {"slots": 1}),
}


@pytest.mark.parametrize("name", LIMIT_RULES)
def test_what_is_absorbed_and_what_leaves_at_the_limits_of_the_rule(name: str) -> None:
    """Ratios of exactly 5 and a run as long as the cap, whichever of two neighbours is the larger."""
    rules, options = LIMIT_RULES[name]
    amps, last = (1.0, 4.75, 5.0, 5.25), 1
    firsts = itertools.product((1, 4, 5, 20, 25), amps)
    seconds = itertools.product((1, 4, 19, 20, 24, 25), amps)
    cases, expected = [], []
    for (before, x), (after, y), third in itertools.product(firsts, seconds, (1, 7, 2)):
        times = np.cumsum([0, before, after, last])
        rows = [
            oracle.It(label, int(t0), int(t1), amp, 0.0, 0.0, 0.0)
            for label, t0, t1, amp in zip((1, 7, third), times[:-1], times[1:], (x, y, 1.0), strict=True)
        ]
        slow = oracle.Pipe(0, **options)
        pushed = [slow.push(row) for row in rows]
        expected.append([[(r.label, r.t0, r.t1, r.vmax) for r in out] for out in (*pushed, slow.drain())])
        cases.append([(r.label, r.t0, r.dur, r.vmax) for r in rows])
    arrivals = several(*np.moveaxis(np.array(cases), -1, 0).swapaxes(1, 2))
    steps, rest = (jax.tree.map(np.asarray, part) for part in run_pipe(rules, arrivals))

    def said(part: Segment, at: int, case: int) -> list[tuple[float, ...]]:
        fields = (leaf[at, case].item() for leaf in (part.label, part.t0, part.t1, part.vmax))
        return [tuple(fields)] if part.label[at, case] else []

    for case, outs in enumerate(expected):
        assert [*(said(steps, at, case) for at in range(3)), said(rest, 0, case) + said(rest, 1, case)] == outs


def one(label: int, duration: int, amp: float) -> Segment:
    values = [jnp.float32(v) for v in (amp, 0.0, 0.0, 0.0)]
    return Segment(jnp.int32(label), jnp.int32(0), jnp.int32(duration), *values)


@pytest.mark.parametrize("first", range(1, 10))
@pytest.mark.parametrize("second", range(1, 10))
def test_every_pair_of_primitives(first: int, second: int) -> None:
    kinds = oracle.group(first) + oracle.group(second)
    _, out = composition.push_primitive(one(first, 5, 1.0), one(second, 5, 1.0), gate=True, lead=None)
    assert labels.name("mc", int(out.label)) == oracle.PAIR[kinds]


@pytest.mark.parametrize("first", range(1, 9))
@pytest.mark.parametrize("second", range(1, 9))
@pytest.mark.parametrize("amps", [(1.0, 2.0), (2.0, 1.0), (1.0, 1.0)])
@pytest.mark.parametrize("duration", [19, 20])
def test_every_pair_of_compositions(first: int, second: int, amps: tuple[float, float], duration: int) -> None:
    slow = oracle.ComposeLLB(DT, H=oracle.It(first, 0, duration, amps[0], 0.0, 0.0, 0.0))
    (expected,) = slow.push(oracle.It(second, duration, duration + 5, amps[1], 0.0, 0.0, 0.0))
    _, out = composition.push_composition(one(first, duration, amps[0]), one(second, 5, amps[1]), short=20)
    assert int(out.label) == expected.label


@pytest.mark.parametrize("first", [1, 4, 7, 8])  # bpos, bneg, cons, pimp
@pytest.mark.parametrize("lead", [None, 4])
@pytest.mark.parametrize("gate", [True, False])
def test_which_primitives_pair_at_the_limits_of_the_gate(first: int, lead: int | None, gate: bool) -> None:
    """Ratios of exactly 2 and 5, and a lead of exactly its limit, are still allowed, whichever of two is the larger."""
    amps, durations = (1.0, 1.75, 2.0, 2.25), (4, 5, 20, 24, 25, 26)
    cases = [
        (x, y, seconds, second)
        for second in (2, 9)
        for x, y in itertools.product(amps, repeat=2)
        for seconds in itertools.product(durations, repeat=2)
    ]
    expected = []
    for x, y, (before, after), second in cases:
        slow = oracle.ComposeMC(gate, lead=lead, H=oracle.It(first, 0, before, x, 0.0, 0.0, 0.0))
        (out,) = slow.push(oracle.It(second, before, before + after, y, 0.0, 0.0, 0.0))
        expected.append((out.label, out.t1))
    x, y, seconds, second = (np.array(column) for column in zip(*cases, strict=True))
    held = several(np.full(len(cases), first), np.zeros(len(cases)), seconds[:, 0], x)
    _, out = composition.push_primitive(held, several(second, seconds[:, 0], seconds[:, 1], y), gate=gate, lead=lead)
    np.testing.assert_array_equal(np.stack([out.label, out.t1], 1), expected)


def several(label: np.ndarray, t0: np.ndarray, duration: np.ndarray, amp: np.ndarray) -> Segment:
    times = [jnp.asarray(v, jnp.int32) for v in (label, t0, t0 + duration)]
    return Segment(*times, *(jnp.asarray(v, jnp.float32) for v in (amp, 0 * amp, 0 * amp, 0 * amp)))


def test_nothing_alone_at_the_end_stays_nothing() -> None:
    assert int(composition.single_composition(one(0, 0, 0.0)).label) == 0
    assert int(composition.single_behaviour(one(0, 0, 0.0), short=20).label) == 0
