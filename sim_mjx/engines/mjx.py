"""MJX with JAX's own kernels: on CPUs, GPUs, and wherever else JAX runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sim_mjx.engines import device
from sim_mjx.rollout import Rollouts
from sim_mjx.scene import Scene


def simulate(scene: Scene, params: Any, *, progress: Callable[[int], None] | None = None) -> Rollouts:
    """Simulate a batch of trials; see ``device.simulate``."""
    return device.simulate(scene, params, "jax", progress=progress)
