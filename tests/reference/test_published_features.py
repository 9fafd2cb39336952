"""Fixed-length sentences: Python 2 dictionaries, resampling, splitting at states, columns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES, LAYERS
from rcbht_jax.reference import encode, sample_times
from rcbht_jax.reference import published_features as pub

LETTERS = ("a", "i", "d", "k")


# Known from a 64-bit Python 2.7 without hash randomisation.
@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", 0),
        ("a", 12416037344),
        ("0", 6144018481),
        ("Mx", 9856059213088989),
        ("spos", -1840390907734881845),
        ("composite", 4028292730740392264),
        ("llbehavior", -6157052342720680580),
    ],
)
def test_python2_hash(text: str, value: int) -> None:
    assert pub.python2_hash(text) == value % 2**64


@pytest.mark.parametrize(
    ("keys", "order"),
    [
        ("primitive composite llbehavior", "composite primitive llbehavior"),
        ("Fx Fy Fz Mx My Mz", "Fx Fy Fz My Mx Mz"),
        ("8 7 6 5 4 3 2 1 0", "1 0 3 2 5 4 7 6 8"),
        ("8 0 6 1", "1 8 6 0"),
        ("a i", "a i"),
        ("i a", "i a"),
        ("CT AL", "AL CT"),
        ("spos sneg", "sneg spos"),
        ("sneg cons spos", "sneg cons spos"),
        ("bpos mpos spos bneg mneg sneg cons pimp nimp", "sneg pimp mpos spos bpos cons bneg nimp mneg"),
        ("a i d k pc nc c u", "a c d i k nc pc u"),
        ("FX CT PS PL AL SH U N", "PS FX AL N SH U PL CT"),
    ],
)
def test_python2_order(keys: str, order: str) -> None:
    assert pub.python2_order(keys.split()) == order.split()


def test_python2_order_of_a_dictionary_that_grew_twice() -> None:
    order = pub.python2_order(f"trial{k}" for k in range(30))
    numbers = [int(key.removeprefix("trial")) for key in order]
    assert numbers == [
        10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 8, 9, 2, 3, 0, 1, 6, 7, 4, 5, 29, 28,
        25, 24, 27, 26, 21, 20, 23, 22,
    ]  # fmt: skip


def test_python2_order_ignores_repeated_keys() -> None:
    assert pub.python2_order(["i", "a", "i"]) == pub.python2_order(["i", "a"])


@st.composite
def sentences(draw: st.DrawFn) -> pub.Sentence:
    """Touching labels of random durations, on the 5 ms grid."""
    steps = draw(st.lists(st.integers(1, 40), min_size=1, max_size=12))
    times = np.round((np.cumsum([draw(st.integers(0, 50)), *steps])) * 0.005, 5).tolist()
    labels = draw(st.lists(st.sampled_from(LETTERS), min_size=len(steps), max_size=len(steps)))
    return pub.Sentence(tuple(labels), tuple(times[:-1]), tuple(times[1:]))


@given(sentences(), st.integers(1, 40))
def test_resampling_gives_every_slot_a_longest_label(sentence: pub.Sentence, slots: int) -> None:
    row = pub.resample(sentence, slots)
    assert row.shape == (slots,)
    edges = np.linspace(sentence.start[0], sentence.end[-1], slots + 1)
    for slot, number in enumerate(row):
        share = dict.fromkeys(LETTERS, 0.0)
        for label, start, end in zip(*sentence, strict=True):
            share[label] += max(0.0, min(end, edges[slot + 1]) - max(start, edges[slot]))
        assert share[LETTERS[number]] >= max(share.values()) - 1e-9


@given(sentences())
def test_resampling_does_not_depend_on_the_order_of_records(sentence: pub.Sentence) -> None:
    backwards = pub.Sentence(*(column[::-1] for column in sentence))
    np.testing.assert_array_equal(pub.resample(backwards, 7), pub.resample(sentence, 7))


def test_a_gap_goes_to_the_following_label_and_an_overlap_counts_negative() -> None:
    gap = pub.Sentence(("a", "k"), (0.0, 3.0), (1.0, 4.0))
    np.testing.assert_array_equal(pub.resample(gap, 4), [0, 3, 3, 3])
    # d ends before i does: i gets 3 s, d gets -1 s, k 1 s.
    overlap = pub.Sentence(("i", "d", "k"), (0.0, 1.0, 2.0), (3.0, 2.0, 3.0))
    np.testing.assert_array_equal(pub.resample(overlap, 1), [1])


def test_ties_go_to_the_first_in_dictionary_order_whatever_comes_first_in_time() -> None:
    for labels in (("spos", "sneg"), ("sneg", "spos")):
        tie = pub.Sentence(labels, (0.0, 1.0), (1.0, 2.0))
        np.testing.assert_array_equal(pub.resample(tie, 1), [5])


@given(sentences(), st.lists(st.integers(1, 60), min_size=4, max_size=4))
def test_splitting_keeps_every_label_up_to_the_last_mark(sentence: pub.Sentence, steps: list[int]) -> None:
    marks = np.round(sentence.start[0] + np.cumsum(steps) * 0.005, 5).tolist()
    parts = pub.split(sentence, marks)
    bounds = [sentence.start[0], *marks]
    for k, part in enumerate(parts):
        for label, start, end in zip(*part, strict=True):
            assert bounds[k] <= start < end <= bounds[k + 1]
            assert any(label == whole and start >= s and end <= e for whole, s, e in zip(*sentence, strict=True))
        covered = sum(end - start for start, end in zip(part.start, part.end, strict=True))
        wanted = min(bounds[k + 1], sentence.end[-1]) - min(bounds[k], sentence.end[-1])
        assert covered == pytest.approx(wanted, abs=1e-9)


def test_a_label_across_two_marks_is_cut_twice_and_one_ending_on_a_mark_is_not() -> None:
    long = pub.Sentence(("k",), (0.0,), (10.0,))
    parts = pub.split(long, [4.0, 4.005, 8.0, 10.0])
    assert [part.end for part in parts] == [(4.0,), (4.005,), (8.0,), (10.0,)]
    assert [part.start for part in parts] == [(0.0,), (4.0,), (4.005,), (8.0,)]
    touching = pub.Sentence(("k", "i"), (0.0, 4.0), (4.0, 5.0))
    assert [part.label for part in pub.split(touching, [4.0, 5.0])] == [("k",), ("i",)]


def _labels() -> tuple[object, list[float]]:
    generator = np.random.default_rng(0)
    wrench = np.cumsum(generator.normal(size=(800, 6)), axis=0)
    onset = [0.0, 1.0, 2.0, 3.0]
    return encode(sample_times(800, 0.005), wrench, onset), onset


def test_columns_are_named_and_ordered_as_published() -> None:
    labels, onset = _labels()
    lengths = pub.longest([pub.sentences(labels)])
    names = pub.feature_names(lengths)
    row = pub.outcome_features(labels, lengths)
    assert row.shape == (len(names),) == (6 * sum(lengths),)
    assert [name.split("_")[1] for name in names if name.endswith("_0")] == [
        "Fx",
        "Fy",
        "Fz",
        "My",
        "Mx",
        "Mz",
    ] * 3
    assert names[0] == "mc_Fx_0"
    assert names[-1] == f"llb_Mz_{lengths.llb - 1}"
    recording = pub.sentences(labels)
    for layer in LAYERS:
        slots = getattr(lengths, layer)
        for axis in AXES:
            first = names.index(f"{layer}_{axis}_0")
            expected = pub.resample(recording[layer][AXES.index(axis)], slots)
            np.testing.assert_array_equal(row[first : first + slots], expected)
    assert pub.state_features(labels, onset, lengths).shape == (4, len(names))


def test_published_lengths_give_the_published_widths() -> None:
    widths = {key: len(pub.feature_names(lengths)) for key, lengths in pub.LENGTHS.items()}
    assert widths == {
        "sim_outcome": 2178,
        "sim_states": 1428,
        "real_outcome": 8352,
        "real_states": 6204,
        "two_left_states": 1782,
        "two_right_states": 2004,
    }


def test_times_are_those_of_the_text_files() -> None:
    labels, _ = _labels()
    recording = pub.sentences(labels)
    for layer in LAYERS:
        for sentence in recording[layer]:
            assert all(time == float(f"{time:.5f}") for time in (*sentence.start, *sentence.end))


def test_bad_input_is_one_sentence() -> None:
    labels, _ = _labels()
    lengths = pub.Lengths(9, 9, 9)
    with pytest.raises(InputError, match="2 boundaries; expected four states"):
        pub.state_features(labels, [0.0, 1.0, 2.0], lengths)
    with pytest.raises(InputError, match="0 labels cannot fill 3 slots"):
        pub.resample(pub.Sentence((), (), ()), 3)
    with pytest.raises(InputError, match="1 labels cannot fill 0 slots"):
        pub.resample(pub.Sentence(("a",), (0.0,), (1.0,)), 0)
    with pytest.raises(InputError, match="positive duration"):
        pub.resample(pub.Sentence(("a",), (1.0,), (1.0,)), 3)
    with pytest.raises(InputError, match="no recordings"):
        pub.longest([])
