"""The encoders are traced under shard_map, whose types tell along which axes of a mesh a value varies."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, PartitionSpec

from rcbht_jax.encoding.encoder import EncoderConfig, encode
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.soft import soft_encode
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import FitLimits

LIMITS = jnp.asarray(preset().limits, jnp.float32)


@pytest.mark.parametrize(
    ("run", "limits"),
    [
        (partial(encode, EncoderConfig()), LIMITS),
        (partial(soft_encode, EncoderConfig(), temperature=0.3), LIMITS),
        (partial(soft_encode, FitConfig(), temperature=0.3), FitLimits(LIMITS, jnp.ones(6))),
    ],
    ids=["hard", "soft", "soft fit"],
)
def test_the_state_of_a_loop_varies_as_its_samples_do(
    run: Callable[..., Any], limits: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mesh of one device has the types of a large one; a loop refuses a state whose type changes in it."""
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")  # also where there is a GPU, whose kernels have no types
    everywhere, rows = PartitionSpec(), PartitionSpec("recording")
    mesh = Mesh(np.array(jax.devices()[:1]), ("recording",))
    shared = jax.shard_map(run, mesh=mesh, in_specs=(everywhere, rows, rows), out_specs=rows)
    given = jax.ShapeDtypeStruct((2, 50, 6), jnp.float32), jax.ShapeDtypeStruct((2,), jnp.int32)
    assert jax.eval_shape(shared, limits, *given) == jax.eval_shape(run, limits, *given)
