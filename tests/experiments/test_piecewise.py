"""Lines for a signal: exact where the signal is made of lines, within their bound, and never better than the best."""

from __future__ import annotations

from itertools import combinations, pairwise

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from experiments._lib import piecewise

SIGNALS = hnp.arrays(np.float64, st.integers(1, 60), elements=st.floats(-20, 20, width=16))
BOUNDS = st.floats(0.05, 5)


def missed(y: piecewise.Floats, breaks: piecewise.Ints) -> float:
    return float(((piecewise.lines(y, breaks).values - y) ** 2).sum())


def by_polyfit(y: piecewise.Floats, edges: list[int]) -> piecewise.Floats:
    parts = [y[a:b] for a, b in pairwise(edges)]
    fits = [np.polyval(np.polyfit(np.arange(len(p)), p, 1), np.arange(len(p))) if len(p) > 1 else p for p in parts]
    return np.concatenate(fits)


@given(SIGNALS, st.data())
@settings(max_examples=40, deadline=None)
def test_lines_are_those_of_polyfit(y: piecewise.Floats, data: st.DataObject) -> None:
    breaks = sorted(data.draw(st.sets(st.integers(1, max(len(y) - 1, 1)), max_size=len(y) - 1)))
    found = piecewise.lines(y, np.array(breaks, np.int64))
    assert found.words == len(breaks) + 1
    np.testing.assert_allclose(found.values, by_polyfit(y, [0, *breaks, len(y)]), atol=1e-6)


def pieces() -> tuple[piecewise.Floats, list[int]]:
    """A rest, a ramp, a jump to another ramp."""
    return np.concatenate([np.zeros(20), np.arange(1, 17) * 0.5, 40 - np.arange(24) * 0.3]), [20, 36]


def test_every_method_finds_the_lines_that_a_signal_is_made_of() -> None:
    y, breaks = pieces()
    assert piecewise.optimal(y, 1e-3).tolist() in (breaks, [19, 36])  # sample 19 lies on both lines
    assert piecewise.left_over(piecewise.bottom_up(y), 3).tolist() == [20, 36]
    assert piecewise.sliding_window(y, 1e-3).tolist() == [20, 36]
    assert piecewise.slide(y, 1e-6).words == 3
    assert piecewise.swing(y, 1e-6).words == 4  # a connected line crosses the jump
    np.testing.assert_allclose(piecewise.slide(y, 1e-6).values, y, atol=2e-6)
    np.testing.assert_allclose(piecewise.lines(y, np.array(breaks)).values, y, atol=1e-9)


@given(SIGNALS, BOUNDS)
@settings(max_examples=80, deadline=None)
def test_filters_keep_their_bound(y: piecewise.Floats, bound: float) -> None:
    for found in (piecewise.swing(y, bound), piecewise.slide(y, bound)):
        assert np.abs(found.values - y).max() <= bound * (1 + 1e-9) + 1e-9
        assert 1 <= found.words <= len(y)


@given(SIGNALS, BOUNDS)
@settings(max_examples=20, deadline=None)
def test_a_slid_line_ends_only_where_no_line_goes_on(y: piecewise.Floats, bound: float) -> None:
    """The half-planes of all samples have a common point, by a linear program; with one sample more they have none."""
    from scipy.optimize import linprog

    def possible(part: piecewise.Floats, within: float) -> bool:
        a = np.stack([np.ones(len(part)), np.arange(len(part))], 1)
        limits = np.concatenate([part + within, within - part])
        return bool(linprog([0, 0], np.concatenate([a, -a]), limits, bounds=(None, None)).status == 0)

    stop, _ = piecewise._reach(y, 0, bound)
    assert possible(y[:stop], bound + 1e-6)
    assert stop == len(y) or not possible(y[: stop + 1], bound - 1e-6)


@given(hnp.arrays(np.float64, st.integers(1, 8), elements=st.integers(-5, 5)), st.floats(0.1, 30))
@settings(max_examples=30, deadline=None)
def test_the_optimum_is_that_of_all_partitions(y: piecewise.Floats, penalty: float) -> None:
    inner = range(1, len(y))
    costs = [
        ((by_polyfit(y, [0, *breaks, len(y)]) - y) ** 2).sum() + penalty * len(breaks)
        for count in range(len(y))
        for breaks in combinations(inner, count)
    ]
    found = piecewise.optimal(y, penalty)
    assert missed(y, found) + penalty * len(found) == pytest.approx(min(costs), abs=1e-6)


def test_the_optimum_is_that_of_ruptures() -> None:
    ruptures = pytest.importorskip("ruptures")
    rng = np.random.default_rng(0)
    y = pieces()[0] + rng.normal(0, 0.3, 60)

    class Lines(ruptures.base.BaseCost):  # type: ignore[misc, name-defined]
        model, min_size = "lines", 1

        def fit(self, signal: piecewise.Floats) -> Lines:
            self.signal = signal
            return self

        def error(self, start: int, end: int) -> float:
            part = self.signal[start:end, 0]
            return float(((by_polyfit(part, [0, len(part)]) - part) ** 2).sum())

    for penalty in (0.5, 2.0, 20.0):
        pelt = ruptures.Pelt(custom_cost=Lines(), min_size=1, jump=1).fit(y[:, None])
        assert piecewise.optimal(y, penalty).tolist() == pelt.predict(pen=penalty)[:-1]


def test_nothing_is_better_than_the_optimum_with_as_many_lines() -> None:
    rng = np.random.default_rng(1)
    y = pieces()[0] + rng.normal(0, 0.5, 60)
    order = piecewise.bottom_up(y)
    assert sorted(order) == list(range(2, 60, 2))
    for penalty in (0.3, 1.0, 5.0, 50.0):
        best = piecewise.optimal(y, penalty)
        assert missed(y, best) <= missed(y, piecewise.left_over(order, len(best) + 1)) + 1e-9
    losses = [missed(y, piecewise.left_over(order, count)) for count in range(1, 31)]
    assert np.all(np.diff(losses) <= 1e-9)


@given(SIGNALS)
@settings(max_examples=15, deadline=None)
def test_merging_takes_the_cheapest_pair_each_time(y: piecewise.Floats) -> None:
    order = piecewise.bottom_up(y).tolist()
    left = [*range(2, len(y) - 1, 2)]
    for given_up in order:
        losses = {at: missed(y, np.array([b for b in left if b != at])) for at in left}
        assert losses[given_up] <= min(losses.values()) + 1e-6
        left.remove(given_up)
    assert not left


@given(SIGNALS, BOUNDS)
@settings(max_examples=60, deadline=None)
def test_a_window_slides_as_far_as_its_tolerance_allows(y: piecewise.Floats, tolerance: float) -> None:
    edges = [0, *piecewise.sliding_window(y, tolerance).tolist(), len(y)]
    for start, stop in pairwise(edges):
        line = by_polyfit(y[start:stop], [0, stop - start])
        assert ((line - y[start:stop]) ** 2).mean() <= tolerance**2 + 1e-6
        if stop < len(y):
            longer = by_polyfit(y[start : stop + 1], [0, stop + 1 - start])
            assert ((longer - y[start : stop + 1]) ** 2).mean() > tolerance**2 - 1e-6
