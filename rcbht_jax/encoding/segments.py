"""Windows of samples to labelled straight-line segments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from rcbht_jax.encoding.division import fenced, quotient
from rcbht_jax.labels import Primitive
from rcbht_jax.types import Array, Segment

_UNROLLED = 64  # windows up to this many samples become straight-line code
_AT_ONCE = 8  # samples of longer ones: 64 compile seven times as long and run no faster
_TINY = 1e-4  # of the small limit, added to all slopes and limits: keeps the logarithm finite at slope 0
_SURE = 40.0  # logit of the sign of a slope far above the small limit


Divide = Callable[[Array, Array], Array]


def fit(samples: Array, count: Array, limits: Array, dt: float, t0: Array) -> Segment:
    """Least-squares line through the first ``count`` samples of each lane's window.

    The result does not depend on how a compiler fuses this code: fences keep products from being fused with sums, and
    barriers keep divisors from becoming reciprocals.

    Args:
        samples: float ``[window, ...]``, N or Nm, window >= 2.
        count: int32 ``[...]``, samples that count, <= window; fewer than 2 give an empty segment.
        limits: float ``[4, ...]``, gradient limits per lane, largest first, N/s or Nm/s.
        dt: seconds between samples.
        t0: int32 ``[...]``, index of the first sample.

    Returns:
        one segment per lane; its extremes are those of the line at the first and last sample.
    """
    slope, x = line(samples, count, dt, t0)
    label = jnp.where(count >= 2, gradient_label(slope, limits), 0)
    return Segment(label, x.t0, x.t1, x.vmax, x.vmin, x.area, x.rise)


def line(samples: Array, count: Array, dt: float, t0: Array) -> tuple[Array, Segment]:
    """What :func:`fit` finds without thresholds: slopes ``[...]``, N/s or Nm/s, and segments whose label is 0."""
    dtype = samples.dtype
    count = jnp.where(t0 < 0, 0, count)  # never negative, but no compiler knows: one lane's barrier hides no constant
    n = jnp.maximum(count, 2).astype(dtype)
    total, moment = sums(samples, count, (n - 1) / 2)
    spread = jnp.asarray(squared_offsets(samples.shape[0], dt), dtype)[jnp.maximum(count, 2)]
    n, spread, period = jax.lax.optimization_barrier((n, spread, jnp.full_like(n, dt)))
    return line_of(total, moment, n, spread, period, t0, count)


def window_lines(wrench: Array, length: Array, window: int, dt: float) -> tuple[Array, Array, Segment]:
    """Samples that count, slope and line of every window of recordings ``[recording, window, axis]``.

    Args:
        wrench: float ``[recording, time, axis]``, N or Nm, made of whole windows.
        length: int32 ``[recording]``, samples that count.
        window: samples of one.
        dt: seconds between samples.
    """
    recordings, samples, axes = wrench.shape
    first = jnp.arange(samples // window, dtype=jnp.int32) * window
    size = jnp.clip(length[:, None] - first[None], 0, window)
    size = jnp.broadcast_to(size[..., None], (*size.shape, axes))
    rows = jnp.moveaxis(wrench.reshape(recordings, len(first), window, axes), 2, 0)
    return size, *line(rows, size, dt, jnp.broadcast_to(first[None, :, None], size.shape))


def line_of(
    total: Array, moment: Array, n: Array, spread: Array, period: Array, t0: Array, count: Array,
    divide: Divide = quotient,
) -> tuple[Array, Segment]:  # fmt: skip
    """What :func:`line` returns, from the sums over ``n`` samples; the compiler must not know ``n`` and ``spread``.

    ``divide`` is the quotient as IEEE 754 rounds it.
    """
    slope = divide(moment, spread)
    half = jnp.abs(slope) * (n - 1) * period * 0.5
    mean = divide(total, n)
    rise = divide(moment * n, spread)  # slope * n would be fused with the sum that it enters
    return slope, Segment(jnp.zeros_like(t0), t0, t0 + count, mean + half, mean - half, total, rise)


def squared_offsets(window: int, dt: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """dt times the sum of squared offsets from the middle of n = 0 ... window samples."""
    n = np.arange(window + 1, dtype=np.float64)
    return dt * (n * (n * n - 1) / 12)


def sums(samples: Array, count: Array, middle: Array) -> tuple[Array, Array]:
    """Sum and first moment about the middle of the samples that count, in order of time."""

    def add(sums: tuple[Array, Array], row: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
        return accumulate(sums, *row, count, middle), None

    zero = jnp.zeros_like(samples[0])
    index = jnp.arange(samples.shape[0], dtype=jnp.int32)
    found, _ = jax.lax.scan(add, (zero, zero), (index, samples), unroll=unrolled(samples.shape[0]))
    return found


def accumulate(sums: tuple[Array, Array], index: Array, y: Array, count: Array, middle: Array) -> tuple[Array, Array]:
    """The sums with one more sample, if it counts."""
    product = fenced((index.astype(y.dtype) - middle) * y)
    on = index < count
    return sums[0] + jnp.where(on, y, 0), sums[1] + jnp.where(on, product, 0)


def unrolled(window: int, most: int = _UNROLLED) -> int | bool:
    """How far a scan over the samples of a window is unrolled: whole, if they are not more than ``most``."""
    return True if window <= most else _AT_ONCE


def gradient_label(slope: Array, limits: Array) -> Array:
    """Primitive code int32 ``[...]`` of slopes ``[...]``; limits ``[4, ...]`` are inclusive on their larger side."""
    size = jnp.abs(slope)
    rank = sum((size < limit).astype(jnp.int32) for limit in limits)  # 0 impulse ... 3 small, 4 constant
    up = slope > 0
    ramp = jnp.where(up, rank, rank + (Primitive.BNEG - Primitive.BPOS))
    impulse = jnp.where(up, jnp.int32(Primitive.PIMP), jnp.int32(Primitive.NIMP))
    constant = jnp.int32(Primitive.CONS)
    return jnp.where(rank == 4, constant, jnp.where(rank == 0, impulse, ramp))


def soft_windows(slope: Array, limits: Array, temperature: Array | float) -> Array:
    """Distribution over the nine primitives of windows.

    Args:
        slope: float ``[...]``, N/s or Nm/s.
        limits: float ``[..., 4]``, largest first, broadcastable against ``slope``.
        temperature: width of the boundaries in units of the logarithm of the slope, > 0.

    Returns:
        float ``[..., 9]`` that sums to 1.
    """
    size, tiny = jnp.abs(slope)[..., None], _TINY * limits[..., 3:]
    distance = jnp.log(size + tiny) - jnp.log(limits + tiny)
    above = jax.nn.sigmoid(distance / temperature)  # impulse, big, medium, small or more
    some = jnp.diff(above, axis=-1)  # big, medium, small
    # The sign turns where the slope is far below the small limit, and is certain at that limit.
    up = jax.nn.sigmoid(_SURE * slope / (jnp.abs(slope) + limits[..., 3] * temperature))[..., None]
    constant, impulse = 1 - above[..., 3:], above[..., :1]
    parts = [some * up, some * (1 - up), constant, impulse * up, impulse * (1 - up)]
    return jnp.concatenate(parts, -1)


def as_floating(wrench: Array) -> Float[Array, "..."]:
    """A signal in a precision of the encoders: float64 stays in JAX's 64-bit mode, all else becomes float32."""
    wrench = jnp.asarray(wrench)
    return wrench if wrench.dtype == np.float64 else wrench.astype(jnp.float32)


def varying_as(samples: Array, state: Any) -> Any:
    """A loop's initial state, for shard_map varying over the same mesh axes as the samples."""
    return jax.tree.map(lambda leaf: leaf + jnp.zeros_like(samples, leaf.dtype, leaf.shape), state)


def whole_windows(
    samples: Float[Array, "time lane"], count: Int[Array, " lane"], window: int
) -> tuple[Float[Array, "padded lane"], Int[Array, "window lane"]]:
    """Samples with zeros up to a whole number of windows, and how many samples of each window count."""
    windows = -(-samples.shape[0] // window)
    start = jnp.arange(windows, dtype=jnp.int32)[:, None] * window
    return jnp.pad(samples, ((0, windows * window - samples.shape[0]), (0, 0))), jnp.clip(
        count[None] - start, 0, window
    )
