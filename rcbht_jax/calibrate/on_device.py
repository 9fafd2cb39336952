"""Scores of thresholds for trials that are on the device already, for example simulated there: no copy to the host."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp

from rcbht_jax.calibrate.label_times import label_times
from rcbht_jax.calibrate.objective import score_block
from rcbht_jax.calibrate.windows import AXES, Windows, device_lines
from rcbht_jax.encoder import EncoderConfig
from rcbht_jax.types import Array


@partial(jax.jit, static_argnums=0, static_argnames=("classes", "chunk", "group"))
def score_wrench(
    config: EncoderConfig,
    limits: Array,
    wrench: Array,
    edges: Array,
    y: Array,
    *,
    classes: int,
    chunk: int = 64,
    group: int = 64,
) -> Array:
    """Wrench to windows, labels, times per label and scores in one program.

    Args:
        config: static configuration.
        limits: float ``[candidate, 6, 4]``, N/s and Nm/s.
        wrench: float ``[trial, time, 6]``, N and Nm; after the last edge of a trial anything finite.
        edges: int32 ``[trial, sentence + 1]``, samples; the last edge is the length of the trial.
        y: int32 ``[trial, sentence]``, class.
        classes: number of classes.
        chunk: candidates encoded and scored at once, which bounds memory.
        group: trials encoded at once.

    Returns:
        float32 ``[candidate, score]`` in the order of :data:`rcbht_jax.calibrate.objective.SCORES`.
    """
    length = edges[:, -1]
    short = -wrench.shape[1] % config.window
    inside = jnp.arange(wrench.shape[1], dtype=jnp.int32)[None] < length[:, None]
    padded = jnp.pad(jnp.where(inside[..., None], wrench, 0), ((0, 0), (0, short), (0, 0)))
    slope, vmax, vmin = device_lines(config, padded, length)
    windows = Windows(slope, vmax, vmin, length)
    count = limits.shape[0]
    padded_limits = jnp.concatenate([limits, jnp.repeat(limits[-1:], -count % chunk, axis=0)])

    def some(part: Array) -> Array:
        times = label_times(config, part, windows, edges, group=min(group, wrench.shape[0]))
        return score_block(times, y, classes=classes)

    made = jax.lax.map(some, padded_limits.reshape(-1, chunk, AXES, 4))
    return made.reshape(-1, made.shape[-1])[:count]
