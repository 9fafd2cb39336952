"""Gradient limits of one recording: the hand-set rule and the calibrated two-arm rule (section 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding.thresholds import preset, validate
from rcbht_jax.errors import InputError
from rcbht_jax.labels import Primitive

_SMALL_DOMAIN = 1.9
_MARGIN = 0.02
_SCALE = 10.0

# Impulse, big, medium, small limits shipped with the two-arm simulation, from a trial of 2015.
_FX = (27.31592, 18.32932, 9.34272, 0.35612)
_FYZ = (12.55750, 8.49037, 4.42325, 0.35612)
_MOMENT = (27.31592, 18.22114, 9.12637, 0.03159)
CALIBRATED: NDArray[np.float64] = np.array([_FX, _FYZ, _FYZ, _MOMENT, _MOMENT, _MOMENT])


def domain(wrench: NDArray[np.float64], clean: bool = False) -> NDArray[np.float64]:
    """Extent of each axis, ``[6]`` in N or Nm, from a wrench ``[n, 6]``.

    The reference adds the magnitudes of the widened 4th largest and 4th smallest samples, which is no range
    when the signal has an offset (Q2); ``clean`` takes their difference.
    """
    ordered = np.sort(wrench, axis=0)
    high, low = ordered[-4], ordered[3]
    if clean:
        extent: NDArray[np.float64] = high - low
        return extent
    top, bottom = high + _MARGIN * high, low - _MARGIN * low
    widened: NDArray[np.float64] = np.abs(top) + np.abs(bottom)
    return widened


def spectrum(impulse: float, constant: float) -> NDArray[np.float64]:
    """Four limits evenly spaced between the impulse limit and the constant limit."""
    step = (impulse - constant) / 3
    return np.array([impulse, impulse - step, impulse - 2 * step, impulse - 3 * step])


def hand_set(extent: NDArray[np.float64], robot: str) -> NDArray[np.float64]:
    """Limits ``[6, 4]`` without calibration files; HIRO's moments of small domain get a tenth.

    Raises:
        InputError: unknown robot.
    """
    force: NDArray[np.float64] = preset(robot).limits[0]
    limits = np.tile(force, (6, 1))
    if robot == "hiro":
        small = (extent < _SMALL_DOMAIN) & (np.arange(6) >= 3)
        limits[small] /= _SCALE
    return limits


def calibrated(extent: NDArray[np.float64], clean: bool = False) -> NDArray[np.float64]:
    """Limits ``[6, 4]`` of the shipped two-arm calibration, adapted to the domain.

    The reference adapts forces too, and divides only the impulse limit (Q4); ``clean`` leaves the forces
    alone and divides all four limits of a moment.
    """
    limits = CALIBRATED.copy()
    for axis in np.flatnonzero(extent < _SMALL_DOMAIN):
        if not clean:
            limits[axis] = spectrum(limits[axis, 0] / _SCALE, limits[axis, 3])
        elif axis >= 3:
            limits[axis] /= _SCALE
    return limits


def explicit(limits: NDArray[np.floating]) -> NDArray[np.float64]:
    """Limits ``[6, 4]`` given by the caller, checked."""
    validate(limits)
    if limits.shape != (6, 4):
        raise InputError(f"Thresholds have shape {limits.shape}; expected [6, 4], one row per axis.")
    return limits.astype(np.float64)


def mirrored(limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """The eight numbers of the authors' table, ``[6, 8]``, from the largest to the smallest."""
    return np.concatenate([limits, -limits[:, ::-1]], axis=1)


def classify(slope: float, limits: tuple[float, ...], clean: bool = False) -> Primitive:
    """Primitive of a slope, given four limits, largest first.

    Raises:
        InputError: the slope equals minus the impulse limit exactly, for which the reference has no label
            (Q5); ``clean`` calls it a negative impulse.
    """
    impulse, big, medium, small = limits
    size = abs(slope)
    if slope == -impulse and not clean:
        raise InputError(
            f"A slope equals minus the impulse limit ({slope}), for which the reference has no label; "
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
