"""How long things take."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax


def seconds_of(work: Callable[[], Any]) -> tuple[Any, float]:
    """What it makes, and how many seconds that took, on the device too."""
    start = time.perf_counter()
    made = jax.block_until_ready(work())
    return made, time.perf_counter() - start


def timed(work: Callable[[], Any], repeats: int) -> tuple[float, list[float]]:
    """Seconds of the first call, which compiles, and of the others."""
    first, *others = [seconds_of(work)[1] for _ in range(repeats + 1)]
    return first, others
