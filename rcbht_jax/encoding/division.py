"""Quotients that every device rounds alike: XLA's own are a digit or two off on a GPU in single precision."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from rcbht_jax.types import Array

_SPLIT = {4: 2**12 + 1, 8: 2**27 + 1}  # by bytes of a number: makes halves, whose products are exact


def quotient(x: Array, y: Array) -> Array:
    """``x / y`` as IEEE 754 rounds it, as a CPU does.

    On a GPU, quotients from 1e-30 to 1e30 are, of divisors in the same range; others may be a digit off.

    Example:
        >>> quotient(jnp.float32(2), jnp.float32(3)) == np.float32(2) / np.float32(3)
        Array(True, dtype=bool)
    """
    x, y = jnp.broadcast_arrays(x, y)
    if x.dtype != jnp.float32 or jax.default_backend() != "gpu":
        return jax.lax.div(x, y)
    return jax.lax.platform_dependent(x, y, cuda=corrected, default=jax.lax.div)


def exact(x: Array, y: Array) -> Array:
    """As :func:`quotient`, whatever a compiler makes of a quotient: a digit is off where a drain has a single lane."""
    x, y = jnp.broadcast_arrays(x, y)
    return corrected(x, y)


def fenced(product: Array) -> Array:
    """A product that may be added to something: no compiler contracts the two into one operation."""
    return jnp.maximum(product, float(np.finfo(product.dtype).min))


@jax.custom_jvp
def corrected(x: Array, y: Array) -> Array:
    """The quotient of arrays of one shape, in single or double precision, from one that is a few digits off."""
    rough = jax.lax.div(x, y)
    near = rough + fenced(jax.lax.div(_remainder(x, rough, y), y))  # the quotient, or the number next to it
    rest = _remainder(x, near, y)
    up = (rest > 0) == (y > 0)
    other = jax.lax.nextafter(near, jnp.where(up, jnp.inf, -jnp.inf).astype(near.dtype))
    nearer = 2 * jnp.abs(rest) > jnp.abs(y) * jnp.abs(other - near)  # without rounding, and never equal
    found = jnp.where(nearer, other, near)
    return jnp.where(jnp.isfinite(found), found, rough)


@corrected.defjvp
def _derivative(at: tuple[Array, Array], along: tuple[Array, Array]) -> tuple[Array, Array]:
    """Of the quotient itself: its corrections have none of any use."""
    (x, y), (dx, dy) = at, along
    found = corrected(x, y)
    return found, jax.lax.div(dx - found * dy, y)


def _remainder(x: Array, q: Array, y: Array) -> Array:
    """``x - q * y`` without the rounding of the product (Dekker 1971)."""
    product = fenced(q * y)
    (q_high, q_low), (y_high, y_low) = _halves(q), _halves(y)
    lost = (fenced(q_high * y_high) - product) + fenced(q_high * y_low) + fenced(q_low * y_high) + fenced(q_low * y_low)
    return (x - product) - lost


def _halves(x: Array) -> tuple[Array, Array]:
    scaled = fenced(_SPLIT[x.dtype.itemsize] * x)
    high = scaled - (scaled - x)
    return high, x - high
