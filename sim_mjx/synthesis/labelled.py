"""Trials and their words at once: on a GPU the wrench goes from the physics into the encoder without leaving it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from rcbht_jax.encoding.compact import encode_on_device
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.types import Array, LabelTracks
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.scene import Scene


def simulate_labelled(
    scene: Scene,
    params: Any,
    engine: str,
    config: EncoderConfig,
    limits: Array,
    *,
    progress: Callable[[int], None] | None = None,
) -> tuple[Rollouts, LabelTracks]:
    """Simulate a batch of trials and label their wrenches.

    Args:
        scene: what is simulated.
        params: batch of trials of the scene's program.
        engine: one of ``engines.ENGINES``.
        config: of the encoder.
        limits: thresholds [6, 4], N/s and Nm/s.
        progress: called with the number of control periods done since the last call, summed over trials.

    Returns:
        the trials, and host arrays of labels [trial * K, 6, slot], the wrists of a trial one after another. Labels of
        a diverged trial mean nothing.

    Raises:
        InputError: unknown engine, or what it needs is not installed.
    """
    engines.check(engine)
    if engine == "native":
        out = engines.simulate(scene, params, engine, progress=progress)
        return out, label(out, config, limits)
    from sim_mjx.engines import device  # MJX takes seconds to import

    there = device.run(scene, params, engines.IMPLEMENTATIONS[engine], progress=progress)
    tracks = encode_on_device(config, limits, *_by_wrist(there.wrench, there.length))
    return device.to_host(there), jax.device_get(tracks)


def label(out: Rollouts, config: EncoderConfig, limits: Array) -> LabelTracks:
    """Labels of trials on the host; see :func:`simulate_labelled`."""
    return jax.device_get(
        encode_on_device(config, limits, *_by_wrist(jnp.asarray(out.wrench), jnp.asarray(out.length)))
    )


def _by_wrist(wrench: Array, length: Array) -> tuple[Array, Array]:
    """One recording per wrist: wrench [trial, time, 6K] -> [trial * K, time, 6]."""
    trials, samples, columns = wrench.shape
    wrists = columns // 6
    apart = wrench.reshape(trials, samples, wrists, 6).swapaxes(1, 2).reshape(-1, samples, 6)
    return apart, jnp.repeat(length, wrists, total_repeat_length=trials * wrists)
