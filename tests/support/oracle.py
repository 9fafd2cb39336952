"""Plain-Python paper-mode taxonomy, written rule by rule from the specification, as an oracle for the encoder.

One axis, one window after another, lists instead of arrays; nothing is shared with rcbht_jax but the label codes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add

P, N, K, PI, NI = {1, 2, 3}, {4, 5, 6}, {7}, {8}, {9}
GROUPS = (P, N, K, PI, NI)
PAIR = {
    "PP": "i", "PN": "a", "PK": "i", "Pp": "pc", "Pn": "c",
    "NP": "a", "NN": "d", "NK": "d", "Np": "c", "Nn": "nc",
    "KP": "i", "KN": "d", "KK": "k", "Kp": "pc", "Kn": "nc",
    "pP": "c", "pN": "c", "pK": "pc", "pp": "u", "pn": "c",
    "nP": "c", "nN": "c", "nK": "nc", "np": "c", "nn": "u",
}  # fmt: skip
MC = {"a": 1, "i": 2, "d": 3, "k": 4, "pc": 5, "nc": 6, "c": 7, "u": 8}
FX, CT, PS, PL, AL, SH, U, NOISE = range(1, 9)


@dataclass(frozen=True)
class It:
    label: int
    t0: int
    t1: int
    vmax: float
    vmin: float
    avg: float
    grad: float

    @property
    def dur(self) -> int:
        return self.t1 - self.t0

    @property
    def amp(self) -> float:
        return self.vmax - self.vmin


class Watch:
    """Compares numbers and remembers each answer, and whether single precision could have given the other one."""

    def __init__(self) -> None:
        self.answers: list[bool] = []
        self.near: list[bool] = []

    def ge(self, a: float, b: float, level: float) -> bool:
        self.near.append(bool(abs(a - b) <= 32 * 2.0**-24 * level))
        self.answers.append(bool(a >= b))
        return self.answers[-1]

    def amp_ge(self, x: It, factor: float, y: It) -> bool:
        level = max(abs(v) for v in (x.vmax, x.vmin, y.vmax, y.vmin))
        return self.ge(x.amp, factor * y.amp, (1 + factor) * level)


def merge(x: It, y: It, label: int) -> It:
    d = x.dur + y.dur
    return It(
        label, x.t0, y.t1, max(x.vmax, y.vmax), min(x.vmin, y.vmin),
        (x.avg * x.dur + y.avg * y.dur) / d, (x.grad * x.dur + y.grad * y.dur) / d,
    )  # fmt: skip


def group(label: int) -> str:
    return next(letter for letter, g in zip("PNKpn", GROUPS, strict=True) if label in g)


def gradient_label(g: float, limits, level: float, watch: Watch) -> int:
    rank = sum(not watch.ge(abs(g), limit, level) for limit in limits)
    if rank == 4:
        return 7
    if rank == 0:
        return 8 if g > 0 else 9
    return rank if g > 0 else rank + 3


def added(values) -> float:
    """One after the other, each sum rounded: from Python 3.12 on ``sum`` corrects what rounding loses."""
    return reduce(add, values, 0.0)


def fit(y, t0: int, dt: float, limits, watch: Watch) -> It:
    n = len(y)
    k = [j - (n - 1) / 2 for j in range(n)]
    g = added(a * b for a, b in zip(k, y, strict=True)) / (dt * added(a * a for a in k))
    avg = added(y) / n
    half = abs(g) * (n - 1) * dt / 2
    level = max(abs(b) for b in y) * added(abs(a) for a in k) / (dt * added(a * a for a in k))
    return It(gradient_label(g, limits, level, watch), t0, t0 + n, avg + half, avg - half, avg, g)


@dataclass
class Pipe:
    layer: int
    adj_exempt: bool = True
    slots: int = 2
    cap: int | None = None
    rule: str = "paper"
    watch: Watch = field(default_factory=Watch)
    A: It | None = None
    B: It | None = None

    def same(self, x: It, y: It) -> bool:
        if self.layer == 1 and self.adj_exempt and x.label == 1:
            return False
        return x.label == y.label

    def contact(self, x: It) -> bool:
        return x.label in ({8, 9}, {5, 6, 7}, {2})[self.layer]

    def over(self, x: It, y: It) -> bool:
        if self.rule == "similar":
            near = self.watch.amp_ge(y, 1 / 5, x) and self.watch.amp_ge(x, 1 / 5, y)
            return near and x.dur > 5 * y.dur
        return self.watch.amp_ge(x, 5, y) and x.dur >= 5 * y.dur

    def decide(self, a: It, b: It, closed: bool) -> str:
        if self.contact(a) or self.contact(b):
            return "fire"
        if self.over(b, a):
            return "B"
        if closed:
            return "A" if self.over(a, b) else "fire"
        if self.cap is not None and b.dur > self.cap:
            return "fire"
        return "fire" if b.dur >= 5 * a.dur else "wait"

    def push(self, x: It) -> list[It]:
        if self.slots == 1:
            return self.push_one_slot(x)
        if self.B is None:
            self.B = x
            return []
        if self.same(self.B, x):
            self.B = merge(self.B, x, self.B.label)
            if self.A is None:
                return []
            verdict = self.decide(self.A, self.B, closed=False)
            out = [self.A] if verdict == "fire" else []
            if verdict == "B":
                self.B = merge(self.A, self.B, self.B.label)
            if verdict != "wait":
                self.A = None
            return out
        if self.A is None:
            self.A, self.B = self.B, x
            return []
        verdict = self.decide(self.A, self.B, closed=True)
        if verdict == "fire":
            out, self.A, self.B = [self.A], self.B, x
            return out
        m = merge(self.A, self.B, (self.A if verdict == "A" else self.B).label)
        if self.same(m, x):
            self.A, self.B = None, merge(m, x, m.label)
        else:
            self.A, self.B = m, x
        return []

    def push_one_slot(self, x: It) -> list[It]:
        """The accumulator B takes repeats and absorbs or is absorbed; otherwise it leaves."""
        if self.B is None:
            self.B = x
            return []
        if self.same(self.B, x):
            self.B = merge(self.B, x, self.B.label)
            return []
        if not (self.contact(self.B) or self.contact(x)):
            if self.over(x, self.B):
                self.B = merge(self.B, x, x.label)
                return []
            if self.over(self.B, x):
                self.B = merge(self.B, x, self.B.label)
                return []
        out, self.B = [self.B], x
        return out

    def drain(self) -> list[It]:
        out = []
        if self.A is not None and self.B is not None:
            verdict = self.decide(self.A, self.B, closed=True)
            if verdict == "fire":
                out = [self.A]
            else:
                self.B = merge(self.A, self.B, (self.A if verdict == "A" else self.B).label)
            self.A = None
        if self.B is not None:
            out.append(self.B)
        self.A = self.B = None
        return out


def gated(x: It, y: It, watch: Watch) -> bool:
    near = watch.amp_ge(y, 0.5, x) and watch.amp_ge(x, 0.5, y)
    return near and x.dur <= 5 * y.dur and y.dur <= 5 * x.dur


@dataclass(kw_only=True)
class Compose:
    """Pairs of arrivals; a subclass has ``pair``, the label of two or None, and ``single``, a composition of one."""

    watch: Watch = field(default_factory=Watch)
    H: It | None = None

    def push(self, x: It) -> list[It]:
        if self.H is None:
            self.H = x
            return []
        h, label = self.H, self.pair(self.H, x)
        if label is not None:
            self.H = None
            return [merge(h, x, label)]
        self.H = x
        return [self.single(h)]

    def drain(self) -> list[It]:
        out = [] if self.H is None else [self.single(self.H)]
        self.H = None
        return out


@dataclass
class ComposeMC(Compose):
    gate: bool = True
    contact_first: bool = False
    lead: int | None = None

    def pair(self, x: It, y: It) -> int | None:
        return MC[PAIR[group(x.label) + group(y.label)]] if self.pairable(x, y) else None

    def pairable(self, x: It, y: It) -> bool:
        if x.label in PI | NI:
            return True
        if y.label in PI | NI:
            return not self.contact_first and (self.lead is None or x.dur <= self.lead)
        return gated(x, y, self.watch) if self.gate else True

    @staticmethod
    def single(x: It) -> It:
        return replace(x, label=MC[{"P": "i", "N": "d", "K": "k", "p": "pc", "n": "nc"}[group(x.label)]])


@dataclass
class ComposeLLB(Compose):
    dt: float

    def pair(self, x: It, y: It) -> int | None:
        if x.label in {5, 6, 7} and y.label in {5, 6, 7}:
            return CT
        if x.label != y.label:
            return None
        if x.label == 1:
            return AL if self.watch.amp_ge(x, 1, y) else SH
        return {2: PS, 3: PL, 4: FX}.get(x.label)

    def single(self, x: It) -> It:
        if x.label in {5, 6, 7}:
            return replace(x, label=CT)
        if x.label == 8 or x.dur < round(0.1 / self.dt):
            return replace(x, label=NOISE)
        return replace(x, label={1: AL, 2: PS, 3: PL, 4: FX}[x.label])


@dataclass
class Chain:
    window: int
    dt: float
    limits: tuple
    options: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        o = {"gate": True, "contact_first": False, "adj_exempt": True, "slots": 2, "cap": None, "rule": "paper"}
        o |= self.options
        self.watch = Watch()
        pipe = {key: o[key] for key in ("adj_exempt", "slots", "cap", "rule")} | {"watch": self.watch}
        self.stages = [
            (Pipe(0, **pipe), 0),
            (ComposeMC(o["gate"], o["contact_first"], watch=self.watch), None),
            (Pipe(1, **pipe), 1),
            (ComposeLLB(self.dt, watch=self.watch), None),
            (Pipe(2, **pipe), 2),
        ]
        self.out = ([], [], [])

    def push(self, items: list[It], now: int, first: int = 0, eos: bool = False) -> None:
        for stage, layer in self.stages[first:]:
            items = [y for x in items for y in stage.push(x)]
            if layer is not None:
                self.out[layer].extend((y, now, eos) for y in items)

    def flush(self, now: int) -> None:
        for i, (stage, layer) in enumerate(self.stages):
            items = stage.drain()
            if layer is not None:
                self.out[layer].extend((y, now, True) for y in items)
            self.push(items, now, i + 1, True)


def encode(y, dt: float, limits, window: int = 5, **options) -> Chain:
    """Chain after the whole of one axis; ``out`` has three lists of (item, samples received, flushed)."""
    chain = Chain(window, dt, limits, options)
    n = len(y)
    for t0 in range(0, n, window):
        piece = y[t0 : t0 + window]
        if len(piece) >= 2:
            chain.push([fit(piece, t0, dt, limits, chain.watch)], t0 + len(piece))
    chain.flush(n - (n % window == 1))  # a single left-over sample is never part of a window
    return chain
