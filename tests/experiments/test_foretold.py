"""What the learned labels see: the second snapshot of each word, and the signal before it."""

from __future__ import annotations

import numpy as np

from experiments.words import foretold
from experiments.words.latency import WINDOW, Shown, shown_twice
from rcbht_jax.types import LabelTrack

AXES = 2


def track(label: np.ndarray, t0: np.ndarray, t1: np.ndarray, value: np.ndarray) -> LabelTrack:
    whole = [values.astype(np.int32) for values in (label, t0, t1, t1)]
    return LabelTrack(*whole, *[value.astype(np.float32)] * 4)


def test_a_word_is_judged_by_the_label_of_its_second_snapshot() -> None:
    """Words begin at 0, 10 and 25; the second is shown once, the third changes its label after two windows."""
    begin = np.array([0, 0, 10, 25, 25, 25])[:, None].repeat(AXES, 1)
    shown = Shown(np.array([3, 4, 5, 6, 7, 8])[:, None].repeat(AXES, 1), begin)
    label, t0 = np.zeros((2, 6, AXES), int)
    label[3:, 1], t0[3:, 1] = [4, 5, 8], [0, 10, 25]  # axis 0 published nothing
    found = shown_twice(track(label, t0, t0 + 5, label), shown)
    assert found.tolist() == [[1, 1, 4, 4], [4, 1, 7, 8]]
    assert shown_twice(track(0 * label, t0, t0, label), shown).shape == (0, 4)


def test_words_and_samples_are_those_until_the_window() -> None:
    label = np.array([[[1, 2]], [[3, 0]]])  # [window, axis, slot]
    t0, t1 = np.array([[[0, 3]], [[3, 0]]]), np.array([[[3, 5]], [[10, 0]]])
    tolerance, small = np.array([2.0]), np.array([4.0])
    words = track(label, t0, t1, 8.0 * label)
    newest, before = (foretold.word(words, back, tolerance, small) for back in (0, 1))
    assert newest[:, 0].tolist() == [[2, WINDOW - 3, 2, 8, 0, 4], [3, 2 * WINDOW - 3, 7, 12, 0, 6]]
    assert before[:, 0].tolist() == [[1, WINDOW, 3, 4, 0, 2], [0] * 6]
    wrench = np.arange(2 * WINDOW, dtype=np.float32)[:, None]
    recent = foretold.recent(wrench, tolerance)
    assert recent.shape == (2, 1, foretold.RECENT)
    assert recent[:, 0, -3:].tolist() == [[-1, -0.5, 0]] * 2
    assert recent[:, 0, 0].tolist() == [-2, -4.5]  # before the recording: its first sample
