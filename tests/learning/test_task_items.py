"""Intervals of tracks at the ends of the record."""

from __future__ import annotations

import numpy as np

from rcbht_jax.annotations import Annotations
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings


def test_an_interval_that_begins_before_the_record_is_cut_at_its_first_sample() -> None:
    rows = [(0, "phase", "reach", -0.1, 1.0), (0, "phase", "push", 1.0, 9.0), (1, "phase", "reach", -0.5, -0.1)]
    rows += [(1, "phase", "push", 0.5, 2.0)]
    data = Recordings.from_arrays(np.zeros((2, 400, 6)), 200, annotations=Annotations.from_rows(rows))
    items = labelled_intervals(data, TaskSpec("phase"))
    (only,) = items.intervals
    assert [items.classes[k] for k in items.y] == ["reach", "push", "push"]
    assert (only.start.tolist(), only.end.tolist()) == ([0, 200, 100], [200, 400, 400])
    assert items.dropped == {"intervals that are empty, lie outside the record or have no known end": 1}
