"""Points of the curves: right where the answer is known; curves are compared where they are comparable."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from experiments._lib import piecewise, symbolic
from experiments.words import rate_distortion as rate
from experiments.words.sets import Part, spread
from rcbht_jax.types import Recordings

EDGES = (0, 100, 160, 300, 400)  # on windows of 5 and 20


def signal(noise: float = 0.0) -> np.ndarray:
    """Two axes: rest, a ramp, a level, a ramp after a jump; and the same, smaller and upside down."""
    ramps = [np.zeros(100), np.arange(60) * 0.5, np.full(140, 30.0), 10 - np.arange(100) * 0.2]
    y = np.concatenate(ramps) + noise * np.random.default_rng(0).normal(size=400)
    return np.stack([y, -0.1 * y], 1)


@pytest.fixture
def data() -> Part:
    return Part(Recordings.from_arrays([signal(), signal()[:300]], rate=200), hiro=True)


def points(curve: rate.Curve, data: Part) -> list[dict[str, Any]]:
    return [rate.point(at, sums, data.seconds) for at, sums in curve]


def test_lines_of_a_signal_made_of_lines_leave_nothing(data: Part) -> None:
    curve = points(rate.fit(data, small=False), data)
    fine = next(found for found in curve if found["at"] == "tolerance x0.25")
    assert max(fine["residual by axis"]) < 1e-4
    assert fine["words per second by axis"] == pytest.approx([7 / 3.5] * 2)
    best = points(rate.optimum(data), data)[0]
    assert best["words per second"] == pytest.approx(2.0)
    assert best["residual"] < 1e-9
    merged = points(rate.bottom_up(data, small=False), data)
    assert [found["words per second by axis"] for found in merged] == [
        found["words per second by axis"] for found in curve
    ]


def test_residual_is_pooled_over_recordings(data: Part) -> None:
    """Levels in place of the signal: what a window of all samples leaves is all that there is about the mean."""
    levels = [[piecewise.Approximation(np.full_like(y, y.mean() + 1), 3) for y in row] for row in data.signals]
    found = points([rate.of_approximations(data, "mean", levels)], data)[0]
    total = [sum(((row[axis] - row[axis].mean()) ** 2).sum() for row in data.signals) for axis in range(2)]
    assert found["residual by axis"] == pytest.approx([1 + 700 / value for value in total], rel=1e-3)
    assert found["words per second"] == pytest.approx(6 / 3.5, rel=1e-3)


def test_a_rule_is_measured_as_an_approximation_is(data: Part) -> None:
    """The fit rule's residual against that of least-squares lines through the samples of its words."""
    noisy = Part(Recordings.from_arrays([signal(1.0), signal(0.5)[:300]], rate=200), hiro=True)
    track = noisy.words("fit", 5, noisy.tolerance).primitive
    ends, used = np.asarray(track.t1, np.int64), np.asarray(track.label) > 0
    rows = [
        [piecewise.lines(y, ends[row, axis][used[row, axis]][:-1]) for axis, y in enumerate(signals)]
        for row, signals in enumerate(noisy.signals)
    ]
    both = [rate.of_approximations(noisy, "", rows), rate.of_rule(noisy, "fit", "", 5, noisy.tolerance)]
    expected, found = points(both, noisy)
    assert found["words per second by axis"] == expected["words per second by axis"]
    assert found["residual by axis"] == pytest.approx(expected["residual by axis"], rel=1e-2)


@pytest.mark.parametrize("method", ["sliding window", "swing filter", "slide filter", "equal windows"])
def test_curves_go_down(method: str) -> None:
    data = Part(Recordings.from_arrays([signal(1.0)], rate=200), hiro=True)
    curve = points(rate.METHODS[method](data), data)
    assert len(curve) >= 4
    ends = [curve[0], curve[-1]]
    few, many = sorted(ends, key=lambda found: found["words per second"])
    assert few["words per second"] < many["words per second"]
    assert many["residual"] < few["residual"]


def test_every_method_has_its_kind() -> None:
    assert set(rate.METHODS) == set(rate.KINDS)


def test_rates_are_interpolated_where_a_curve_passes() -> None:
    assert rate.needed([(1, 0.1), (4, 0.001)], 0.01) == pytest.approx(2)
    assert rate.needed([(4, 0.001), (2, 0.3), (1, 0.1)], 0.01) == pytest.approx(2)  # a worse point does not count
    assert rate.needed([(1, 0.1), (4, 0.02)], 0.01) is None
    assert rate.needed([(1, 0.005), (4, 0.001)], 0.01) is None
    assert rate.needed([(1, 0.1), (4, 0.0)], 0.01) is not None


def test_rates_vary_with_the_recordings() -> None:
    """Two points at residuals of .1 and .001: half of the recordings need 2 words a second for .01, half need 6."""
    words = np.array([[[1.0], [3.0]] * 6, [[4.0], [12.0]] * 6])  # of a second each, [point, recording, axis]
    left = np.broadcast_to(np.array([0.1, 0.001])[:, None, None], words.shape)
    curve = [("", np.stack([one, missed, np.ones_like(one)])) for one, missed in zip(words, left, strict=True)]
    low, high = rate.needed_by_chance(curve, np.ones(12), 0.01) or [0.0, 0.0]
    assert 2 < low < 3.6 < 4.4 < high < 6
    mean = rate.rates(curve[0][1].sum(1), 12.0)
    assert [each.tolist() for each in mean] == [[2.0], [pytest.approx(0.1)]]
    assert rate.needed_by_chance(curve, np.ones(12), 0.5) is None


def test_recordings_are_taken_from_first_to_last() -> None:
    many = Recordings.from_arrays([np.full((10, 1), float(n)) for n in range(11)], rate=100)
    assert spread(many, 3).wrench[:, 0, 0].tolist() == [0, 5, 10]
    assert len(spread(many, 30)) == 11


@pytest.mark.parametrize("slopes", [False, True])
def test_symbols_of_windows_come_back(slopes: bool) -> None:
    pytest.importorskip("tslearn")
    y = signal()[:, 0]
    found = symbolic.sax(y, 20, float(y.mean()), float(y.std()), slopes)
    assert found.values.shape == y.shape
    assert 3 <= found.words <= 20
    left = ((found.values - y) ** 2).sum() / ((y - y.mean()) ** 2).sum()
    assert left < 0.05
    still = symbolic.sax(np.ones(50), 20, 0.0, 1.0, slopes)  # not a multiple of the window
    assert (still.words, still.values.shape) == (1, (50,))


@pytest.mark.parametrize(
    "make", [symbolic.abba_chain, lambda y, tolerance: symbolic.fabba(y, tolerance, 0.01)], ids=["chain", "symbols"]
)
def test_chains_pass_through_samples(make: Callable[[np.ndarray, float], piecewise.Approximation]) -> None:
    pytest.importorskip("fABBA")
    y = signal()[:, 0]
    found = make(y, 0.01)
    assert found.words == 5  # the jump is a piece
    np.testing.assert_allclose(found.values, y, atol=0.5)
    assert make(np.ones(1), 0.1).words == 1


def test_words_of_sfa_do_not_know_how_large_the_signal_was() -> None:
    dictionary = pytest.importorskip("aeon.transformations.collection.dictionary_based")
    x = np.random.default_rng(0).normal(size=(30, 1, 20))
    machine = dictionary.SFA(word_length=8, alphabet_size=4, window_size=20, save_words=True).fit(x)
    np.testing.assert_allclose(machine.transform_mft(x[:, 0]), machine.transform_mft(10 * x[:, 0]), rtol=1e-5)
