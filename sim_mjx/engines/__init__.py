"""Physics engines behind one function; none of them knows the task."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from sim_mjx.rollout import Rollouts
    from sim_mjx.scene import Scene

ENGINES = ("native", "mjx", "warp")


def simulate(
    scene: Scene, params: Any, engine: str = "native", *, progress: Callable[[int], None] | None = None
) -> Rollouts:
    """Simulate a batch of trials until all have ended.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        engine: one of ``ENGINES``; an engine is imported when it is first used.
        progress: called with the number of control periods done since the last call, summed over trials.

    Raises:
        InputError: unknown engine.
    """
    if engine not in ENGINES:
        raise InputError(f"There is no engine {engine!r}; expected one of {', '.join(ENGINES)}.")
    return import_module(f"sim_mjx.engines.{engine}").simulate(scene, params, progress=progress)
