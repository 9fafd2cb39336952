"""MJX with Warp's kernels: the fastest on an NVIDIA GPU; needs the optional package warp-lang."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from rcbht_jax.errors import InputError
from sim_mjx.engines import device
from sim_mjx.rollout import Rollouts
from sim_mjx.scene import Scene


def simulate(scene: Scene, params: Any, *, progress: Callable[[int], None] | None = None) -> Rollouts:
    """Simulate a batch of trials; see ``device.simulate``.

    Raises:
        InputError: warp-lang is not installed.
    """
    if find_spec("warp") is None:
        raise InputError('The engine "warp" needs warp-lang; install it with: pip install "rcbht-jax[warp]".')
    return device.simulate(scene, params, "warp", progress=progress)
