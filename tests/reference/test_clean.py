"""The clean mode: for every fix, a case in which the reference gives something else."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.labels import LLB, Primitive
from rcbht_jax.reference import behaviour_filter, encode, limits, motion, motion_filter, primitives, rows, sample_times
from rcbht_jax.reference.segment import raw_primitives
from rcbht_jax.reference.versions import VERSIONS
from tests.support.reference_cases import behaviour_row, motion_rows, primitive_row

HIRO = (70.0, 46.0, 23.0, 1.0)


def test_q2_domain_does_not_depend_on_an_offset() -> None:
    wrench = np.random.default_rng(0).normal(size=(100, 6))
    np.testing.assert_allclose(limits.domain(wrench + 50, True), limits.domain(wrench, True))
    assert np.all(limits.domain(wrench + 50) > 90)


def test_q4_calibrated_limits_leave_forces_and_stay_proportional() -> None:
    small = np.ones(6)
    reference, clean = limits.calibrated(small), limits.calibrated(small, clean=True)
    np.testing.assert_allclose(clean[:3], limits.CALIBRATED[:3])
    np.testing.assert_allclose(clean[3:], limits.CALIBRATED[3:] / 10)
    np.testing.assert_allclose(reference[:, 0], limits.CALIBRATED[:, 0] / 10)
    np.testing.assert_allclose(reference[:, 3], limits.CALIBRATED[:, 3])
    np.testing.assert_allclose(np.diff(reference, 2), 0, atol=1e-12)


def test_q5_minus_the_impulse_limit_is_an_impulse() -> None:
    assert limits.classify(-70.0, HIRO, clean=True) is Primitive.NIMP


def test_q7_segments_are_fitted_to_their_own_samples() -> None:
    time = np.round(np.arange(60) * 0.005, 6)
    values = np.where(np.arange(60) <= 30, 0.0, 50.0)
    values[:31] += 20 * time[:31]
    reference, _ = raw_primitives(time, values, HIRO)
    clean, _ = raw_primitives(time, values, HIRO, clean=True)
    assert clean[0][3:5] == reference[0][3:5]
    assert clean[0][5] == pytest.approx(20)
    assert reference[0][5] > 40


def test_q7_no_segment_without_length() -> None:
    time = np.round(np.arange(60) * 0.005, 6)
    values = np.where(np.arange(60) % 2 == 0, 1.0, -1.0)
    starts = [[row[3] for row in raw_primitives(time, values, HIRO, clean=clean)[0]] for clean in (False, True)]
    assert starts[0].count(0.025) == 2
    assert starts[1].count(0.025) == 1


def test_q9_long_runs_have_the_mean_of_their_members() -> None:
    table = [primitive_row(k, k + 1, 0, 6, 3, slope=6) for k in range(3)]
    (row,) = primitives.merge_repeats(table, clean=True)
    assert (row[0], row[5]) == (3.0, 6.0)


def test_q14_a_single_composition_has_its_own_amplitude() -> None:
    table = [primitive_row(0, 1, 0, 1, 1), primitive_row(1, 2, 0, 9, 1)]
    assert motion.compose_motions(table)[0][3] == 9
    assert motion.compose_motions(table, clean=True)[0][3] == 1


def test_q15_closeness_does_not_depend_on_the_sign_of_the_axis() -> None:
    assert rows.near(1.0, 1.9, 0.5)
    assert not rows.near(-1.0, -1.9, 0.5)
    assert rows.near(-1.0, -1.9, 0.5, clean=True)


def test_q15_reaches_the_passes() -> None:
    for start, clean, count in ((0, False, 2), (0, True, 1)):
        table = motion_rows("a i")
        table[0][1], table[1][1] = -1.0, -1.9
        assert len(motion_filter.merge_into_adjustments(table, start, clean)) == count
    both = [motion_rows("a a k k") for _ in range(2)]
    for table in both:
        table[0][1], table[1][1] = -1.0, -1.9
    assert len(motion_filter.merge_adjustments(both[0], 0, np.inf, False)) == 4
    assert len(motion_filter.merge_adjustments(both[1], 0, np.inf, True)) == 3


@pytest.mark.parametrize(("averages", "amplitudes"), [((9.0, 20.0), (1.0, 1.0)), ((9.0, 9.0), (1.0, 90.0))])
def test_q19_push_beside_pull_must_be_alike(averages: tuple[float, float], amplitudes: tuple[float, float]) -> None:
    push, pull = (
        behaviour_row(label, 0, 1, avg=average, amp=amplitude)
        for label, average, amplitude in zip((LLB.PS, LLB.PL), averages, amplitudes, strict=True)
    )
    assert behaviour_filter.push_and_pull(push, pull)
    assert not behaviour_filter.push_and_pull(push, pull, clean=True)
    assert behaviour_filter.push_and_pull(push, [float(LLB.PL), *push[1:]], clean=True)


def test_q19_increase_beside_decrease_must_have_like_amplitudes() -> None:
    for clean, count in ((False, 1), (True, 2)):
        table = motion_rows("i d")
        table[1][3] = 90.0
        assert len(motion_filter.merge_into_constants(table, 0, clean)) == count


def test_q26_push_before_alignment_merges_like_alignment_before_push() -> None:
    pair = [behaviour_row(LLB.PS, 0, 1), behaviour_row(LLB.AL, 1, 2)]
    assert not behaviour_filter.adjusted(*pair)
    assert behaviour_filter.adjusted(*pair, clean=True)
    assert behaviour_filter.adjusted(*pair[::-1])


def test_clean_averages_stay_between_the_extremes() -> None:
    wrench = np.cumsum(np.random.default_rng(3).normal(size=(1500, 6)), axis=0) + 20
    time, onset = sample_times(1500, 0.005), [0.0, 1.0, 3.0, 5.0]
    inside = {}
    for clean in (False, True):
        table = np.concatenate(encode(time, wrench, onset, clean=clean).prim)
        inside[clean] = np.mean((table[:, 0] <= table[:, 1]) & (table[:, 0] >= table[:, 2]))
    assert inside[False] < 1.0
    assert inside[True] == 1.0


def test_clean_limits_do_not_depend_on_an_offset() -> None:
    wrench = np.random.default_rng(5).normal(scale=0.1, size=(300, 6)) + 9
    time = sample_times(300, 0.005)
    applied = {clean: encode(time, wrench, [0.0, 1.0], clean=clean).thresholds for clean in (False, True)}
    np.testing.assert_allclose(applied[False][3:, 0], 70)
    np.testing.assert_allclose(applied[True][3:, 0], 7)


def test_every_version_has_a_clean_mode() -> None:
    wrench = np.cumsum(np.random.default_rng(4).normal(size=(900, 6)), axis=0)
    for version in VERSIONS:
        labels = encode(sample_times(900, 0.005), wrench, [0.0, 1.0, 2.0], version=version, clean=True)
        assert (labels.version, labels.clean) == (version, True)
        assert all(len(table) for table in labels.llb)
