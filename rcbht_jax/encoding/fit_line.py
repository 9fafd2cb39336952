"""Straight lines through runs of samples: through a window, and through two neighbours as if through all their samples.

Results do not depend on how a compiler fuses this code: no rounded product meets a sum or another constant unfenced,
and nothing is divided by what could be a constant, lest it become a product with the reciprocal. Times are counted in
samples from the middle of a run and values from its mean, so that single precision loses nothing over long runs; the
growth of the squared residual is a sum of squares, never a difference of large numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.encoding.segments import sums, unrolled
from rcbht_jax.types import Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Line:
    """The least-squares line through ``count`` neighbouring samples of each lane."""

    count: Int[Array, "*lanes"]  # int32, samples; 0 = no line
    mean: Float[Array, "*lanes"]  # N or Nm, value in the middle
    slope: Float[Array, "*lanes"]  # N or Nm per sample


def fenced(product: Array) -> Array:
    """A product that may be added to something: no compiler contracts the two into one operation."""
    return jnp.maximum(product, float(np.finfo(product.dtype).min))


def window_line(samples: Float[Array, " window *lanes"], count: Int[Array, "*lanes"]) -> tuple[Line, Array]:
    """The line through the first ``count`` samples of each lane, and its squared residual.

    Args:
        samples: N or Nm, window >= 2.
        count: samples that count, <= window; fewer than 2 give no line.

    Returns:
        the line and the sum of the squared residuals ``[*lanes]``, N^2 or (Nm)^2.

    Example:
        >>> line, residual = window_line(jnp.array([[1.0], [2.0], [3.0]]), jnp.array([3]))
        >>> line.mean.tolist(), line.slope.tolist(), residual.tolist()
        ([2.0], [1.0], [0.0])
    """
    local = samples - samples[:1]
    size = jnp.maximum(count, 2)
    middle = (size.astype(samples.dtype) - 1) / 2
    total, moment = sums(local, count, middle)
    per_sample, per_spread = (jnp.asarray(table, samples.dtype)[size] for table in _reciprocals(samples.shape[0]))
    mean, slope = fenced(total * per_sample), fenced(moment * per_spread)

    def add(residual: Array, row: tuple[Array, Array]) -> tuple[Array, None]:
        index, y = row
        error = y - (mean + fenced((index.astype(y.dtype) - middle) * slope))
        return residual + jnp.where(index < count, fenced(error * error), 0), None

    index = jnp.arange(samples.shape[0], dtype=jnp.int32)
    residual, _ = jax.lax.scan(add, jnp.zeros_like(total), (index, local), unroll=unrolled(samples.shape[0]))
    used = jnp.where(count >= 2, count, 0)
    return Line(used, samples[0] + mean, slope), residual


def join(a: Line, b: Line) -> tuple[Line, Array]:
    """The line through the samples of two neighbours, a first, and by how much the squared residual grows.

    The counts must not be constants of a compiled program, see above.

    Three slopes speak for the joint one: those of the two lines and that of the line between their middles. Each has
    the weight of the squared times that it explains; the residual grows by their weighted squared deviations.

    Returns:
        the line, and 12 times the growth ``[*lanes]``: the residual of the joint line less those of the two.
    """
    na, nb = a.count.astype(a.mean.dtype), b.count.astype(a.mean.dtype)
    n = na + nb
    between = jnp.maximum(n, 1)
    step = (b.mean - a.mean) / between
    whole = jnp.maximum(_spread(n), 1)
    third = 3 * na * nb * n  # _spread(na) + _spread(nb) + third == _spread(n)
    slope = a.slope + fenced(_spread(nb) / whole * (b.slope - a.slope))
    slope = slope + fenced(third / whole * (2 * step - a.slope))
    parts = ((_spread(na), a.slope - slope), (_spread(nb), b.slope - slope), (third, 2 * step - slope))
    growth = jnp.zeros_like(slope)
    for weight, deviation in parts:
        growth = growth + fenced(weight * deviation * deviation)
    return Line(a.count + b.count, a.mean + fenced(nb * step), slope), growth


def _reciprocals(window: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of n = 0 ... window samples, and of the sum of their squared offsets from the middle; 0 for fewer than two."""
    n = np.arange(window + 1, dtype=np.float64)
    each = np.stack([n, n * (n * n - 1) / 12])
    first, second = np.divide(1, each, out=np.zeros_like(each), where=n >= 2)
    return first, second


def _spread(n: Array) -> Array:
    """12 times the sum of squared offsets of n samples from their middle; products only."""
    return n * (n - 1) * (n + 1)
