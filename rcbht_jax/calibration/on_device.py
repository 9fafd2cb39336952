"""Trials that are on the device already, for example simulated there, as what thresholds are calibrated on.

The corpus that comes of them is searched and trained on as any other; its wrenches never visit the host.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.calibration.dataset import CalibrationData
from rcbht_jax.calibration.windows import Windows, device_lines
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.types import Array


def device_calibration_data(
    config: EncoderConfig, wrench: Array, edges: Array, y: Array, classes: tuple[str, ...]
) -> CalibrationData:
    """Windows fitted where the wrenches are; trials are named by their number.

    Args:
        config: static configuration.
        wrench: float ``[trial, time, 6]`` on the device, N and Nm; after the last edge of a trial anything.
        edges: int32 ``[trial, sentence + 1]`` on the device, samples; the last edge is the length of the trial.
        y: int32 ``[trial, sentence]`` on the device, index into ``classes``.
        classes: their names.
    """
    clean, windows = _fitted(config, wrench, edges)
    return CalibrationData(clean, windows, edges, y, classes, np.arange(len(wrench)).astype(np.str_))


@partial(jax.jit, static_argnums=0)
def _fitted(config: EncoderConfig, wrench: Array, edges: Array) -> tuple[Array, Windows]:
    """The wrench with zeros after its end, in whole windows, and their lines."""
    length = edges[:, -1]
    inside = jnp.arange(wrench.shape[1], dtype=jnp.int32)[None] < length[:, None]
    short = -wrench.shape[1] % config.window
    padded = jnp.pad(jnp.where(inside[..., None], wrench, 0), ((0, 0), (0, short), (0, 0)))
    slope, vmax, vmin = device_lines(config, padded, length)
    return padded, Windows(slope, vmax, vmin, length)
