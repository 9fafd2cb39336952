"""Physics engines behind one function, independent of the task."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from sim_mjx.assembly.rollout import Rollouts
    from sim_mjx.assembly.scene import Scene

require("mujoco", "sim")

ENGINES = ("native", "mjx", "warp", "fused")
IMPLEMENTATIONS = {"mjx": "jax", "warp": "warp"}  # of MJX
ON_DEVICE = {**IMPLEMENTATIONS, "fused": "fused"}  # engines whose rollouts stay on the device


def simulate(
    scene: Scene, params: Any, engine: str = "native", *, progress: Callable[[int], None] | None = None
) -> Rollouts:
    """Simulate a batch of trials until all have ended.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        engine: one of ``ENGINES``: C MuJoCo; MJX with JAX's kernels; MJX with Warp's; or our own kernel, the fastest
            on an NVIDIA GPU. An engine is imported when it is first used.
        progress: called with the number of control periods done since the last call, summed over trials.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    check(engine)
    if engine == "native":
        return import_module("sim_mjx.engines.native").simulate(scene, params, progress=progress)
    impl = ON_DEVICE[engine]
    return import_module("sim_mjx.engines.device").simulate(scene, params, impl, progress=progress)


def check(engine: str) -> None:
    """Raise an error if an engine cannot run here.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    if engine not in ENGINES:
        raise InputError(f"There is no engine {engine!r}; expected one of {', '.join(ENGINES)}.")
    if engine in ("warp", "fused") and find_spec("warp") is None:
        raise InputError(f'The engine "{engine}" needs warp-lang; install it with: pip install "rcbht-jax[warp]".')
