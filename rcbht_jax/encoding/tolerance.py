"""Parameters of the fit rule for every axis: gradient limits, and how far a line may be from the signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax._util.signals import numbers_of
from rcbht_jax._util.values import SINGLE, ByValue, positive
from rcbht_jax.encoding.thresholds import validate
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array

SHARE = 0.015  # of an axis's usual range
USUAL = (1.0, 99.0)  # percentiles that bound the usual range
NOISE = 20.0  # noise variances that a break must save, lest noise break lines
FEWEST = 20  # new values from which on it shows whether they come regularly, and ...
REGULAR = 0.9  # ... share of the new values that come as regularly as those of a slower sensor do
_NORMAL_MAD = 0.6745  # median of |x| of a standard normal variable
_SECOND_DIFFERENCE = 6**0.5  # deviation of x[i] - 2 x[i+1] + x[i+2] of white noise of deviation 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FitLimits(ByValue):
    """Gradient limits and tolerance of every axis, for :mod:`rcbht_jax.encoding.fit`; equal if all numbers are.

    Attributes:
        gradients: float ``[..., axis, 4]``, impulse >= big >= medium >= small > 0, units of the axis per second.
        tolerance: float ``[..., axis]``, largest root-mean-square difference of line and samples; > 0.
    """

    gradients: Float[Array, "*batch axis 4"]
    tolerance: Float[Array, "*batch axis"]

    def stacked(self) -> NDArray[np.float64]:
        """Both as one host array ``[..., axis, 5]``, the tolerance last.

        Raises:
            InputError: limits or tolerances of wrong shape, not finite, not positive or not in order.

        Example:
            >>> FitLimits(np.array([[70.0, 46.0, 23.0, 1.0]]), np.array([0.5])).stacked().tolist()
            [[70.0, 46.0, 23.0, 1.0, 0.5]]
        """
        return stacked_limits(self.gradients, self.tolerance)


def stacked_limits(gradients: Any, tolerance: Any) -> NDArray[np.float64]:
    """As :meth:`FitLimits.stacked`; a single tolerance is that of all axes."""
    gradients = numbers_of(gradients, "A table of limits").astype(np.float64)
    tolerance = numbers_of(tolerance, "A list of tolerances").astype(np.float64)
    validate(gradients)
    try:
        tolerance = np.broadcast_to(tolerance, gradients.shape[:-1])
    except ValueError:
        raise InputError(
            f"Tolerances have shape {tolerance.shape}; expected one, or one for each of {gradients.shape[-2]} axes."
        ) from None
    if not positive(tolerance):
        raise InputError(
            f"Tolerances are {tolerance.min():g} to {tolerance.max():g}; expected positive numbers of 1.2e-38 to "
            "3.4e38, which single precision holds."
        )
    return np.concatenate([gradients, tolerance[..., None]], axis=-1)


def noise_of(parts: Sequence[Float[np.ndarray, "_time axis"]]) -> Float[np.ndarray, " axis"]:
    """Standard deviation of the noise of every axis, which is taken to be white.

    It comes from the median of second differences, which straight lines and rare jumps do not change. Where the
    recording repeats the values of a slower sensor, the differences are those of its own samples, and the deviation
    is that of white noise by which lines through the repeats would break as often: larger by the root of the repeats.

    Args:
        parts: recordings, units of the axes; those of fewer than three samples do not count.

    Returns:
        float64, units of the axes; 0 if no recording counts.

    Example:
        >>> noise = np.random.default_rng(0).normal(0, 0.5, (10_000, 1))
        >>> noise_of([np.linspace(0, 100, 10_000)[:, None] + noise]).round(1).tolist()
        [0.5]
        >>> noise_of([noise.repeat(4, axis=0)]).round(1).tolist()
        [1.0]
    """
    rows = [[_bends(axis) for axis in np.asarray(part, np.float64).T] for part in parts]
    bends = [np.concatenate(of_axis) for of_axis in zip(*rows, strict=True)]
    middle = np.array([np.median(one) if len(one) else 0.0 for one in bends])
    return middle / (_NORMAL_MAD * _SECOND_DIFFERENCE)


def _bends(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " bend"]:
    """Sizes of second differences, of a value that is held those from one new value to the next; see noise_of."""
    new = np.flatnonzero(np.diff(values)) + 1
    gaps = np.diff(new)
    repeats = int(np.median(gaps)) if len(gaps) >= FEWEST else 1
    if repeats == 1 or (np.abs(gaps - repeats) <= 1).mean() < REGULAR:  # few digits, too, repeat values
        return np.abs(np.diff(values, n=2))
    return repeats**0.5 * np.abs(np.diff(values[new], n=2))


@np.errstate(invalid="ignore", over="ignore")  # the encoder refuses what is not finite or too large, in a sentence
def auto_tolerance(
    wrench: Float[np.ndarray, "recording time axis"], length: Int[np.ndarray, " recording"], needed: int
) -> Float[np.ndarray, " axis"]:
    """A tolerance for every axis: 1.5 % of its usual range, or more where noise alone would break lines.

    The usual range lies between the 1st and 99th percentile of all samples; for the noise see :func:`noise_of`.

    Args:
        wrench: N and Nm.
        length: samples that count.
        needed: squared tolerances that a break must save, :attr:`FitConfig.needed`.

    Returns:
        float64, units of the axes; 1 for an axis that never changes, where any tolerance gives the same, and for one
        with values that encoders refuse.

    Example:
        >>> ramp = np.linspace(0, 100, 1001)[None, :, None]
        >>> auto_tolerance(ramp, np.array([1001]), needed=5).round(6).tolist()
        [1.47]
    """
    parts = [np.asarray(one[:samples], np.float64) for one, samples in zip(wrench, length, strict=True)]
    values = np.concatenate(parts)
    if not len(values):
        return np.ones(wrench.shape[2])
    low, high = np.percentile(values, USUAL, axis=0)
    tolerance = np.maximum(SHARE * (high - low), (NOISE / needed) ** 0.5 * noise_of(parts))
    spare = SHARE * (values.max(axis=0) - values.min(axis=0))  # an axis that changes more rarely than usual
    tolerance = np.where(tolerance > 0, tolerance, spare)
    return np.where((tolerance >= SINGLE[0]) & (tolerance <= SINGLE[1]), tolerance, 1.0)
