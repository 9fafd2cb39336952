"""Upper half of the offline taxonomy, pass by pass: motion compositions and low-level behaviours."""

from __future__ import annotations

import math

import pytest

from rcbht_jax.labels import LLB, MC, Primitive
from rcbht_jax.reference import behaviour_filter, behaviours, motion, motion_filter
from rcbht_jax.reference.versions import VERSIONS
from tests.support.reference_cases import behaviour_row, motion_row, motion_rows, primitive_row


def _labels(table: list[list[float]]) -> list[float]:
    return [row[0] for row in table]


# --- motion compositions ----------------------------------------------------------------------------------

_TABLE = """
P: i/span/own  a/full/own  i/span/7  pc/span/8  nc/span/9
N: a/span/own  d/full/own  d/full/7  pc/full/8  nc/full/9
C: i/span/2  d/full/5  k/full/7  pc/full/8  nc/full/9
+: pc/span/2  c/full/5  pc/span/7  pc/span/2  c/full/9
-: c/span/2  nc/full/5  nc/full/7  c/span/8  nc/full/9
"""


def test_pairs_follow_the_printed_table() -> None:
    members = {"P": 1, "N": 4, "C": 7, "+": 8, "-": 9}
    for line in _TABLE.strip().splitlines():
        first, cells = line.split(":")
        for second, cell in zip(members, cells.split(), strict=True):
            label, formula, tag = cell.split("/")
            i = primitive_row(0, 1, 1.0, 3.0, members[first])
            j = primitive_row(1, 2, 0.5, 2.0, members[second])
            (row, *_) = motion.compose_motions([i, j])
            assert row[0] == MC[label.upper()], (first, second)
            assert row[3] == (abs(2.0 - 1.0) if formula == "span" else 3.0 - 0.5), (first, second)
            assert row[5] == (members[second] if tag == "own" else int(tag)), (first, second)
            assert row[4] == members[first]
            assert row[6:] == [0, 1, 1, 2, 1]


def test_the_last_primitive_is_paired_with_itself() -> None:
    (row,) = motion.compose_motions([primitive_row(0, 1, 0, 2, Primitive.PIMP)])
    assert row[0] == MC.PC
    assert row[4:6] == [Primitive.PIMP, Primitive.MPOS]
    assert row[6:10] == [0, 1, 0, 1]


def test_incompatible_primitives_stay_single_with_the_amplitude_of_the_pair() -> None:
    table = [primitive_row(0, 1, 0, 1, 1), primitive_row(1, 2, 0, 9, 1)]
    first, second = motion.compose_motions(table)
    assert first[:6] == [MC.I, 0.5, 1, 9, 1, 1]
    assert first[6:] == [0, 0, 1, 1, 0.5]
    assert second[3] == 9


# --- filter of motion compositions ------------------------------------------------------------------------


MASTER = VERSIONS["master"]


def test_adjustment_runs_merge_when_another_label_follows() -> None:
    merged = motion_filter.merge_adjustments(motion_rows("a a a k k"), 0, math.inf, clean=False)
    assert _labels(merged) == [MC.A, MC.K, MC.K]
    assert merged[0][6:] == pytest.approx([0, 3 / 2 - 0.002, 3 / 2 - 0.001, 3, 1.5])
    # The end is looked for between the two rows after the pair: here it cuts the run before its last row.
    far = motion_rows("a a a k k")
    far[3][1] = 100.0
    merged = motion_filter.merge_adjustments(far, 0, math.inf, clean=False)
    assert _labels(merged) == [MC.A, MC.A, MC.K, MC.K]
    # A run at the end of the table is never merged.
    assert len(motion_filter.merge_adjustments(motion_rows("k a a a"), 0, math.inf, clean=False)) == 4


def test_gated_versions_leave_late_adjustments() -> None:
    bounds = motion_filter.boundaries([0.0, 0.0, 1.0, 2.0, 9.0], VERSIONS["a642c8b"])
    assert bounds.gate == 2.0 - 0.002
    late = motion_rows("k k a a a k k")
    assert len(motion_filter.merge_adjustments(late, 0, bounds.gate, clean=False)) == 7
    assert motion_filter.boundaries([0.0, 1.0, 5.0], VERSIONS["a642c8b"]).gate == 5.0
    assert motion_filter.boundaries([0.0, 1.0], VERSIONS["a1ca1d1"]).gate == 1.0
    assert motion_filter.boundaries([0.0, 1.0], MASTER).gate == math.inf


def test_start_row() -> None:
    table = motion_rows("k i d k")
    row = {
        key: motion_filter.start_row(table, motion_filter.Boundaries(99.0, math.inf), version)
        for key, version in VERSIONS.items()
    }
    assert row == {"master": 3, "a642c8b": 3, "a1ca1d1": 3, "wip": 3}
    assert motion_filter.start_row(table, motion_filter.Boundaries(1.0, math.inf), MASTER) == 1
    early = [motion_row(MC.K, (0, 0.1, 0.1, 0.2))] * 4
    assert motion_filter.start_row(early, motion_filter.Boundaries(9.0, math.inf), VERSIONS["a1ca1d1"]) == 0
    assert motion_filter.start_row(early, motion_filter.Boundaries(9.0, math.inf), MASTER) == 3


def test_repeats_merge_except_adjustments() -> None:
    merged = motion_filter.merge_repeats(motion_rows("k k i i i a a"))
    assert [row[0] for row in merged] == [MC.K, MC.I, MC.A, MC.A]
    assert merged[0][6:] == [0, 2, 1, 2, 1]
    assert merged[1][6:] == [2, 5, 4, 5, 3.5]


def test_unequal_halves_take_the_label_of_the_longer() -> None:
    table = [
        motion_row(MC.A, (0, 0.9, 0.9, 1.0), tags=(4, 8)),
        motion_row(MC.K, (1, 1.1, 1.1, 2.0), tags=(1, 8)),
    ]
    table.append(motion_row(MC.K, (2, 2.5, 2.5, 3)))
    largest = motion_filter.relabel_halves(table, 0, MASTER)
    assert [row[0] for row in table] == [MC.D, MC.PC, MC.K]
    assert largest == 1.0


def test_an_amplitude_out_of_range_skips_a_row_or_ends_the_pass() -> None:
    def table() -> list[list[float]]:
        rows = [motion_row(MC.I, (0, 1, 1, 2), amp=9.0), motion_row(MC.K, (2, 3, 3, 4), amp=1.0)]
        return [*rows, motion_row(MC.D, (4, 4.1, 4.1, 4.2), amp=1.0)]

    assert [row[0] for row in motion_filter.merge_short(table(), 0, MASTER)] == [MC.I, MC.K]
    assert len(motion_filter.merge_short(table(), 0, VERSIONS["a1ca1d1"])) == 3
    assert motion_filter.relabel_halves(table(), 0, MASTER) == 1.0
    assert motion_filter.relabel_halves(table(), 0, VERSIONS["a1ca1d1"]) == 0.0


def test_the_much_longer_composition_absorbs_the_shorter() -> None:
    short_first = [
        motion_row(MC.I, (0, 0.1, 0.1, 0.2), avg=2.0, tags=(3, 2)),
        motion_row(MC.C, (0.2, 1, 1, 3), tags=(8, 9)),
    ]
    (row,) = motion_filter.merge_short(short_first, 0, MASTER)
    assert row[:6] == [MC.C, 1.5, 2.5, 1.0, 3, 9]
    assert row[6:] == [0, 0.2, 0.2, 3, 1.5]


def test_weak_contacts_become_increase_and_decrease() -> None:
    table = motion_rows("pc nc c", amp=0.5)
    motion_filter.demote_contacts(table, 10.0)
    assert [row[0] for row in table] == [MC.I, MC.D, MC.C]
    table = motion_rows("pc nc c", amp=2.0)
    motion_filter.demote_contacts(table, 10.0)
    assert [row[0] for row in table] == [MC.PC, MC.NC, MC.C]


def test_alike_neighbours_become_adjustment_or_constant_once_per_pass() -> None:
    assert [r[0] for r in motion_filter.merge_into_adjustments(motion_rows("i a d"), 0, False)] == [
        MC.A,
        MC.D,
    ]
    assert [r[0] for r in motion_filter.merge_into_constants(motion_rows("i d i"), 0, False)] == [MC.K, MC.I]
    assert len(motion_filter.merge_into_constants(motion_rows("k k a"), 0, False)) == 3
    assert len(motion_filter.merge_into_constants(motion_rows("i d"), 1, False)) == 2


# --- low-level behaviours ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ("k k", [LLB.FX]),
        ("i i", [LLB.PS]),
        ("d d", [LLB.PL]),
        ("pc nc", [LLB.CT]),
        ("nc pc", [LLB.CT]),
        ("pc c", [LLB.CT]),
        ("pc pc", [LLB.CT, LLB.CT]),
        ("a k", [LLB.AL, LLB.FX]),
        ("a", [LLB.SH]),
        ("i d k", [LLB.PS, LLB.PL, LLB.FX]),
    ],
)
def test_behaviours_of_long_compositions(labels: str, expected: list[LLB]) -> None:
    assert [row[0] for row in behaviours.compose_behaviours(motion_rows(labels))] == expected


def test_short_compositions_are_noise_until_the_first_long_one() -> None:
    short = [motion_row(MC.I, (0, 0.02, 0.02, 0.04)), motion_row(MC.D, (0.04, 0.05, 0.05, 0.06))]
    long = [motion_row(MC.K, (0.06, 0.1, 0.1, 0.2))]
    found = behaviours.compose_behaviours([*short, *long, *short, *long])
    assert [row[0] for row in found] == [LLB.N, LLB.N, LLB.FX, LLB.PS, LLB.PL, LLB.FX]
    assert found[0][11] == behaviours.NONE


def test_a_short_adjustment_looks_two_rows_ahead_and_drops_the_row_between() -> None:
    short, between = motion_row(MC.A, (0, 0.02, 0.02, 0.05), amp=2.0), motion_row(MC.K, (0.05, 0.5, 0.5, 1))
    later = motion_row(MC.A, (1, 1.5, 1.5, 2), amp=1.0)
    (row,) = behaviours.compose_behaviours([short, between, later])
    assert row[0] == LLB.AL
    assert row[12:16] == [0, 0.05, 1, 2]
    long = motion_row(MC.A, (0, 0.02, 0.02, 0.2), amp=2.0)
    assert [r[0] for r in behaviours.compose_behaviours([long, between, later])] == [LLB.AL, LLB.FX, LLB.SH]


# --- filter of low-level behaviours -----------------------------------------------------------------------


def test_duration_pass_acts_on_leading_pairs_only_and_never_on_the_last() -> None:
    long, short, other = (
        behaviour_row(LLB.FX, 0, 1),
        behaviour_row(LLB.PS, 1, 1.1),
        behaviour_row(LLB.PL, 1.1, 2),
    )
    fixture = [long, short, other]
    (first, last) = behaviour_filter.merge_short([row[:] for row in fixture])
    assert (first[0], first[12], first[15], last[0]) == (LLB.FX, 0, 1.1, LLB.PL)
    assert len(behaviour_filter.merge_short([row[:] for row in fixture[:2]])) == 2
    stopped = [behaviour_row(LLB.AL, -1, 0), *[row[:] for row in fixture]]
    assert len(behaviour_filter.merge_short(stopped)) == 4
    passed_over = [behaviour_row(LLB.CT, -1, 0), *[row[:] for row in fixture]]
    assert len(behaviour_filter.merge_short(passed_over)) == 3


def test_duration_pass_swaps_when_the_later_row_is_longer() -> None:
    table = [behaviour_row(LLB.PS, 0, 0.1), behaviour_row(LLB.FX, 0.1, 1), behaviour_row(LLB.PL, 1, 2)]
    first, _ = behaviour_filter.merge_short(table)
    assert (first[0], first[12], first[15]) == (LLB.FX, 0, 1)


def test_an_amplitude_of_zero_does_not_hang() -> None:
    table = [behaviour_row(LLB.FX, k, k + 1, amp=0.0 if k == 1 else 1.0) for k in range(4)]
    assert len(behaviour_filter.merge_short(table)) == 4


def test_repeats_merge_until_none_is_left() -> None:
    table = [behaviour_row(LLB.FX, k, k + 1) for k in range(7)]
    (row,) = behaviour_filter.merge_repeats(table)
    assert (row[12], row[15]) == (0, 7)


def test_push_beside_pull_becomes_alignment_whatever_their_size() -> None:
    table = [behaviour_row(LLB.PS, 0, 1, avg=-9, amp=1), behaviour_row(LLB.PL, 1, 2, avg=9, amp=90)]
    assert _labels(behaviour_filter.filter_behaviours(table)) == [LLB.AL]


def test_shift_before_something_smaller_becomes_alignment() -> None:
    table = [behaviour_row(LLB.SH, 0, 1, amp=2), behaviour_row(LLB.SH, 1, 2, amp=1)]
    assert _labels(behaviour_filter.merge_where(table, behaviour_filter.decreasing, LLB.AL)) == [LLB.AL]
    table = [behaviour_row(LLB.SH, 0, 1, amp=1), behaviour_row(LLB.SH, 1, 2, amp=2)]
    assert len(behaviour_filter.merge_where(table, behaviour_filter.decreasing, LLB.AL)) == 2


def test_fixed_takes_in_alike_neighbours_but_no_contact() -> None:
    table = [behaviour_row(LLB.AL, 0, 1), behaviour_row(LLB.FX, 1, 2)]
    assert _labels(behaviour_filter.filter_behaviours(table)) == [LLB.FX]
    for label in (LLB.CT, LLB.N):
        table = [behaviour_row(label, 0, 1), behaviour_row(LLB.FX, 1, 2)]
        assert _labels(behaviour_filter.filter_behaviours(table)) == [label, LLB.FX]
