"""Measurements of speed: how long things take, and recordings for them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from rcbht_jax.types import Array

SAMPLES, AXES = 2000, 6


def seconds_of(work: Callable[[], Any]) -> tuple[Any, float]:
    """What it makes, and how many seconds that took, on the device too."""
    start = time.perf_counter()
    made = jax.block_until_ready(work())
    return made, time.perf_counter() - start


def timed(work: Callable[[], Any], repeats: int) -> tuple[float, list[float]]:
    """Seconds of the first call, which compiles, and of the others."""
    first, *others = [seconds_of(work)[1] for _ in range(repeats + 1)]
    return first, others


def recordings(count: int) -> Array:
    """Random walks [count, SAMPLES, AXES], N and Nm."""
    steps = jax.random.normal(jax.random.key(0), (count, SAMPLES, AXES), jnp.float32)
    return jnp.cumsum(0.3 * steps, 1)
