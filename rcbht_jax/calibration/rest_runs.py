"""Limits and tolerances of the fit rule for an unknown robot, from its runs at rest.

Rest is found as for the paper's rule (:mod:`rcbht_jax.calibration.rest`), and so are the gradient limits. The tolerance
begins where a break saves 20 variances of the noise, which is what straight lines through rest leave of the signal, and
rises until rest is constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from rcbht_jax.calibration.rest import BLOCK, QUANTILES, excess, rest_thresholds
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.rules import AnyLimits
from rcbht_jax.encoding.tolerance import NOISE, FitLimits, auto_tolerance
from rcbht_jax.errors import InputError
from rcbht_jax.types import Array, LabelTrack, Recordings

CONSTANT = 0.95  # share of the time at rest that shall be constant
STEPS = 2.0 ** (np.arange(13) / 2)  # tolerances to try, in the least one
RANGE = 2.0 ** (np.arange(-8, 5) / 2)  # tolerances of a penalty and of a search, in automatic ones


@dataclass(frozen=True)
class FitRestCalibration:
    """Limits and what they do.

    Attributes:
        limits: gradient limits ``[axis, 4]`` and tolerances ``[axis]``.
        constant: share of the time at rest that is labelled constant.
    """

    limits: FitLimits
    constant: Float[np.ndarray, " axis"]


def fit_rest_limits(recordings: Recordings, config: FitConfig) -> FitRestCalibration:
    """Gradient limits of :func:`rcbht_jax.calibration.rest.rest_thresholds` and the least tolerances for a calm rest.

    Of the tolerances that are tried for an axis, from that of its noise at rest to 64 times that, the first one is
    taken by which 95 % of the time at rest is constant, or else the one by which most of it is.

    Args:
        recordings: any axes and units.
        config: of the fit rule; its window and period are those that the limits are for.

    Raises:
        InputError: no recording is as long as two windows, or an axis never rests for half a second.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> wrench = rng.normal(size=(4, 1000, 1)) * 0.01
        >>> wrench[:, 500:520] += np.linspace(0, 10, 20)[:, None]
        >>> wrench[:, 520:] += 10
        >>> recordings = Recordings.from_arrays(wrench, rate=100, axes=["grip"], units=["N"])
        >>> found = fit_rest_limits(recordings, FitConfig(5, 0.01))
        >>> bool(0.015 < found.limits.tolerance[0] < 0.1), bool(found.constant[0] >= 0.95)
        (True, True)
    """
    calibrated = rest_thresholds(recordings, config.window, "fit")
    least = _rest_noise(recordings, calibrated.rest, config)
    runs = _runs(recordings, config, least * STEPS[:, None], calibrated.rest)
    share = 1 - runs.moving(np.asarray(calibrated.thresholds.limits)[:, 3])
    enough = share >= CONSTANT
    chosen = np.where(enough.any(0), enough.argmax(0), share.argmax(0))
    axes = np.arange(share.shape[1])
    limits = FitLimits(np.asarray(calibrated.thresholds.limits), runs.tolerance[chosen, axes])
    return FitRestCalibration(limits, share[chosen, axes])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RestRuns:
    """How steep runs at rest are by several tolerances, as the methods of calibration penalise what is not constant.

    Attributes:
        tolerance: ``[tolerance, axis]``, increasing.
        steep: ``[tolerance, axis, quantile]`` steepness over the time at rest, increasing, in units of the axis per
            second; 0 where a run is level within the tolerance.
        weight: of the penalty.
    """

    tolerance: Float[Array, "tolerance axis"]
    steep: Float[Array, "tolerance axis quantile"]
    weight: float | Array = 1.0

    @staticmethod
    def of(recordings: Recordings, config: FitConfig, weight: float = 1.0) -> RestRuns:
        """The runs of recordings by a sixteenth to four times the automatic tolerances.

        Raises:
            InputError: no recording is as long as two windows, or an axis has no rest.
        """
        rest = rest_thresholds(recordings, config.window, "fit").rest
        usual = auto_tolerance(recordings.wrench, recordings.length, config.needed)
        return _runs(recordings, config, usual * RANGE[:, None], rest, weight)

    def moving(self, small: Float[np.ndarray, " axis"]) -> Float[np.ndarray, "tolerance axis"]:
        """Share of the time at rest that is not constant, by each tolerance, with these small limits."""
        return np.asarray((np.asarray(self.steep) >= small[None, :, None]).mean(-1), np.float64)

    def penalty(self, limits: AnyLimits) -> Float[np.ndarray, "*candidate"]:
        """Weighted share of the time at rest that is not constant, mean of the axes; linear between tolerances.

        Raises:
            InputError: limits without tolerances.
        """
        limits = _with_tolerances(limits)
        low, high, part = (np.asarray(values) for values in self._between(limits.tolerance))
        small = np.asarray(limits.gradients)[..., 3, None]
        axis, steep = np.arange(low.shape[-1]), np.asarray(self.steep)
        shares = [(steep[index, axis] >= small).mean(-1) for index in (low, high)]
        return np.asarray(float(self.weight) * ((1 - part) * shares[0] + part * shares[1]).mean(-1), np.float64)

    def soft_penalty(self, limits: AnyLimits) -> Float[Array, ""]:
        """Mean logarithm by which runs at rest exceed the constant limit, with gradients for limits and tolerances.

        Raises:
            InputError: limits without tolerances.
        """
        limits = _with_tolerances(limits)
        low, high, part = self._between(limits.tolerance)
        axis = jnp.arange(low.shape[-1])
        steep, small = jnp.asarray(self.steep, limits.gradients.dtype), limits.gradients[..., 3, None]
        sizes = [excess(steep[index, axis], small).mean(-1) for index in (low, high)]
        return self.weight * ((1 - part) * sizes[0] + part * sizes[1]).mean()

    def _between(self, tolerance: Array) -> tuple[Array, Array, Array]:
        """Numbers of the tolerances below and above, and how far between them on a logarithmic scale."""
        tolerance = jnp.asarray(tolerance)
        place = jnp.log(tolerance)
        grid = jnp.log(jnp.asarray(self.tolerance, tolerance.dtype))
        wide = place[..., None, :] >= grid[(None,) * (place.ndim - 1)]
        low = jnp.clip(wide.sum(-2, dtype=jnp.int32) - 1, 0, grid.shape[0] - 2)
        axis = jnp.arange(grid.shape[1])
        part = (place - grid[low, axis]) / (grid[low + 1, axis] - grid[low, axis])
        return low, low + 1, jnp.clip(part, 0, 1)


def _runs(
    recordings: Recordings,
    config: FitConfig,
    tolerances: Float[np.ndarray, "tolerance axis"],
    rest: Bool[np.ndarray, "recording window axis"],
    weight: float = 1.0,
) -> RestRuns:
    """The runs of recordings by these tolerances."""
    any_limits = np.ones((len(recordings.axes), 4))  # lines do not depend on them
    steep = []
    for tolerance in tolerances:
        tracks = encode_batch(config, FitLimits(any_limits, tolerance), recordings.wrench, recordings.length)
        steep.append(_steepness(config, tracks.primitive, rest, tolerance))
    return RestRuns(np.asarray(tolerances, np.float64), np.stack(steep), weight)


def _with_tolerances(limits: AnyLimits) -> FitLimits:
    if not isinstance(limits, FitLimits):
        raise InputError("Runs at rest are those of the fit rule; its limits have a tolerance for every axis.")
    return limits


def _steepness(
    config: FitConfig,
    primitive: LabelTrack,
    rest: Bool[np.ndarray, "recording window axis"],
    tolerance: Float[np.ndarray, " axis"],
) -> Float[np.ndarray, "axis quantile"]:
    """Quantiles of the steepness of runs over the windows at rest; 0 for level runs."""
    windows, axes = rest.shape[1:]
    calm = np.concatenate([np.zeros_like(rest[:, :1], int), rest.cumsum(1)], axis=1)  # windows at rest before each
    row, axis, slot = np.nonzero(primitive.label > 0)
    t0, t1 = primitive.t0[row, axis, slot], primitive.t1[row, axis, slot]
    first, last = (np.minimum(time // config.window, windows) for time in (t0, t1))
    time = calm[row, last, axis] - calm[row, first, axis]
    slope = np.abs(primitive.grad[row, axis, slot].astype(np.float64))
    n = (t1 - t0).astype(np.float64)
    level = (slope * config.dt) ** 2 * (n**2 - 1) <= 12 * tolerance[axis] ** 2
    slope = np.where(level, 0.0, slope)
    return np.stack([_quantiles(slope[axis == k], time[axis == k], k) for k in range(axes)])


def _quantiles(values: NDArray[np.float64], weight: NDArray[np.integer], axis: int) -> Float[np.ndarray, " quantile"]:
    """Weighted quantiles in the middles of equal parts, of an axis."""
    if not weight.sum():
        raise InputError(f"Axis {axis}, from 0, is never at rest; record some rest, or calibrate by another method.")
    order = np.argsort(values, kind="stable")
    total = weight[order].cumsum()
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES * total[-1]
    return values[order][np.searchsorted(total, levels)]


def _rest_noise(
    recordings: Recordings, rest: Bool[np.ndarray, "recording window axis"], config: FitConfig
) -> Float[np.ndarray, " axis"]:
    """The tolerance of each axis by which noise at rest hardly ever breaks a line.

    Noise is what straight lines through blocks at rest leave of the signal: however fast it is, white or not.
    """
    windows = max(1, round(BLOCK / (config.window * recordings.dt)))  # of a block, as rest was separated from movement
    windows = max(windows, -(-3 // config.window))  # whole ones, so that blocks are those of the rest; a line needs 3
    samples = windows * config.window
    count, axes = min(rest.shape[1] // windows, recordings.wrench.shape[1] // samples), len(recordings.axes)
    cut = np.asarray(recordings.wrench[:, : count * samples], np.float64)
    cut = cut.reshape(len(recordings), count, samples, axes)
    time = np.arange(samples) - (samples - 1) / 2
    slope = np.einsum("rbta,t->rba", cut, time / (time**2).sum())
    left = cut - cut.mean(2, keepdims=True) - time[:, None] * slope[:, :, None]
    size = np.sqrt((left**2).mean(2))
    blocks = rest[:, : count * windows].reshape(len(recordings), count, windows, axes)
    calm = np.asarray(blocks.all(axis=2))
    if len(never := np.flatnonzero(~calm.any((0, 1)))):
        axis = recordings.axes[never[0]]
        raise InputError(f"{axis} is never at rest for {BLOCK} s; record some rest, or calibrate by another method.")
    noise = np.array([np.quantile(size[..., k][calm[..., k]], CONSTANT) for k in range(size.shape[2])])
    # An axis of few digits may be without noise: begin far below what is usual.
    usual = auto_tolerance(recordings.wrench, recordings.length, config.needed)
    return np.maximum((NOISE / config.needed) ** 0.5 * noise, usual / 64)
