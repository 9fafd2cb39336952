"""The lines through the windows of a data set: all that the encoder needs of the wrench, whatever the thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding import segments
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

AXES = 6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Windows:
    """Fitted lines; windows beyond a recording have length 0."""

    slope: Array  # float [recording, window, 6], N/s or Nm/s
    vmax: Array  # float [recording, window, 6], larger end of the line, N or Nm
    vmin: Array  # float [recording, window, 6], smaller end of the line
    length: Array  # int32 [recording], samples

    def take(self, rows: NDArray[np.integer[Any]]) -> Windows:
        """The chosen recordings."""
        whole: Windows = jax.tree.map(lambda leaf: leaf[rows], self)
        return whole


def fit_windows(config: EncoderConfig, wrench: NDArray[np.floating], length: NDArray[np.integer[Any]]) -> Windows:
    """Lines through all windows, the last partial one of each recording included.

    Args:
        config: window and sampling period.
        wrench: float32 or float64 ``[recording, time, 6]``, N and Nm.
        length: int ``[recording]``, samples that count.

    Returns:
        host arrays in the precision of the wrench.

    Raises:
        InputError: wrong shapes, or samples that count and are not finite.
    """
    if wrench.ndim != 3 or wrench.shape[2] != AXES or length.shape != wrench.shape[:1] or not length.size:
        raise InputError(
            f"The wrench has shape {wrench.shape} with {length.size} lengths; expected [recording, time, 6] and one "
            "length for each recording."
        )
    if length.min() < 0 or length.max() > wrench.shape[1]:
        raise InputError(f"A length is outside 0 ... {wrench.shape[1]} samples.")
    count = -(-int(length.max()) // config.window)
    padded = np.zeros((len(length), count * config.window, AXES), wrench.dtype)
    for row, samples in enumerate(length):
        padded[row, :samples] = wrench[row, :samples]
        if not np.isfinite(padded[row]).all():
            raise InputError(f"Recording {row} holds values that are not finite numbers; remove or interpolate them.")
    counts = length.astype(np.int32)
    slope, vmax, vmin = device_lines(config, jnp.asarray(padded), jnp.asarray(counts))
    return Windows(np.asarray(slope), np.asarray(vmax), np.asarray(vmin), counts)


@partial(jax.jit, static_argnums=0)
def device_lines(config: EncoderConfig, wrench: jax.Array, length: jax.Array) -> tuple[jax.Array, ...]:
    """Slopes, larger and smaller ends ``[recording, window, 6]``; the wrench is made of whole windows."""
    recordings, samples, axes = wrench.shape
    count = samples // config.window
    first = jnp.arange(count, dtype=jnp.int32) * config.window
    size = jnp.clip(length[:, None] - first[None], 0, config.window)
    size = jnp.broadcast_to(size[..., None], (recordings, count, axes))
    rows = jnp.moveaxis(wrench.reshape(recordings, count, config.window, axes), 2, 0)
    t0 = jnp.broadcast_to(first[None, :, None], size.shape)
    slope, x = segments.line(rows, size, config.dt, t0)
    return slope, x.vmax, x.vmin
