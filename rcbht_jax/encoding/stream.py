"""Samples in as they come, published labels out: the host side of the streaming encoder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike, DTypeLike, NDArray

from rcbht_jax._util.compiling import host_device, jit
from rcbht_jax._util.signals import in_precision, numbers_of, read_chunk
from rcbht_jax._util.values import LARGEST, Copyable, usable
from rcbht_jax.encoding.encoder import EncoderState, PackedLabels, unpack
from rcbht_jax.encoding.fit import FitConfig, running, step
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits, checked_limits, rule_of
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array, LabelTracks

MOST_SAMPLES = 2**31 - 2**20  # of a stream without a new start: samples are counted in 32 bits

_unpack = jit(host=True)(unpack)
BLOCK = 64  # most windows in one call of a compiled loop

StraightLines = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.floating], NDArray[np.floating]]


@jit(host=True, static_argnums=0)
def _step(config: AnyConfig, limits: Array, state: EncoderState, window: Array) -> tuple[EncoderState, PackedLabels]:
    return rule_of(config).step(config, limits, state, window)


@jit(host=True, static_argnums=(0, 1))
def _held(
    labels: Callable[..., LabelTracks], config: AnyConfig, limits: Array, state: EncoderState, rest: Array, count: Array
) -> LabelTracks:
    return labels(config, limits, state, rest, count)


@jit(host=True, static_argnums=0)
def _lines(
    config: FitConfig, limits: Array, state: EncoderState, windows: Float[Array, "block window axis"], count: Array
) -> tuple[EncoderState, Any]:
    """The first ``count`` windows: of each the word and the run as t0, t1, mean and slope ``[block, axis]``."""

    def one(number: Array, carry: tuple[EncoderState, Any]) -> tuple[EncoderState, Any]:
        state, packed = step(config, limits, carry[0], windows[number])
        word = unpack(packed).primitive
        t0, t1, line, _ = running(config, state)
        now = (word.t0, word.t1, word.avg, word.grad * config.dt), (t0, t1, line.mean, line.slope)
        return state, jax.tree.map(lambda rows, row: rows.at[number].set(row), carry[1], now)

    shape = windows.shape[0], windows.shape[2]
    whole, real = jnp.zeros(shape, jnp.int32), jnp.zeros(shape, windows.dtype)
    return jax.lax.fori_loop(0, count, one, (state, ((whole, whole, real, real),) * 2))


def _check_precision(dtype: np.dtype[Any]) -> None:
    if jax.dtypes.canonicalize_dtype(dtype) != dtype:
        raise InputError(f"The stream is of {dtype}, which needs JAX's 64-bit mode, and this is off; nothing changed.")


class WindowBuffer(Copyable):
    """Samples that do not fill a window yet, ``samples [window, axis]``; the first ``count`` of them are there."""

    def __init__(self, window: int, axes: int, dtype: type[np.floating]) -> None:
        self.samples: NDArray[np.floating] = np.zeros((window, axes), dtype)
        self.count = 0
        self.taken = 0  # since the stream began

    @property
    def room(self) -> int:
        """Samples that the window still takes."""
        return len(self.samples) - self.count

    def checked(self, samples: ArrayLike) -> NDArray[np.floating]:
        """Samples ``[time, axis]`` in the dtype of the buffer.

        Raises:
            InputError: wrong shape, a value that is not finite, or beyond ``LARGEST``, more samples than can be
                counted, or a precision that JAX does not have now.
        """
        _check_precision(self.samples.dtype)
        chunk, axes = in_precision(numbers_of(samples), self.samples.dtype), self.samples.shape[1]
        if chunk.ndim != 2 or chunk.shape[1] != axes:
            raise InputError(f"Samples have shape {chunk.shape}; expected [time, {axes}].")
        if not usable(chunk):
            raise InputError(
                f"Samples hold a value that is not a finite number, or beyond {LARGEST:g}; nothing was consumed."
            )
        if self.taken + len(chunk) > MOST_SAMPLES:
            raise InputError(
                f"More than {MOST_SAMPLES} samples of one stream cannot be counted; start a new one. None was consumed."
            )
        return chunk

    def fill(self, chunk: NDArray[np.floating], most: int) -> NDArray[np.floating]:
        """Take the first samples of a chunk, at most ``most`` and as many as there is room for; return the others."""
        part = chunk[: min(most, self.room)]
        self.samples[self.count : self.count + len(part)] = part
        self.count += len(part)
        self.taken += len(part)
        return chunk[len(part) :]

    def complete(self, chunk: NDArray[np.floating], most: int) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """The windows ``[window, sample, axis]`` that a chunk completes, at most so many, and the rest of it."""
        length, axes = self.samples.shape
        whole = min(most, (self.count + len(chunk)) // length)
        if not whole:
            return np.zeros((0, length, axes), self.samples.dtype), self.fill(chunk, length)
        used = whole * length - self.count
        windows = np.concatenate([self.samples[: self.count], chunk[:used]]).reshape(whole, length, axes)
        self.count, self.taken = 0, self.taken + used
        return windows, chunk[used:]


def held(
    config: AnyConfig, limits: Float[Array, "axis limit"], state: EncoderState, buffer: WindowBuffer, ends: bool = False
) -> LabelTracks:
    """Words that a stream holds, provisional or as its end would publish them, as host arrays ``[axis, slot]``.

    The state is that at the end of the last complete window; nothing changes.

    Raises:
        InputError: a stream in double precision, where JAX's 64-bit mode is off.
    """
    _check_precision(buffer.samples.dtype)
    count = np.full(limits.shape[0], buffer.count, np.int32)
    labels = rule_of(config).flush if ends else rule_of(config).provisional  # one program where they are the same
    return jax.tree.map(np.asarray, _held(labels, config, limits, state, buffer.samples.copy(), count))


class Encoder(Copyable):
    """Streaming encoder of one wrench: samples in as they come, labels out.

    The encoder keeps a state of fixed size and less than one window of samples. Labels are LabelTracks ``[axis, slot]``
    of host arrays, with one slot per window or, at the end, 1 + 2, 1 + 5 and 1 + 8 slots (by the fit rule 1 + 5 each);
    label 0 marks a slot where nothing was published. They equal those of :func:`rcbht_jax.encode` bit for bit, however
    the samples are divided into chunks. The encoder runs on the processor, also where JAX has a GPU.
    ``copy.copy`` gives an encoder that goes on from here, apart from this one.

    Args:
        config: static configuration; its type chooses the rule.
        thresholds: limits ``[axis, 4]``; for the fit rule FitLimits.
        dtype: float32 or float64 (the latter needs JAX's 64-bit mode, as long as the stream is used).

    Raises:
        InputError: no configuration, thresholds of wrong shape or not in order, or another dtype.

    Example:
        >>> import numpy as np, rcbht_jax as rj
        >>> encoder = rj.Encoder(rj.EncoderConfig(window=5, dt=0.005), rj.preset("hiro"))
        >>> [labels.primitive.label.shape for labels in encoder.push(np.zeros((12, 6)))]
        [(6, 1), (6, 1)]
        >>> encoder.received
        12
    """

    _fixed = ("_config", "_limits", "_state")

    def __init__(self, config: AnyConfig, thresholds: AnyLimits, dtype: DTypeLike = np.float32) -> None:
        self._rule = rule_of(config)
        limits = checked_limits(config, thresholds)
        if limits.ndim != 2:
            raise InputError(f"Thresholds have shape {(*limits.shape[:-1], 4)}; a stream expects [axis, 4].")
        kind = next((one for one in (np.float32, np.float64) if dtype in (one, one.__name__)), None)
        if kind is None or jax.dtypes.canonicalize_dtype(kind) != kind:
            raise InputError(f"A stream of {dtype} was asked for; expected float32, or float64 in JAX's 64-bit mode.")
        self._config = config
        self._limits = jax.device_put(np.array(limits, kind), host_device())  # a copy, which no caller can change
        self._axes = limits.shape[0]
        self._buffer = WindowBuffer(config.window, self._axes, kind)
        self._state = self._begun()

    @property
    def received(self) -> int:
        """Samples received so far."""
        return self._buffer.taken

    def push(self, samples: ArrayLike) -> list[LabelTracks]:
        """Feed any number of samples ``[time, axis]``; returns one entry per window that they complete.

        Raises:
            InputError: wrong shape, a frame of another rate, a value that is not finite, or more samples than are
                counted (``MOST_SAMPLES`` of :mod:`rcbht_jax.encoding.stream`); then nothing is consumed.
        """
        return list(self.windows(samples))

    def windows(self, samples: ArrayLike) -> Iterator[LabelTracks]:
        """Like :meth:`push`, but yields one entry at a time: in between, the stream is at the end of the window."""
        chunk = self._buffer.checked(read_chunk(samples, self._config.dt))
        while len(chunk):
            windows, chunk = self._buffer.complete(chunk, 1)
            for window in windows:
                self._state, packed = _step(self._config, self._limits, self._state, window)
                yield jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], _unpack(packed))

    def lines(self, samples: ArrayLike) -> Iterator[tuple[StraightLines, StraightLines]]:
        """Like :meth:`windows`, many windows at a time: the lines of their primitives and of the unfinished runs.

        Args:
            samples: ``[time, axis]``; they are consumed while the result is iterated over.

        Returns:
            words and runs of several windows, each as first sample, end, mean and slope per sample ``[window, axis]``;
            a window that published no word has a word without samples.

        Raises:
            InputError: the stream does not use the fit rule (only this rule has runs), wrong shape, or a value that is
                not finite.

        Example:
            >>> from rcbht_jax.encoding.tolerance import FitLimits
            >>> encoder = Encoder(FitConfig(), FitLimits(np.array([[4.0, 3, 2, 1]]), np.array([0.1])))
            >>> ((words, runs),) = encoder.lines(np.r_[np.zeros(20), np.arange(20)][:, None])
            >>> words[1][:, 0].tolist(), runs[0][:, 0].tolist()
            ([0, 0, 0, 0, 20, 0, 0, 0], [0, 0, 0, 0, 20, 20, 20, 20])
        """
        if not isinstance(self._config, FitConfig):
            raise InputError('Only words of the fit rule have a running line; choose rule="fit".')
        return self._blocks(self._config, self._buffer.checked(read_chunk(samples, self._config.dt)))

    def _blocks(self, config: FitConfig, chunk: NDArray[np.floating]) -> Iterator[tuple[StraightLines, StraightLines]]:
        while len(chunk):
            windows, chunk = self._buffer.complete(chunk, BLOCK)
            if len(windows):
                count = len(windows)
                block = np.concatenate([windows, np.zeros((BLOCK - count, *windows.shape[1:]), windows.dtype)])
                self._state, out = _lines(config, self._limits, self._state, block, np.int32(count))
                yield jax.tree.map(lambda rows, count=count: np.asarray(rows)[:count], out)

    def peek(self) -> LabelTracks:
        """Provisional labels of the words that are not published yet; the stream is unchanged.

        By the paper's rule they are what the stream would publish if it ended now; by the fit rule, what its words will
        be if the present run continues (:mod:`rcbht_jax.encoding.provisional`).
        """
        return held(self._config, self._limits, self._state, self._buffer)

    def ending(self) -> LabelTracks:
        """The labels that the stream would publish if it ended now; the stream is unchanged."""
        return held(self._config, self._limits, self._state, self._buffer, ends=True)

    def flush(self) -> LabelTracks:
        """End the stream and return the labels still held. Afterwards a new stream starts."""
        tracks = self.ending()
        self.restart()
        return tracks

    def restart(self) -> None:
        """Start a new stream and discard the labels still held."""
        self._state, self._buffer.count, self._buffer.taken = self._begun(), 0, 0

    def _begun(self) -> EncoderState:
        _check_precision(self._buffer.samples.dtype)
        state: EncoderState = self._rule.init(self._config, (self._axes,), self._buffer.samples.dtype)
        return jax.device_put(state, host_device())
