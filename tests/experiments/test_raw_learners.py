"""Learners on the raw wrench: what they see, what they must not see, and a slow second opinion on SAX words."""

from __future__ import annotations

import math
from collections import Counter

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.stats import norm

from experiments._lib import raw_learners as raw
from experiments._lib.benchmarks import Benchmark, segments
from rcbht_jax.features import Intervals
from rcbht_jax.learning import validation
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec

SIGNALS = hnp.arrays(np.float64, st.tuples(st.integers(1, 40), st.just(2)), elements=st.floats(-50, 50))


def items(lengths: list[int], classes: int = 2, dt: float = 0.005) -> LabelledIntervals:
    """One item per trial, classes in turn."""
    count = len(lengths)
    y = np.arange(count) % classes
    trial = np.array([f"t{i // classes}" for i in range(count)])
    end = np.array(lengths)
    spans = Intervals(np.arange(count), np.zeros(count, int), end, dt)
    return LabelledIntervals(tuple("abcd"[:classes]), y, trial, np.where(y < 0, "", "A"), (spans,), {})


def walks(count: int, samples: int = 300, seed: int = 0) -> list[np.ndarray]:
    """Items of two classes in turn: rising and falling, with noise and lengths of their own."""
    rng = np.random.default_rng(seed)
    return [
        np.linspace(0, 5 * (-1) ** i, samples + 10 * i)[:, None] * np.ones(6) + rng.normal(size=(samples + 10 * i, 6))
        for i in range(count)
    ]


@given(SIGNALS)
def test_resampling_keeps_ends_and_stays_inside(signal: np.ndarray) -> None:
    (found,) = raw.resampled([signal], 64)
    assert found.shape == (2, 64)
    np.testing.assert_array_equal(found[:, [0, -1]], signal[[0, -1]].T)
    assert (found.max(1) <= signal.max(0)).all()
    assert (found.min(1) >= signal.min(0)).all()


def test_resampling_of_a_line_is_the_line() -> None:
    line = np.arange(7.0)[:, None] * [[2.0, -3.0]]
    np.testing.assert_allclose(raw.resampled([line], 13)[0], np.linspace(line[0], line[-1], 13).T, atol=1e-12)


@given(SIGNALS, st.floats(-20, 20))
def test_statistics_are_finite_and_follow_an_offset(signal: np.ndarray, offset: float) -> None:
    first, second = raw.statistics([signal, signal + offset])
    assert first.size == 2 * 13
    assert np.isfinite(first).all()
    shift = (second - first).reshape(13, 2)
    moved = [0, *range(2, 11)]  # mean, quantiles, ends; not deviation, slope and roughness
    np.testing.assert_allclose(shift[moved], offset, atol=1e-9)
    np.testing.assert_allclose(np.delete(shift, moved, 0), 0, atol=1e-9)
    np.testing.assert_allclose(raw.statistics(raw.centred([signal]))[0][:2], 0, atol=1e-9)


def test_slope_is_the_rise_over_the_segment() -> None:
    (row,) = raw.statistics([np.linspace(1.0, 4.0, 51)[:, None]])
    assert row[-2] == pytest.approx(3.0)
    assert row[-1] == pytest.approx(3.0 / 50)


def slow_words(series: np.ndarray) -> Counter[int]:
    """SAX words of one resampled channel, letter by letter."""
    edges = [norm.ppf(k / raw.LETTERS) for k in range(1, raw.LETTERS)]
    words = []
    for start in range(len(series) - raw.WINDOW + 1):
        window = [float(v) for v in series[start : start + raw.WINDOW]]
        mean = sum(window) / len(window)
        width = max(math.sqrt(sum((v - mean) ** 2 for v in window) / len(window)), raw.FLAT)
        step = raw.WINDOW // raw.WORD
        parts = [sum(window[k * step : (k + 1) * step]) / step for k in range(raw.WORD)]
        letters = [sum((part - mean) / width > edge for edge in edges) for part in parts]
        words.append(sum(letter * raw.LETTERS**k for k, letter in enumerate(letters)))
    return Counter(word for k, word in enumerate(words) if k == 0 or word != words[k - 1])


def test_sax_words_are_those_found_letter_by_letter() -> None:
    parts = walks(2)
    bag = raw.sax_bag(parts).reshape(2, 6, -1)
    for item, channel in ((0, 0), (1, 3)):
        counts = slow_words(raw.resampled(parts)[item, channel])
        expected = np.zeros(raw.LETTERS**raw.WORD)
        expected[list(counts)] = list(counts.values())
        np.testing.assert_allclose(bag[item, channel], expected / expected.sum())


@settings(max_examples=10)
@given(st.floats(-100, 100), st.sampled_from([0.25, 2.0, 8.0]))
def test_sax_words_know_neither_offset_nor_size(offset: float, size: float) -> None:
    parts = walks(1)
    moved = [np.round(parts[0] * 2**10) / 2**10 * size + round(offset)]
    still = [np.round(parts[0] * 2**10) / 2**10]
    difference = np.abs(raw.sax_bag(moved) - raw.sax_bag(still)).reshape(6, -1).sum(1)
    assert difference.max() < 0.02  # a letter on an edge may fall either way by rounding


def test_probes_see_no_more_than_they_say() -> None:
    parts, facts = walks(12), items([300 + 10 * i for i in range(12)])
    train, test = np.arange(8), np.arange(8, 12)
    hidden = [np.concatenate([part[:200], part[200:] * -7]) for part in parts]
    late = [np.concatenate([part[:1], part[1:] + 99]) for part in parts]
    for probe, changed in ((raw.first_second, hidden), (raw.first_sample, late)):
        assert (probe(parts, facts)(train, test, 3)[0] == probe(changed, facts)(train, test, 3)[0]).all()


@pytest.mark.filterwarnings("ignore:h5py not installed")  # tslearn tells everybody
@pytest.mark.parametrize("learner", [raw.sax_words, raw.one_d_sax])
def test_a_test_item_does_not_change_another(learner: object) -> None:
    if learner is raw.one_d_sax:
        pytest.importorskip("tslearn")
    parts, facts = walks(12), items([300 + 10 * i for i in range(12)])
    train, test = np.arange(8), np.arange(8, 12)
    said = learner(parts, facts)(train, test, 0)[0]  # type: ignore[operator]
    assert (said == facts.y[test]).all()
    parts[11] = parts[11] * 1e3 + 500
    assert (learner(parts, facts)(train, test, 0)[0][:3] == said[:3]).all()  # type: ignore[operator]


def test_scores_by_folds_and_by_sessions() -> None:
    facts = items([100 + 50 * (i % 2) for i in range(20)])
    learner = validation.forest(facts.seconds, facts.y)
    by_folds = Benchmark(TaskSpec()).score(learner, facts, repeats=2, seed=0)
    assert (by_folds["accuracy"]["mean"], by_folds["accuracy"]["high"]) == (1, 1)
    assert by_folds["accuracy"]["low"] == round(wilson(len(set(facts.trial)), len(set(facts.trial)))[0], 4)
    facts.session[10:] = "B"
    across = Benchmark(TaskSpec(), ("A",), ("B",))
    assert [len(side) for side in across.splits(facts, 9, 0)[0][0]] == [10, 10]
    assert across.score(validation.majority(facts.y), facts, 1, 0)["accuracy"]["mean"] == 0.5


def test_segments_are_the_samples_of_both_arms(hiro_recordings: object) -> None:
    from experiments._lib.benchmarks import BENCHMARKS, items_of

    found = items_of(hiro_recordings, BENCHMARKS["SIM2 states"])  # type: ignore[arg-type]
    parts = segments(hiro_recordings, found)  # type: ignore[arg-type]
    right, left = found.intervals
    assert all(part.shape == (end - start, 12) for part, start, end in zip(parts, right.start, right.end, strict=True))
    wrench = hiro_recordings.wrench  # type: ignore[attr-defined]
    np.testing.assert_array_equal(parts[5][:, 6:], wrench[left.recording[5], left.start[5] : left.end[5]])
