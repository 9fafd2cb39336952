"""Samples in as they come, published labels out: the host side of the streaming encoder."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcbht_jax.encoding.encoder import EncoderConfig, EncoderState, flush, init, step, unpack
from rcbht_jax.encoding.thresholds import GradientThresholds
from rcbht_jax.errors import InputError
from rcbht_jax.types import LabelTracks

_step = jax.jit(step, static_argnums=0)
_unpack = jax.jit(unpack)
_flush = jax.jit(flush, static_argnums=0)


class Stream:
    """One wrench signal; remembers a fixed-size state and less than one window of samples.

    Args:
        config: static configuration.
        thresholds: limits ``[axes, 4]``.
        dtype: float32 or float64 (the latter needs JAX's 64-bit mode).

    Published labels come as LabelTracks ``[axis, slot]`` of host arrays, one slot per window or, at the end,
    1 + 2, 1 + 5 and 1 + 8 slots; label 0 marks a slot where nothing was published. Their values are equal bit
    for bit to those of :func:`rcbht_jax.encoding.encoder.encode`, however the samples are cut into chunks.
    """

    def __init__(
        self, config: EncoderConfig, thresholds: GradientThresholds, dtype: type[np.floating] = np.float32
    ) -> None:
        self._config = config
        self._limits = jnp.asarray(np.asarray(thresholds.limits), dtype)
        if self._limits.ndim != 2:
            raise InputError(f"Thresholds have shape {self._limits.shape}; a stream expects [axis, 4].")
        self._axes = self._limits.shape[0]
        self._state: EncoderState = init((self._axes,), dtype)
        self._rest: NDArray[np.floating] = np.zeros((config.window, self._axes), dtype)
        self._count = 0

    @property
    def received(self) -> int:
        """Samples received so far."""
        return int(self._state.time[0]) + self._count

    def push(self, samples: ArrayLike) -> list[LabelTracks]:
        """Feed samples ``[time, axis]`` of any number; one entry per window that they complete.

        Raises:
            InputError: wrong shape, or a value that is not finite; then nothing is consumed.
        """
        chunk = np.asarray(samples, self._rest.dtype)
        if chunk.ndim != 2 or chunk.shape[1] != self._axes:
            raise InputError(f"Samples have shape {chunk.shape}; expected [time, {self._axes}].")
        if not np.isfinite(chunk).all():
            raise InputError("Samples hold a value that is not a finite number; nothing was consumed.")
        outs = []
        while len(chunk):
            taken = chunk[: self._config.window - self._count]
            self._rest[self._count : self._count + len(taken)] = taken
            self._count += len(taken)
            chunk = chunk[len(taken) :]
            if self._count == self._config.window:
                self._state, out = _step(self._config, self._limits, self._state, jnp.array(self._rest))
                self._count = 0
                outs.append(jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], _unpack(out)))
        return outs

    def peek(self) -> LabelTracks:
        """Provisional labels as if the stream ended now; nothing changes (section 4.8)."""
        return self._end()

    def flush(self) -> LabelTracks:
        """End of the stream: the labels still held. The stream starts anew afterwards."""
        tracks = self._end()
        self._state = init((self._axes,), self._rest.dtype)
        self._count = 0
        return tracks

    def _end(self) -> LabelTracks:
        count = jnp.full(self._axes, self._count, jnp.int32)
        tracks = _flush(self._config, self._limits, self._state, jnp.array(self._rest), count)
        return jax.tree.map(np.asarray, tracks)
