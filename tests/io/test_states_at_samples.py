"""The annotated label at each sample, as exports hold it."""

from __future__ import annotations

import numpy as np

from rcbht_jax.io.export.dataset import states_at_samples
from rcbht_jax.types import Recordings


def test_states_at_samples_are_those_of_nested_and_empty_intervals() -> None:
    rows = [
        (0, "p", "outer", 0.0, 0.9), (0, "p", "inner", 0.2, 0.4), (0, "p", "empty", 0.5, 0.5),
        (0, "p", "last", 0.7, 5.0), (1, "p", "outer", 0.1, np.nan), (1, "p", "inner", 0.3, np.nan),
    ]  # fmt: skip
    made = Recordings.from_arrays([np.ones((10, 6)), np.ones((5, 6))], 10.0, annotations=rows)
    marks = made.annotations
    assert states_at_samples(made, 0).tolist() == marks.of_samples(0, "p", 10, made.dt).tolist()
    outer, inner = map(marks.labels["p"].index, ("outer", "inner"))
    assert states_at_samples(made, 1).tolist() == [-1, outer, outer, inner, inner]
