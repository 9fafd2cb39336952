"""Plain NumPy form of docs/fit_rule.md, one axis, one window after another, as an oracle for the fit rule.

Residuals come from least squares over all samples of a run, again for every window. Only the composition of two words
is shared with the oracle of the paper's rule.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.support.oracle import ComposeLLB, ComposeMC, It, Watch, merge


def least_squares(y: np.ndarray) -> tuple[float, float, float]:
    """Mean, slope per sample and squared residual; a single sample is level."""
    t = np.arange(len(y)) - (len(y) - 1) / 2
    slope = float((t * (y - y.mean())).sum() / max((t * t).sum(), 0.25))
    return float(y.mean()), slope, float(((y - y.mean() - slope * t) ** 2).sum())


@dataclass
class Accumulator:
    exempt: int | None
    held: It | None = None

    def push(self, x: It) -> list[It]:
        if self.held is not None and self.held.label == x.label != self.exempt:
            self.held = merge(self.held, x, x.label)
            return []
        out, self.held = [] if self.held is None else [self.held], x
        return out

    def drain(self) -> list[It]:
        out, self.held = [] if self.held is None else [self.held], None
        return out


@dataclass
class FitOracle:
    """Words of one axis; ``out`` has three lists of (item, samples received when published)."""

    limits: tuple[float, ...]
    tolerance: float
    window: int = 5
    dt: float = 0.005
    cap: int | None = 40
    lead: int | None = 40
    impulse: int = 40
    needed: int = 5
    kept: int = 5
    gate: bool = True
    adj_exempt: bool = True
    contact_first: bool = False
    watch: Watch = field(default_factory=Watch)

    def __post_init__(self) -> None:
        self.stages = [
            ComposeMC(self.gate, self.contact_first, self.lead, watch=self.watch),
            Accumulator(1 if self.adj_exempt else None),
            ComposeLLB(self.dt, watch=self.watch), Accumulator(None),
        ]  # fmt: skip
        self.out: tuple[list[tuple[It, int]], ...] = ([], [], [])

    def ge(self, a: float, b: float) -> bool:
        return self.watch.ge(a, b, max(abs(a), abs(b), 1e-6))

    def encode(self, y: np.ndarray) -> FitOracle:
        start, end = 0, len(y)  # of the run
        for first in range(0, len(y), self.window):
            now = min(first + self.window, len(y))
            found = self.broken(y, start, first - self.kept, now)
            arrivals = []
            if found is not None:
                arrivals, start = [self.primitive(y, start, found)], found
            self.advance(arrivals, now)
        if end:
            self.push([self.primitive(y, start, end)], end, 0)
            for number, stage in enumerate(self.stages):
                self.publish(stage, stage.drain(), end, number)
        return self

    def broken(self, y: np.ndarray, start: int, oldest: int, now: int) -> int | None:
        """Where the run ``start`` to ``now`` breaks, if it does: at ``oldest`` or later, two samples on either side."""
        places = range(max(start + 2, oldest), now - 1)
        if not places:
            return None
        apart = [least_squares(y[start:p])[2] + least_squares(y[p:now])[2] for p in places]
        saved = least_squares(y[start:now])[2] - min(apart)
        if self.ge(self.tolerance**2 * self.needed, saved):
            return None
        best = int(np.argmin(apart))
        for other in apart[:best] + apart[best + 1 :]:
            self.ge(other, apart[best])
        return places[best]

    def primitive(self, y: np.ndarray, start: int, end: int) -> It:
        n = end - start
        mean, per_sample, _ = least_squares(y[start:end])
        slope, half = per_sample / self.dt, abs(per_sample) * (n - 1) / 2
        rank = sum(not self.ge(abs(slope), limit) for limit in self.limits)
        level = self.ge(self.tolerance**2, per_sample**2 * (n * n - 1) / 12)
        if rank == 4 or level:
            label = 7
        elif rank == 0 and n <= self.impulse:
            label = 8 if slope > 0 else 9
        else:
            label = max(rank, 1) if slope > 0 else max(rank, 1) + 3
        return It(label, start, end, mean + half, mean - half, mean, slope)

    def advance(self, items: list[It], now: int) -> None:
        """One window: arrivals go first; a word that nothing arrives for leaves when it is late."""
        self.out[0].extend((x, now) for x in items)
        for number, stage in enumerate(self.stages):
            held = stage.H if number % 2 == 0 else stage.held
            if items:
                items = [y for x in items for y in stage.push(x)]
            elif held is not None and self.cap is not None and now - held.t1 > self.cap:
                items = stage.drain()
            if number % 2:
                self.out[1 + number // 2].extend((x, now) for x in items)

    def push(self, items: list[It], now: int, first: int) -> None:
        if first == 0:
            self.out[0].extend((x, now) for x in items)
        for number in range(first, 4):
            items = [y for x in items for y in self.stages[number].push(x)]
            if number % 2:
                self.out[1 + number // 2].extend((x, now) for x in items)

    def publish(self, stage: object, items: list[It], now: int, number: int) -> None:
        if number % 2:
            self.out[1 + number // 2].extend((x, now) for x in items)
        self.push(items, now, number + 1) if number < 3 else None


def near(oracle: FitOracle) -> bool:
    """Whether a comparison was so close that rounding decides it."""
    return any(oracle.watch.near)
