"""Gradient limits of one recording: the hand-set rule and the calibrated rule of the two-arm simulation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from rcbht_jax.encoding.thresholds import preset, validate
from rcbht_jax.errors import InputError
from rcbht_jax.labels import Primitive

Extent = Float64[np.ndarray, "6"]
Limits = Float64[np.ndarray, "6 4"]  # impulse, big, medium, small, N/s or Nm/s

_SMALL_DOMAIN = 1.9  # N or Nm
_MARGIN = 0.02
_SCALE = 10.0

# Impulse, big, medium, small limits, N/s and Nm/s, of the original two-arm simulation (a trial of 2015).
_FX = (27.31592, 18.32932, 9.34272, 0.35612)
_FYZ = (12.55750, 8.49037, 4.42325, 0.35612)
_MOMENT = (27.31592, 18.22114, 9.12637, 0.03159)
CALIBRATED: Limits = np.array([_FX, _FYZ, _FYZ, _MOMENT, _MOMENT, _MOMENT])


def domain(wrench: Float64[np.ndarray, "sample 6"], clean: bool = False) -> Extent:
    """Extent of each axis, N or Nm.

    The original program adds the magnitudes of the widened 4th largest and 4th smallest samples, which is no range
    when the signal has an offset (Q2); ``clean`` takes their difference.
    """
    ordered = np.sort(wrench, axis=0)
    high, low = ordered[-4], ordered[3]
    if clean:
        return np.asarray(high - low)
    top, bottom = high + _MARGIN * high, low - _MARGIN * low
    return np.asarray(np.abs(top) + np.abs(bottom))


def spectrum(impulse: float, constant: float) -> Float64[np.ndarray, 4]:
    """Four limits evenly spaced between the impulse limit and the constant limit."""
    step = (impulse - constant) / 3
    return np.array([impulse, impulse - step, impulse - 2 * step, impulse - 3 * step])


def hand_set(extent: Extent, robot: str) -> Limits:
    """Limits without calibration; those of HIRO's moments of small domain are divided by ten.

    Raises:
        InputError: the robot is unknown.
    """
    limits = np.tile(np.asarray(preset(robot).limits, np.float64)[0], (6, 1))
    if robot == "hiro":
        small = (extent < _SMALL_DOMAIN) & (np.arange(6) >= 3)
        limits[small] /= _SCALE
    return limits


def calibrated(extent: Extent, clean: bool = False) -> Limits:
    """Limits of the two-arm calibration, adapted to the domain.

    The original program adapts forces too, and divides only the impulse limit (Q4); ``clean`` adapts moments only
    and divides all four limits.
    """
    limits = CALIBRATED.copy()
    for axis in np.flatnonzero(extent < _SMALL_DOMAIN):
        if not clean:
            limits[axis] = spectrum(limits[axis, 0] / _SCALE, limits[axis, 3])
        elif axis >= 3:
            limits[axis] /= _SCALE
    return limits


def explicit(limits: Float[np.ndarray, "axis limit"]) -> Limits:
    """Limits of the caller, checked.

    Raises:
        InputError: they are not ``[6, 4]``, positive and decreasing.
    """
    validate(limits)
    if limits.shape != (6, 4):
        raise InputError(f"Thresholds have shape {limits.shape}; expected [6, 4], one row per axis.")
    return limits.astype(np.float64)


def mirrored(limits: Limits) -> Float64[np.ndarray, "6 8"]:
    """The limits and their negatives, from the largest to the smallest."""
    return np.concatenate([limits, -limits[:, ::-1]], axis=1)


def classify(slope: float, limits: tuple[float, ...], clean: bool = False) -> Primitive:
    """Primitive of a slope, given four limits, largest first.

    Raises:
        InputError: the slope is exactly minus the impulse limit, for which the original program has no label (Q5);
            ``clean`` labels it a negative impulse.
    """
    impulse, big, medium, small = limits
    size = abs(slope)
    if slope == -impulse and not clean:
        raise InputError(
            f"A slope equals minus the impulse limit ({slope}), for which the original program has no label; "
            "use the clean mode or another limit."
        )
    negative = slope < 0
    if size >= impulse:
        return Primitive.NIMP if negative else Primitive.PIMP
    if size >= big:
        return Primitive.BNEG if negative else Primitive.BPOS
    if size >= medium:
        return Primitive.MNEG if negative else Primitive.MPOS
    if size >= small:
        return Primitive.SNEG if negative else Primitive.SPOS
    return Primitive.CONS
