"""Recordings for measurements of speed, made on the default device."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rcbht_jax.types import Array

SAMPLES, AXES = 2000, 6


def recordings(count: int) -> Array:
    """Random walks [count, SAMPLES, AXES], N and Nm."""
    steps = jax.random.normal(jax.random.key(0), (count, SAMPLES, AXES), jnp.float32)
    return jnp.cumsum(0.3 * steps, 1)
