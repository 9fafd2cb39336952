"""Features of label tracks that come in batches are those of the whole, also where a trial's arms are apart."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from rcbht_jax._util.digest import data_hash
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.io.label_parts import taken
from rcbht_jax.learning.tasks import TaskSpec, TrackBatches, extract_features, unlabelled_intervals
from rcbht_jax.types import Recordings


@pytest.fixture(scope="module")
def two_armed() -> Recordings:
    """Six trials of two arms, the left arms after all right ones."""
    rng = np.random.default_rng(0)
    wrenches = [np.cumsum(rng.normal(size=(int(n), 6)), 0) for n in rng.integers(40, 120, 12)]
    names = [f"trial-{n}" for n in [*range(6), *range(6)]]
    return Recordings.from_arrays(wrenches, trial=names, arm=["R"] * 6 + ["L"] * 6, outcome="success")


@pytest.mark.parametrize("arms", ["R", "both"])
@pytest.mark.parametrize("sizes", [(12,), (5, 1, 6), (1, 11)])
def test_features_do_not_depend_on_the_batches(two_armed: Recordings, arms: str, sizes: tuple[int, ...]) -> None:
    tracks = encode_batch(EncoderConfig(5), preset(), two_armed.wrench, two_armed.length)
    items, spec = unlabelled_intervals(two_armed, TaskSpec("outcome", arms=arms)), FeatureSpec()
    edges = np.cumsum([0, *sizes]).tolist()
    parts = [taken(tracks, slice(first, last)) for first, last in pairwise(edges)]
    for names in (("",), ("one", "two")):
        whole = extract_features(dict.fromkeys(names, tracks), items, spec)
        batches = [dict.fromkeys(names, part) for part in parts]
        found = extract_features(TrackBatches(names, lambda read=batches: read), items, spec)
        assert found.names == whole.names
        assert found.values.shape[0] == 6
        np.testing.assert_array_equal(found.values, whole.values)


def test_digest_of_batches_is_that_of_the_data_set(two_armed: Recordings) -> None:
    table = replace(two_armed, wrench=two_armed.wrench[:, :0])
    halves = [two_armed.wrench[:5, : two_armed.length[:5].max()], two_armed.wrench[5:]]
    assert data_hash(table, iter(halves), two_armed.wrench.shape[1]) == data_hash(two_armed)
    halves[1] = halves[1] + np.float32(1)
    assert data_hash(table, iter(halves), two_armed.wrench.shape[1]) != data_hash(two_armed)
