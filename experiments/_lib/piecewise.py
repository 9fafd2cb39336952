"""Straight lines for a signal: filters that process samples as they arrive, and optimal lines.

Every function takes one axis ``y [time]``. Breaks are the first samples of all pieces but the first, in order; a line
is the least-squares one of its piece unless stated otherwise. The functions are for comparisons, not for streams.

Sources: sliding window and bottom-up, Keogh et al., "Segmenting time series", 2004; swing and slide filter, Elmeleegy
et al., "Online piece-wise linear approximation of numerical streams with precision guarantees", 2009; the optimum by
dynamic programming, Bellman 1961, with the pruning of Killick et al., "Optimal detection of changepoints", 2012.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments._lib.arrays import Floats, Ints


@dataclass(frozen=True)
class Approximation:
    """The signal that words describe, and their number."""

    values: Floats  # [time]
    words: int


class Sums:
    """Residuals of least-squares lines through any piece, from running sums."""

    def __init__(self, y: Floats) -> None:
        self.middle = y.mean() if len(y) else 0.0
        self.centre = (len(y) - 1) / 2  # sums stay small, so that their differences are exact enough
        centred, time = y - self.middle, np.arange(len(y)) - self.centre
        terms = np.stack([centred, centred * centred, time * centred])
        self.running = np.concatenate([np.zeros((3, 1)), terms.cumsum(1)], 1)

    def line(self, start: Ints, stop: Ints) -> tuple[Floats, Floats]:
        """Mean and slope for each sample of the lines through samples start to stop - 1."""
        n = stop - start
        total, _, moment = self.running[:, stop] - self.running[:, start]
        moment = moment - ((start + stop - 1) / 2 - self.centre) * total
        slope = 12 * moment / np.maximum(n * (n * n - 1.0), 1.0)
        return total / n + self.middle, np.where(n > 1, slope, 0.0)

    def residual(self, start: Ints, stop: int) -> Floats:
        """Squared residuals of the lines from several starts to one stop."""
        totals, squares, moments = self.running
        n = (stop - start).astype(np.float64)
        total = totals[stop] - totals[start]
        moment = moments[stop] - moments[start] - (stop - 0.5 - self.centre - n / 2) * total
        left = squares[stop] - squares[start] - total * total / n
        return np.maximum(left - 12 * moment * moment / np.maximum(n * (n * n - 1.0), 1.0), 0.0)

    def one(self) -> Callable[[int, int], float]:
        """The squared residuals of one piece at a time, as fast as Python is."""
        totals, squares, moments = self.running.tolist()
        centre = self.centre

        def residual(start: int, stop: int) -> float:
            n, total = stop - start, totals[stop] - totals[start]
            moment = moments[stop] - moments[start] - ((start + stop - 1) / 2 - centre) * total
            about = 12 * moment * moment / (n * (n * n - 1.0)) if n > 1 else 0.0
            return float(max(squares[stop] - squares[start] - total * total / n - about, 0.0))

        return residual


def lines(y: Floats, breaks: Ints) -> Approximation:
    """The least-squares line of every piece.

    Example:
        >>> lines(np.array([0.0, 1, 2, 7, 7]), np.array([3])).values.round(9).tolist()
        [0.0, 1.0, 2.0, 7.0, 7.0]
    """
    edges = np.concatenate([[0], breaks, [len(y)]]).astype(np.int64)
    start, stop = edges[:-1], edges[1:]
    mean, slope = Sums(y).line(start, stop)
    word = np.repeat(np.arange(len(start)), stop - start)
    return Approximation(mean[word] + slope[word] * (np.arange(len(y)) - ((start + stop - 1) / 2)[word]), len(start))


def bottom_up(y: Floats) -> Ints:
    """Breaks in the order in which merging gives them up: the last k - 1 of them leave k pieces.

    Pieces of two samples are merged, first those neighbours whose joint line adds least to the squared residuals.
    """
    residual = Sums(y).one()
    edge = [*range(0, max(len(y) - 1, 1), 2), len(y)]  # an odd last sample belongs to the last piece
    count = len(edge) - 1
    before, after = list(range(-1, count)), list(range(1, count + 2))
    own = [residual(edge[piece], edge[piece + 1]) for piece in range(count)]
    cost = [residual(edge[left], edge[left + 2]) - own[left] - own[left + 1] for left in range(count - 1)]
    heap = [(value, left, left + 1) for left, value in enumerate(cost)]
    heapq.heapify(heap)
    alive, order = [True] * count, []
    while heap:
        value, left, right = heapq.heappop(heap)
        if not (alive[left] and alive[right]) or value != cost[left]:
            continue  # one of both has changed since
        order.append(edge[right])
        alive[right] = False
        own[left] += own[right] + value
        after[left] = after[right]
        before[after[right]] = left
        for first in (before[left], left):
            second = after[first] if first >= 0 else count
            if second < count:
                cost[first] = residual(edge[first], edge[after[second]]) - own[first] - own[second]
                heapq.heappush(heap, (cost[first], first, second))
    return np.array(order, np.int64)


def left_over(order: Ints, pieces: int) -> Ints:
    """Breaks of so many pieces, of the order of :func:`bottom_up`."""
    return np.sort(order[max(len(order) - pieces + 1, 0) :])


def optimal(y: Floats, penalty: float) -> Ints:
    """Breaks with the least sum of squared residuals and ``penalty`` for every piece: the true optimum.

    O(n^2) at worst. A start that can never be better again is dropped: what it costs without the penalty of another
    piece already exceeds the best.
    """
    sums, best = Sums(y), np.full(len(y) + 1, -penalty)
    origin = np.zeros(len(y) + 1, np.int64)
    starts = np.zeros(1, np.int64)
    for stop in range(1, len(y) + 1):
        value = best[starts] + sums.residual(starts, stop)
        least = int(value.argmin())
        best[stop], origin[stop] = value[least] + penalty, starts[least]
        starts = np.append(starts[value <= best[stop]], stop)
    breaks, stop = [], int(origin[len(y)])
    while stop > 0:
        breaks.append(stop)
        stop = int(origin[stop])
    return np.array(breaks[::-1], np.int64)


def sliding_window(y: Floats, tolerance: float) -> Ints:
    """Breaks of pieces that grow until the root mean square of their residuals would exceed the tolerance."""
    breaks, start = [], 0
    total = squares = moment = 0.0  # of the piece, values counted from its first sample
    for stop, value in enumerate(y.tolist()):
        n = stop - start
        if n == 0:
            origin, total, squares, moment = value, 0.0, 0.0, 0.0
            continue
        v, n = value - origin, n + 1
        total, squares, moment = total + v, squares + v * v, moment + (n - 1) * v
        about = moment - (n - 1) / 2 * total
        if squares - total * total / n - 12 * about * about / (n * (n * n - 1.0)) > tolerance * tolerance * n:
            breaks.append(stop)
            start, origin, total, squares, moment = stop, value, 0.0, 0.0, 0.0
    return np.array(breaks, np.int64)


def swing(y: Floats, bound: float) -> Approximation:
    """Connected lines, no sample farther than ``bound``: slopes that a line from the last end may have, until none is.

    The line taken has the slope with the least squares among those allowed.
    """
    values, origin, start, words = np.empty(len(y)), float(y[0]), 0, 0
    low, high = -np.inf, np.inf
    moment = spread = 0.0
    for now, value in enumerate(y.tolist()[1:], 1):
        n = now - start
        if value > origin + high * n + bound or value < origin + low * n - bound:
            origin = _swung(values, start, now, origin, _clipped(moment, spread, low, high))
            start, n, words = now - 1, 1, words + 1
            low, high, moment, spread = -np.inf, np.inf, 0.0, 0.0
        low, high = max(low, (value - bound - origin) / n), min(high, (value + bound - origin) / n)
        moment, spread = moment + n * (value - origin), spread + n * n
    _swung(values, start, len(y), origin, _clipped(moment, spread, low, high))
    return Approximation(values, words + 1)


def _swung(values: Floats, start: int, stop: int, origin: float, slope: float) -> float:
    """Write the line from ``start`` to before ``stop``; the value at its last sample."""
    values[start:stop] = origin + slope * np.arange(stop - start)
    return float(values[stop - 1])


def _clipped(moment: float, spread: float, low: float, high: float) -> float:
    return min(max(moment / spread, low), high) if spread else 0.0


def slide(y: Floats, bound: float) -> Approximation:
    """Lines that need not connect, no sample farther than ``bound``, each over as many samples as any line can reach.

    The steepest and the flattest line within the bounds are kept; where they cross, the slope with the least squares
    among those allowed is taken. (The published filter connects neighbours where that is possible, which changes
    neither the number of lines nor the bound.)
    """
    values, start, words = np.empty(len(y)), 0, 0
    while start < len(y):
        stop, line = _reach(y, start, bound)
        values[start:stop] = line
        start, words = stop, words + 1
    return Approximation(values, words)


def _reach(y: Floats, start: int, bound: float) -> tuple[int, Floats]:
    """How far one line gets from ``start``, and the line."""
    flat, steep = (0.0, 0.0), (0.0, 0.0)  # slope, and value at ``start``
    stop = start + 1
    for stop in range(start + 1, len(y)):
        n, value = stop - start, float(y[stop])
        if n == 1:
            flat = ((value - bound) - (y[start] + bound), y[start] + bound)
            steep = ((value + bound) - (y[start] - bound), y[start] - bound)
            continue
        below, above = flat[1] + flat[0] * n, steep[1] + steep[0] * n
        if value + bound < below or value - bound > above:
            break
        if value - bound > below:  # the flattest line must rise
            flat = _turned(y[start:stop] + bound, value - bound, n, largest=True)
        if value + bound < above:
            steep = _turned(y[start:stop] - bound, value + bound, n, largest=False)
    else:
        stop = len(y)
    return stop, _between(y[start:stop], flat, steep)


def _turned(limits: Floats, value: float, n: int, largest: bool) -> tuple[float, float]:
    """The extreme line through a limit of an earlier sample and ``value`` at sample n: slope, value at sample 0."""
    slopes = (value - limits) / (n - np.arange(n))
    slope = float(slopes.max() if largest else slopes.min())
    return slope, value - slope * n


def _between(y: Floats, flat: tuple[float, float], steep: tuple[float, float]) -> Floats:
    if len(y) < 3:
        return y
    time = np.arange(len(y))
    if steep[0] <= flat[0]:
        return np.asarray((flat[1] + steep[1] + (flat[0] + steep[0]) * time) / 2)
    cross = (flat[1] - steep[1]) / (steep[0] - flat[0])
    height = flat[1] + flat[0] * cross
    from_cross = time - cross
    slope = float(from_cross @ (y - height) / (from_cross @ from_cross))
    return np.asarray(height + min(max(slope, flat[0]), steep[0]) * from_cross)
