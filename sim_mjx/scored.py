"""Simulated trials as what thresholds are calibrated on: rollouts, words and scores without leaving the device."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.calibrate.corpus import Corpus
from rcbht_jax.calibrate.on_device import device_corpus
from rcbht_jax.calibrate.search import evaluate
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from sim_mjx import task
from sim_mjx.engines import device
from sim_mjx.presets import STATES
from sim_mjx.scene import Scene

Array = Any
MOST_WRENCH = 2000.0  # N or Nm; beyond, the physics has come apart


def simulated_scores(
    scene: Scene,
    params: Any,
    impl: str,
    config: EncoderConfig,
    limits: NDArray[np.floating],
    *,
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float32]:
    """Simulate trials and score thresholds by how well their words tell the states apart.

    Only parameters and candidates go to the device, and only the scores and a few counts come back.

    Args:
        scene: what is simulated; one arm.
        params: batch of trials of the scene's program.
        impl: "jax" or "warp".
        config: of the encoder.
        limits: candidates ``[candidate, 6, 4]``, N/s and Nm/s.
        progress: called with the number of control periods done since the last call, summed over trials.

    Returns:
        ``[candidate, score]`` in the order of :data:`rcbht_jax.calibrate.objective.SCORES`.

    Raises:
        InputError: no trial was completed.
    """
    return evaluate(states_corpus(device.run(scene, params, impl, progress=progress), config), config, limits)


def states_corpus(out: device.Outcome, config: EncoderConfig) -> Corpus:
    """The completed trials with their four states, on the device.

    A completed trial went through all states, seated all its tabs and felt nothing impossible.

    Raises:
        InputError: there is none.
    """
    edges, order, count = _completed(out)
    kept = int(jax.device_get(count))
    if not kept:
        raise InputError(f"none of the {len(out.phase)} simulated trials was completed; nothing to calibrate on.")
    wrench, edges, y = _kept(kept, out.wrench, edges, order)
    return device_corpus(config, wrench, edges, y, STATES)


@jax.jit
def _completed(out: device.Outcome) -> tuple[Array, Array, Array]:
    """Edges of the states ``[trial, 5]``, samples; the trials, completed ones first; how many they are."""
    # a phase is logged one period after the measurement that began it
    begun = [(out.phase < phase).sum(1, dtype=jnp.int32) - 1 for phase in (task.ROTATION, task.INSERTION, task.MATING)]
    edges = jnp.stack([jnp.zeros_like(out.length), *begun, out.length], axis=1)
    inside = jnp.arange(out.wrench.shape[1], dtype=jnp.int32)[None] < out.length[:, None]
    sane = ((jnp.abs(out.wrench) <= MOST_WRENCH).all(2) | ~inside).all(1)
    entered = (out.phase == task.MATING).any(1)  # a trial that ran out of time is logged as if it had passed all
    done = sane & entered & out.seated.all(1) & (jnp.diff(edges, axis=1) > 0).all(1)
    return edges, jnp.argsort(~done, stable=True), done.sum(dtype=jnp.int32)


@partial(jax.jit, static_argnums=0)
def _kept(count: int, wrench: Array, edges: Array, order: Array) -> tuple[Array, Array, Array]:
    rows = order[:count]
    y = jnp.broadcast_to(jnp.arange(len(STATES), dtype=jnp.int32)[None], (count, len(STATES)))
    return wrench[rows], edges[rows], y
