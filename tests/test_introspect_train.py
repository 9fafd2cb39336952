"""Which looks train a head: every sentence alike, its end always, its beginning where that is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.grammar import Intervals
from rcbht_jax.introspect.train import picked, streamed
from rcbht_jax.tasks import Sentences


def sentences_of(lengths: list[int]) -> Sentences:
    count = len(lengths)
    start = np.arange(count) * 7
    where = Intervals(np.arange(count) % 2, start, start + lengths, 0.005)
    names = np.array([f"t{k}" for k in range(count)])
    return Sentences(("a", "b"), np.arange(count) % 2, names, names, (where,), {})


@pytest.mark.parametrize("early", [False, True])
def test_picked_looks(early):
    items = sentences_of([10_000, 200, 21, 5])
    looks, every = picked(items, 20, 12, early), streamed(items, 20)
    for k, length in enumerate([10_000, 200, 21, 5]):
        mine, all_of_it = looks.sentence == k, every.sentence == k
        steps = looks.now[mine] - looks.begin[mine]
        assert len(steps) <= 24
        assert steps[-1] == length
        assert looks.whole[mine].tolist() == [False] * (len(steps) - 1) + [True]
        assert set(steps) <= set(every.now[all_of_it] - every.begin[all_of_it])
        assert (np.diff(steps) > 0).all()
        assert set(looks.recording[mine]) == {k % 2}
    first = looks.now[looks.sentence == 0]
    assert (np.sum(first < 1000) > 5) == early
    assert len(every.now[every.sentence == 3]) == 1
    assert np.sum(every.sentence == 0) == 500
