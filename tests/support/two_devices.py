"""One device against two, in a process whose CPU says it is two devices: search, gradients and labels.

Raises:
    AssertionError: the results differ.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from rcbht_jax._util.devices import in_turn
from rcbht_jax.calibration import gradient
from rcbht_jax.calibration.dataset import device_calibration_data
from rcbht_jax.calibration.search import SearchOptions, score_candidates, search
from rcbht_jax.encoding.batch import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.soft import soft_encode
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits

CONFIG = EncoderConfig(5, 0.005)
TRIALS, SAMPLES = 6, 200


def same(one: object, other: object) -> None:
    """The same bits in all leaves."""
    jax.tree.map(np.testing.assert_array_equal, one, other)


def main() -> None:
    both = jax.devices()
    assert len(both) == 2
    rng = np.random.default_rng(0)
    wrench = np.cumsum(rng.normal(0, 0.3, (TRIALS, SAMPLES, 6)), 1).astype(np.float32)
    edges = np.tile(np.array([0, 100, SAMPLES], np.int32), (TRIALS, 1))
    y = np.tile(np.arange(2, dtype=np.int32), (TRIALS, 1))
    data = device_calibration_data(CONFIG, *jax.device_put((wrench, edges, y)), ("a", "b"))

    options = SearchOptions(candidates=5, generations=1, population=4)
    one, two = search(data, CONFIG, options), search(data, CONFIG, options, devices=both)
    same((one.thresholds, one.scores, one.value), (two.thresholds, two.scores, two.value))
    seen = list[int]()
    limits = options.space.thresholds(options.points())
    again = score_candidates(data, CONFIG, limits, chunk=2, devices=both, progress=lambda start, _: seen.append(start))
    same(score_candidates(data, CONFIG, limits), again)
    assert seen == [0, 2, 4]

    steps = gradient.GradientOptions(steps=3)
    alone, shared = (gradient.calibrate(data, CONFIG, preset(), steps, devices=some) for some in (None, both))
    np.testing.assert_allclose(shared.path, alone.path, rtol=1e-5)  # sums over trials have another order

    length = np.array([SAMPLES, 7, 0, 199, 100, 50], np.int32)
    there = jnp.asarray(wrench), jnp.asarray(length)
    tasks = [partial(encode_on_device, CONFIG, preset(), *jax.device_put(there, device), batch=2) for device in both]
    for device, labels in zip(both, in_turn(tasks, 2), strict=True):
        same(encode_on_device(CONFIG, preset(), *there), labels)
        assert {place for leaf in jax.tree.leaves(labels) for place in leaf.devices()} == {device}

    rows, everywhere = PartitionSpec("recording"), PartitionSpec()
    limits_there, mesh = jnp.asarray(preset().limits, jnp.float32), Mesh(np.array(both), ("recording",))

    def in_halves(run: Callable[..., Any]) -> Callable[..., Any]:
        return jax.jit(jax.shard_map(run, mesh=mesh, in_specs=(everywhere, rows, rows), out_specs=rows))

    dense = partial(encode, CONFIG)
    same(jax.jit(dense)(limits_there, *there), in_halves(dense)(limits_there, *there))
    for config, given in ((CONFIG, limits_there), (FitConfig(), FitLimits(limits_there, jnp.full(6, 0.5)))):
        soft = partial(soft_encode, config, temperature=0.3)
        made = jax.jit(soft)(given, *there), in_halves(soft)(given, *there)
        jax.tree.map(partial(np.testing.assert_allclose, atol=1e-5), *made)  # a compiler rounds logarithms as it likes


if __name__ == "__main__":
    main()
