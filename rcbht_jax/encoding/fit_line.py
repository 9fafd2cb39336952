"""Straight lines through runs of samples: through a span, through two neighbours, and how badly they take new samples.

Results do not depend on how a compiler fuses this code: no rounded product meets a sum or another constant unfenced,
and nothing is divided by what could be a constant, lest it become a product with the reciprocal. Times are counted in
samples from the middle of a run and values from its mean; the growth of a squared residual is a sum of squares over the
last few samples, never a difference of large numbers. What single precision loses over long runs is the mean's last
digit at every window (docs/fit_rule.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.encoding.division import fenced, quotient
from rcbht_jax.encoding.segments import unrolled
from rcbht_jax.types import Array

# Samples up to which a loop is straight-line code: of 45, each repeats those before it, and a step takes minutes.
_STRAIGHT = 32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Line:
    """The least-squares line through ``count`` neighbouring samples of each lane."""

    count: Int[Array, "*lanes"]  # int32, samples; 0 = no line
    mean: Float[Array, "*lanes"]  # N or Nm, value in the middle
    slope: Float[Array, "*lanes"]  # N or Nm per sample


def span_line(samples: Float[Array, " window *lanes"], start: Int[Array, "*lanes"], stop: Int[Array, "*lanes"]) -> Line:
    """The line through the samples of each lane from ``start`` up to, but not with, ``stop``.

    Args:
        samples: N or Nm, window >= 2; all finite, because sums are counted from the one in the middle.
        start: first sample that counts.
        stop: its end, at most the window; an empty span gives no line, a single sample a level.

    Example:
        >>> line = span_line(jnp.array([[9.0], [1.0], [2.0], [3.0]]), jnp.array([1]), jnp.array([4]))
        >>> line.count.tolist(), line.mean.tolist(), line.slope.tolist()
        ([3], [2.0], [1.0])
    """
    length = samples.shape[0]
    origin = samples[length // 2]
    count = jnp.maximum(stop - start, 0)
    middle = (start + stop - 1).astype(samples.dtype) / 2
    spread = jnp.asarray(_spreads(length), samples.dtype)[count]

    def add(sums: tuple[Array, Array], row: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
        index, y = row
        y = jnp.where((index >= start) & (index < stop), y - origin, 0)
        return (sums[0] + y, sums[1] + fenced((index.astype(y.dtype) - middle) * y)), None

    zero = jnp.zeros_like(origin)
    index = jnp.arange(length, dtype=jnp.int32)
    (total, moment), _ = jax.lax.scan(add, (zero, zero), (index, samples), unroll=unrolled(length))
    # Quotients, because a compiler that fuses a step into one loop per output repeats products, but no division.
    mean = origin + quotient(total, jnp.maximum(count, 1).astype(samples.dtype))
    return Line(count, mean, quotient(moment, spread))


class _Growing(NamedTuple):
    """A line that samples join one by one: its value at the last sample, its slope, the squared residual."""

    end: Array
    slope: Array
    residual: Array

    def add(self, y: Array, joins: Array, n: Array, share: Array) -> _Growing:
        """The next sample, where it joins a line of ``n`` samples (recursive least squares); ``share`` is _share(n)."""
        ahead = self.end + self.slope
        error = jnp.where(joins, y - ahead, 0)
        part = share * error
        end = jnp.where(joins, ahead + fenced((4 * n + 2) * part), self.end)
        slope = self.slope + jnp.where(n > 0, fenced(6 * part), 0)
        return _Growing(end, slope, self.residual + fenced(n * (n - 1) * part * error))


def _share(n: Array) -> Array:
    """Of an error in the sample that a line of n samples predicts: apart, because a loop with divisions is slow."""
    return quotient(jnp.ones_like(n), (n + 1) * (n + 2))


def residuals_after(
    samples: Float[Array, " window *lanes"], stop: Int[Array, "*lanes"]
) -> Float[Array, " window *lanes"]:
    """Squared residual of the line through the samples from each one up to, but not with, ``stop``.

    Example:
        >>> y = jnp.array([[0.0], [6.0], [2.0], [1.0], [9.0]])
        >>> [round(value, 3) for value in residuals_after(y, jnp.array([4]))[:, 0].tolist()]
        [20.7, 1.5, 0.0, 0.0, 0.0]
    """

    def add(line: _Growing, row: tuple[Array, Array]) -> tuple[_Growing, Array]:
        index, y = row
        n = jnp.maximum(stop - 1 - index, 0).astype(y.dtype)
        line = line.add(y, index < stop, n, _share(n))
        return line, line.residual

    zero = jnp.zeros_like(samples[0])
    rows = (jnp.arange(samples.shape[0], dtype=jnp.int32), samples)
    start = _Growing(zero, zero, zero)
    return jax.lax.scan(add, start, rows, reverse=True, unroll=unrolled(samples.shape[0], _STRAIGHT))[1]


def best_break(
    line: Line,
    samples: Float[Array, " window *lanes"],
    after: Float[Array, " window *lanes"],
    start: Int[Array, "*lanes"],
    stop: Int[Array, "*lanes"],
    shortest: int,
) -> tuple[Int[Array, "*lanes"], Float[Array, "*lanes"]]:
    """Where two lines in place of one save most squared residual, and how much.

    Args:
        line: whose next sample is the one at ``start``; maybe empty.
        samples: N or Nm.
        after: of :func:`residuals_after`.
        start: first sample that joins the line.
        stop: end of the samples that join.
        shortest: samples that either line must have.

    Returns:
        the first sample of the second line, the earliest of equals, and what it saves, N^2 or (Nm)^2; nothing where no
        place is allowed.

    Example:
        >>> y = jnp.array([[0.0], [0.0], [0.0], [5.0], [5.0]])
        >>> none, zero, five = Line(*(jnp.zeros(1, t) for t in (int, float, float))), jnp.array([0]), jnp.array([5])
        >>> index, saved = best_break(none, y, residuals_after(y, five), zero, five, 2)
        >>> index.tolist(), round(saved.item(), 3)
        ([3], 7.5)
    """
    places = jax.lax.broadcasted_iota(jnp.int32, samples.shape, 0)
    n = (line.count[None] + jnp.maximum(places - start[None], 0)).astype(samples.dtype)
    allowed = (n >= shortest) & (places >= start[None]) & (places <= stop[None] - shortest)
    joins = (places >= start[None]) & (places < stop[None])
    zero = jnp.zeros_like(line.mean)
    end = line.mean + fenced(line.slope * (line.count.astype(samples.dtype) - 1) * 0.5)

    def add(carry: tuple[_Growing, Array, Array], row: tuple[Array, ...]) -> tuple[tuple[_Growing, Array, Array], None]:
        line, least, found = carry
        place, y, rest, allowed, *about = row
        apart = line.residual + rest
        better = allowed & (apart < least)
        return (line.add(y, *about), jnp.where(better, apart, least), jnp.where(better, place, found)), None

    rows = (places, samples, after, allowed, joins, n, _share(n))
    carry = (_Growing(end, line.slope, zero), jnp.full_like(zero, np.inf), jnp.zeros_like(start))
    (whole, least, found), _ = jax.lax.scan(add, carry, rows, unroll=unrolled(samples.shape[0], _STRAIGHT))
    return found, jnp.maximum(whole.residual - least, 0)


def join(a: Line, b: Line) -> Line:
    """The line through the samples of two neighbours, a first.

    The counts must not be constants of a compiled program, see above.

    Three slopes speak for the joint one: those of the two lines and that of the line between their middles. Each has
    the weight of the squared times that it explains.
    """
    na, nb = a.count.astype(a.mean.dtype), b.count.astype(a.mean.dtype)
    n = na + nb
    step = quotient(b.mean - a.mean, jnp.maximum(n, 1))
    whole = jnp.maximum(_spread(n), 1)
    third = 3 * na * nb * n  # _spread(na) + _spread(nb) + third == _spread(n)
    slope = a.slope + fenced(quotient(_spread(nb), whole) * (b.slope - a.slope))
    slope = slope + fenced(quotient(third, whole) * (2 * step - a.slope))
    return Line(a.count + b.count, a.mean + fenced(nb * step), slope)


def _spreads(window: int) -> NDArray[np.float64]:
    """Sum of squared offsets from the middle of n = 0 ... window samples; 1 for fewer than two."""
    n = np.arange(window + 1, dtype=np.float64)
    return np.where(n < 2, 1, n * (n * n - 1) / 12)


def _spread(n: Array) -> Array:
    """12 times the sum of squared offsets of n samples from their middle; products only."""
    return n * (n - 1) * (n + 1)
