"""Failure types from contact on: contact is found in each trial by itself, and what is seen has no level."""

from __future__ import annotations

import numpy as np

from experiments._lib.results_io import committed
from experiments.classification.types_across import KINDS, WAYS, Batch, approaches, contact, described, mirror_name

DT = 0.005


def touch(at: int, level: float, length: int = 800) -> np.ndarray:
    """Free space, and a push along z."""
    wrench = np.full((length, 6), level, np.float32)
    wrench[at:, 2] += 5.0 + np.arange(length - at) * 0.01
    return wrench


def test_neither_level_nor_the_time_of_contact_nor_the_length_is_left() -> None:
    assert contact(touch(600, 3.0), DT) == 600
    assert contact(touch(300, 3.0)[:520], DT) is None  # it lies before FREE
    batch = Batch([touch(600, 0.0), touch(640, -7.0), touch(600, 2.0, 660)], np.zeros(3, np.int64), DT)
    x = described(batch, 0.1)
    np.testing.assert_allclose(x[1:], x[:2], atol=1e-5)
    assert np.abs(x).max() > 4.0


def test_what_never_touches_is_left_out_and_counted() -> None:
    batch = Batch([touch(600, 0.0), touch(300, 3.0)[:520], touch(640, 1.0)], np.arange(3), DT).touching()
    assert (batch.y.tolist(), batch.never, batch.touches()) == ([0, 2], 1, [600, 640])


def test_the_approach_ends_before_contact_and_has_no_level() -> None:
    """Whatever follows the end of the place changes nothing, nor does an offset."""
    rng = np.random.default_rng(0)
    wrench = (0.02 * rng.normal(size=(800, 6))).astype(np.float32)
    x = []
    for size, offset in ((5.0, 0.0), (50.0, -7.0)):
        pushed = wrench + np.float32(offset)
        pushed[700:] += np.float32(size)
        batch = Batch([pushed], np.zeros(1, np.int64), DT)
        assert batch.touches() == [700]
        x.append(approaches(batch, (0.6, 0.2)))
    np.testing.assert_allclose(x[0], x[1], atol=1e-5)
    assert 0 < np.abs(x[0]).max() < 0.2


def test_a_mirrored_batch_keeps_the_types_that_there_are() -> None:
    assert [mirror_name(name) for name in ("+x", "-y+r", "+x-y")] == ["+x", "+y-r", "+x+y"]
    wrench = np.arange(18, dtype=np.float32).reshape(3, 6)
    batch = Batch([wrench, wrench], np.array([0, 1]), DT).mirrored(("+x-y", "-y+r", "+x+y"))
    assert batch.y.tolist() == [2]
    np.testing.assert_array_equal(batch.wrench[0][0], [0, -1, 2, -3, 4, -5])


def test_the_committed_result_is_whole_and_chose_on_simulated_types() -> None:
    result = committed("types_across")
    assert result["complete"]
    rows = result["rows"]
    assert all(f"{a} to {b} | {kind}" in rows for a, b in WAYS for kind in KINDS)
    for _, b in WAYS:
        assert rows[f"within | {b}"]["trials tested"] == rows[f"records | {b}"]["trials"]
