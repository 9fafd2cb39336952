"""The measure of stability: one for an equal copy, near nothing for nonsense, and right between."""

from __future__ import annotations

import numpy as np
import pytest

from experiments._lib import word_stability as stability
from experiments._lib.word_stability import Words, agreement
from rcbht_jax.labels import Primitive
from rcbht_jax.types import LabelTrack, Recordings

WITHIN = 0.025


def words(labels: list[int], edges: list[float]) -> Words:
    return Words(np.array(labels), np.array(edges[:-1]), np.array(edges[1:]))


def drawn(rng: np.random.Generator) -> Words:
    edges = np.concatenate([[0.0], np.sort(rng.uniform(0.1, 59.9, 99)), [60.0]])
    return Words(rng.integers(1, 10, 100), edges[:-1], edges[1:])


def test_an_equal_copy_keeps_everything() -> None:
    copies = [drawn(np.random.default_rng(seed)) for seed in range(3)]
    found = agreement(zip(copies, copies, strict=True), 0.0)
    assert (found["edit"], found["kept"], found["breaks"], found["time"]) == (0.0, 1.0, 1.0, 1.0)
    assert found["words"] == 2 * sum(int((one.end - one.start > stability.LONG).sum()) for one in copies)


def test_nonsense_keeps_next_to_nothing() -> None:
    rng = np.random.default_rng(0)
    found = agreement([(drawn(rng), drawn(rng)) for _ in range(10)], WITHIN)
    assert found["kept"] < 0.01
    assert found["breaks"] < 0.05
    assert 0.08 < found["time"] < 0.15  # nine labels
    assert found["edit"] > 0.7


def test_each_way_to_differ_is_counted() -> None:
    first = words([1, 2, 3, 4, 5], [0, 1, 2, 3, 3.05, 5])
    assert agreement([(first, words([1, 2, 3, 4, 5], [0, 1.02, 2, 3, 3.05, 5]))], WITHIN)["kept"] == 1
    moved = agreement([(first, words([1, 2, 3, 4, 5], [0, 1.03, 2, 3, 3.05, 5]))], WITHIN)
    assert moved == {"edit": 0.0, "kept": 0.5, "breaks": 0.5, "words": 8, "time": pytest.approx(1 - 0.03 / 5)}
    renamed = agreement([(first, words([1, 7, 3, 4, 5], [0, 1, 2, 3, 3.05, 5]))], WITHIN)
    assert renamed == {"edit": 0.2, "kept": 0.75, "breaks": 1.0, "words": 8, "time": pytest.approx(0.8)}
    cut = agreement([(first, words([1, 2, 2, 3, 4, 5], [0, 1, 1.5, 2, 3, 3.05, 5]))], WITHIN)
    assert (cut["edit"], cut["kept"], cut["words"]) == (pytest.approx(1 / 6), pytest.approx(6 / 9), 9)
    assert cut["time"] == 1


def test_shares_vary_with_the_recordings() -> None:
    rng = np.random.default_rng(0)
    stable = [(one, Words(one.label, one.start + 0.01, one.end + 0.01)) for one in (drawn(rng) for _ in range(6))]
    nonsense = [(drawn(rng), drawn(rng)) for _ in range(6)]
    both = agreement([*stable, *nonsense], WITHIN, lanes=6)
    assert both["kept"] == pytest.approx(0.5, abs=0.02)
    assert both["kept interval"][0] < 0.1
    assert both["kept interval"][1] > 0.9
    assert both["time interval"][0] < 0.2 < 0.8 < both["time interval"][1]
    assert both["edit interval"][0] < 0.1 < 0.7 < both["edit interval"][1]
    mixed = agreement([pair for pairs in zip(stable, nonsense, strict=True) for pair in pairs], WITHIN, lanes=2)
    assert np.ptp(mixed["kept interval"]) < 0.05


def test_without_long_words_there_is_no_share() -> None:
    short = words([1, 2], [0, 0.05, 0.1])
    found = agreement([(short, short)], WITHIN)
    assert (found["kept"], found["breaks"], found["words"]) == (None, None, 0)


def test_words_of_tracks_are_in_seconds() -> None:
    fields = np.zeros((2, 1, 3))
    label, t1 = np.array([[[7, 2, 0]], [[1, 0, 0]]]), np.array([[[10, 30, 0]], [[20, 0, 0]]])
    t0 = np.array([[[0, 10, 0]], [[0, 0, 0]]])
    whole = [values.astype(np.int32) for values in (label, t0, t1, t1)]
    track = LabelTrack(*whole, *[fields.astype(np.float32)] * 4)
    first, second = stability.words_of(track, 0.01)
    assert (first.label.tolist(), first.start.tolist(), first.end.tolist()) == ([7, 2], [0, 0.1], [0.1, 0.3])
    assert second.end.tolist() == [0.2]


def recordings(wrench: stability.Floats, dt: float = 0.005) -> Recordings:
    return Recordings.from_arrays([wrench], rate=1 / dt)


def test_noise_has_its_deviation_and_copies_are_independent() -> None:
    rng = np.random.default_rng(0)
    still = recordings(np.ones((4000, 2)))
    first, second = (stability.noisy(still, np.array([0.1, 3.0]), rng).wrench[0] - 1 for _ in range(2))
    np.testing.assert_allclose(first.std(0), [0.1, 3.0], rtol=0.05)
    assert abs(np.corrcoef(first[:, 0], second[:, 0])[0, 1]) < 0.05
    assert abs(np.corrcoef(first.T)[0, 1]) < 0.05


@pytest.mark.parametrize("rate", [40, 100, 200, 500, 1000])
def test_a_slow_signal_is_the_same_at_every_rate(rate: int) -> None:
    def signal(time: stability.Floats) -> stability.Floats:
        return np.stack([3 + np.sin(2 * np.pi * time), 2 * time], 1)

    copy = stability.resampled(recordings(signal(np.arange(800) / 200)), rate)
    assert 1 / copy.dt == pytest.approx(rate)
    assert copy.length[0] == rate * 4
    expected = signal(np.arange(rate * 4) / rate)
    inner = slice(rate // 2, -rate // 2)  # filters reach over the ends
    np.testing.assert_allclose(copy.wrench[0][inner], expected[inner], atol=0.02)


def test_best_lines_have_the_names_of_their_slopes() -> None:
    y = np.concatenate([np.zeros(100), np.arange(100) * 0.06, np.full(100, 6.0), 6 - np.arange(100) * 0.6])
    limits = np.array([1000.0, 50.0, 5.0, 1.0])
    found = stability.best_lines(y, 4, 0.01, limits, 0.1)
    assert found.label.tolist() == [Primitive.CONS, Primitive.MPOS, Primitive.CONS, Primitive.BNEG]
    np.testing.assert_allclose(found.start, [0, 1, 2, 3], atol=0.02)
