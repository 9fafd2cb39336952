"""Lower half of the offline taxonomy: arithmetic, thresholds, segmentation, primitive filter."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.labels import Primitive
from rcbht_jax.reference import limits, primitives, rows
from rcbht_jax.reference.segment import raw_primitives
from tests.support.reference_cases import primitive_row

HIRO = (70.0, 46.0, 23.0, 1.0)
numbers = st.floats(-50, 50).map(lambda value: round(value, 3))


# --- arithmetic -------------------------------------------------------------------------------------------


def test_division_by_zero_follows_the_standard() -> None:
    assert rows.ratio(1.0, 0.0) == math.inf
    assert rows.ratio(-1.0, 0.0) == -math.inf
    assert math.isnan(rows.ratio(0.0, 0.0))
    assert not rows.unusable(math.nan)
    assert not rows.outside(math.nan, 0.2, 5.0)


@given(numbers, numbers, st.sampled_from([0.5, 0.75, 1.0, 1.5]))
def test_near_is_the_printed_inequality(x: float, y: float, tolerance: float) -> None:
    assert rows.near(x, y, tolerance) == (abs(abs(x) - abs(y)) <= tolerance * abs(max(x, y)))


@given(st.floats(0, 50), st.floats(0, 50))
def test_the_wide_tolerances_are_vacuous_for_amplitudes(x: float, y: float) -> None:
    assert rows.near(x, y, 1.0)
    assert rows.near(x, y, 1.5)


def test_compacting_keeps_a_single_row() -> None:
    assert rows.compact([[0.0, 0.0]]) == [[0.0, 0.0]]
    assert rows.compact([[0.0, 0.0], [1.0, 0.0]]) == [[1.0, 0.0]]


# --- thresholds -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("slope", "label"),
    [
        (70.0, Primitive.PIMP),
        (46.0, Primitive.BPOS),
        (23.0, Primitive.MPOS),
        (1.0, Primitive.SPOS),
        (0.99, Primitive.CONS),
        (0.0, Primitive.CONS),
        (-0.99, Primitive.CONS),
        (-1.0, Primitive.SNEG),
        (-23.0, Primitive.MNEG),
        (-46.0, Primitive.BNEG),
        (-69.9, Primitive.BNEG),
        (-70.1, Primitive.NIMP),
    ],
)
def test_classification_at_the_limits(slope: float, label: Primitive) -> None:
    assert limits.classify(slope, HIRO) is label


def test_moments_of_small_domain_get_a_tenth_of_the_limits() -> None:
    extent = np.array([1.0, 5.0, 5.0, 1.0, 1.9, 5.0])
    applied = limits.hand_set(extent, "hiro")
    np.testing.assert_allclose(applied[:, 0], [70, 70, 70, 7, 70, 70])
    np.testing.assert_allclose(limits.hand_set(extent, "pa10")[:, 0], 1000)


def test_spectrum_is_evenly_spaced() -> None:
    np.testing.assert_allclose(limits.spectrum(10.0, 1.0), [10, 7, 4, 1])


# --- segmentation -----------------------------------------------------------------------------------------


def _oracle(time: np.ndarray, values: np.ndarray) -> list[tuple[float, float, float, float, float]]:
    """Section 4 word by word with a library fit: max, min, start, end, slope; counted from one."""
    n, s, i, found = len(time), 1, 1, []
    while True:
        e = min(i + 5, n)
        t, y = time[s - 1 : e], values[s - 1 : e]
        slope, intercept = np.polyfit(t, y, 1)
        fitted = slope * t + intercept
        if i + 5 > n:
            found.append((y.max(), y.min(), t[0], t[-1], slope))
            return found
        sse, sst = np.sum((y - fitted) ** 2), np.sum((y - y.mean()) ** 2)
        sse, sst = (0.0 if part < 1e-4 else part for part in (sse, sst))
        if sst == 0 or 1 - sse / sst > 0.90:
            i += 5
            continue
        cut = e if i == 1 else i
        kept = fitted[: cut - s + 1]
        end = time[cut - 1] if cut > s else 1.05 * time[s - 1]
        found.append((kept.max(), kept.min(), t[0], end, slope))
        s, i = cut, i + 5


@given(st.integers(0, 10**6), st.integers(12, 300), st.sampled_from([1e-4, 0.01, 0.3, 5.0]))
def test_segments_equal_a_brute_force_fit(seed: int, n: int, noise: float) -> None:
    generator = np.random.default_rng(seed)
    slopes = generator.choice([-80, -30, -5, 0, 0, 5, 30, 80], size=n // 20 + 1)
    values = np.cumsum(np.repeat(slopes, 20)[:n]) * 0.005 + generator.normal(scale=noise, size=n)
    time = np.arange(n) * 0.005
    table, filtered = raw_primitives(time, values, HIRO)
    assert filtered
    expected = _oracle(time, values)
    np.testing.assert_allclose([row[1:6] for row in table], expected, rtol=1e-6, atol=1e-6)
    for row in table:
        assert row[0] == (row[1] + row[2]) / 2
        assert row[6] == limits.classify(row[5], HIRO)


def test_the_guarded_decision_survives_a_large_offset() -> None:
    generator = np.random.default_rng(1)
    values = generator.normal(size=600)
    time = np.arange(600) * 0.005
    plain, _ = raw_primitives(time, values, HIRO)
    shifted, _ = raw_primitives(time, values + 1e5, HIRO)
    np.testing.assert_allclose([row[3:] for row in shifted], [row[3:] for row in plain], rtol=1e-4, atol=1e-4)


def test_a_quiet_signal_is_one_segment_unless_the_floor_is_lower() -> None:
    time = np.arange(400) * 0.005
    values = 1e-4 * np.sin(40 * time)
    assert len(raw_primitives(time, values, HIRO)[0]) == 1
    assert len(raw_primitives(time, values, HIRO, floor=0.0)[0]) > 10


def test_a_constant_signal_is_accepted_without_any_floor() -> None:
    table, _ = raw_primitives(np.arange(100) * 0.005, np.full(100, 3.0), HIRO, floor=0.0)
    assert [row[3:5] for row in table] == [[0.0, 99 * 0.005]]


def test_a_rejected_second_window_gives_a_stretched_segment() -> None:
    time = np.round(np.arange(60) * 0.005, 6)
    values = np.where(np.arange(60) % 2 == 0, 1.0, -1.0)
    table, _ = raw_primitives(time, values, HIRO)
    assert table[0][3:5] == [0.0, 0.025]
    assert table[1][3:5] == [0.025, 1.05 * 0.025]


def test_old_ending_loses_tail_and_filter_of_5m_plus_1_samples() -> None:
    values = np.concatenate([np.zeros(40), np.linspace(0, 30, 61)])
    time = np.arange(len(values)) * 0.005
    table, filtered = raw_primitives(time, values, HIRO, old_ending=True)
    assert not filtered
    assert table[-1][4] < time[-1]
    table, filtered = raw_primitives(time[:-2], values[:-2], HIRO, old_ending=True)
    assert filtered
    assert table[-1][4] == time[-3]


# --- primitive filter -------------------------------------------------------------------------------------


def test_a_pair_of_repeats_is_averaged_and_a_longer_run_divided_by_one_too_few() -> None:
    table = [primitive_row(k, k + 1, 0, 6, 3, slope=6.0) for k in range(3)]
    pair = primitives.merge_repeats([row[:] for row in table[:2]])
    assert pair == [[3.0, 6, 0, 0, 2, 6.0, 3.0]]
    run = primitives.merge_repeats([row[:] for row in table])
    assert run == [[4.5, 6, 0, 0, 3, 9.0, 3.0]]


@given(st.lists(st.integers(1, 9), min_size=1, max_size=30))
def test_merged_repeats_never_repeat_and_keep_the_span(labels: list[int]) -> None:
    table = [primitive_row(k, k + 1, k, k + 2, label) for k, label in enumerate(labels)]
    merged = primitives.merge_repeats(table)
    assert all(p[6] != q[6] for p, q in pairwise(merged))
    assert (merged[0][3], merged[-1][4]) == (0, len(labels))
    assert max(row[1] for row in merged) == len(labels) + 1


def test_the_much_longer_primitive_absorbs_the_shorter() -> None:
    long, short = primitive_row(0, 1.0, 0, 2, 1), primitive_row(1.0, 1.1, 0, 2, 4)
    assert primitives.merge_short([long[:], short[:]])[0][3:7:3] == [0, 1.0]
    short, long = primitive_row(0, 0.1, 0, 2, 1), primitive_row(0.1, 1.2, 0, 2, 4)
    assert primitives.merge_short([short[:], long[:]])[0][3:7:3] == [0, 4.0]


@pytest.mark.parametrize(
    ("first", "second", "merged"),
    [
        (Primitive.PIMP, Primitive.CONS, False),
        (Primitive.CONS, Primitive.PIMP, True),  # only the left primitive is protected (Q10)
    ],
)
def test_impulses_are_protected_on_the_left(first: Primitive, second: Primitive, merged: bool) -> None:
    table = [primitive_row(0, 1.0, 0, 2, first), primitive_row(1.0, 1.1, 0, 2, second)]
    assert (len(primitives.merge_short(table)) == 1) is merged


def test_spans_of_different_size_do_not_merge() -> None:
    table = [primitive_row(0, 1.0, 0, 2, 1), primitive_row(1.0, 1.1, 0, 4.1, 4)]
    assert len(primitives.merge_short(table)) == 2


def test_unlabelled_slope_is_reported() -> None:
    with pytest.raises(InputError, match="minus the impulse limit"):
        limits.classify(-70.0, HIRO)
