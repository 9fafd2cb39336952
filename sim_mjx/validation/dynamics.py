"""Fast events of the force: the first impact of the parts, and the ringing after the push that begins mating."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int
from numpy.typing import NDArray

from sim_mjx.assembly.task import CONTROL_PERIOD

RINGING = 4.0  # s after mating begins, in which the ringing is measured
IMPACT = 0.5  # s after touch, in which the first impact peaks
PERIODS = 2  # of the ringing, over which its amplitude is taken

Floats = NDArray[np.floating]
Forces = Float[np.ndarray, "trial time"]  # N, at the control period
Times = Float[np.ndarray, " trial"]  # s


class Ring(NamedTuple):
    """Ringing of a force: medians over trials."""

    hertz: float  # strongest frequency between 1 and 6 Hz
    peak: float  # N, in the first second
    damping: float  # damping ratio: decay rate of its amplitude over its angular frequency


@dataclass(frozen=True)
class Dynamics:
    """Fast events of a set of trials."""

    impact: Float64[np.ndarray, " _trial"]  # N, largest force within half a second of touch
    ring: Ring | None  # None where no trial lasts so long


def dynamics(force: Forces, length: Int[np.ndarray, " trial"], touch: Times, mating: Times) -> Dynamics:
    """First impact and ringing.

    Args:
        force: Fz, N. length: samples.
        touch: when the parts met, NaN = never. mating: when mating began, NaN = never.
    """
    impact = []
    for row in np.flatnonzero(np.isfinite(touch)).tolist():
        first = round(float(touch[row]) / CONTROL_PERIOD)
        near = force[row, first : min(first + round(IMPACT / CONTROL_PERIOD), int(length[row]))]
        impact += [near.max()] if len(near) else []
    return Dynamics(np.array(impact, np.float64), ringing(force, length, mating))


def ringing(force: Forces, length: Int[np.ndarray, " trial"], mating: Times) -> Ring | None:
    """Ringing of Fz after the push that begins mating; arguments as of :func:`dynamics`.

    Returns:
        medians over the trials that last four seconds longer; None if there is none.
    """
    pieces = []
    for row, begin in enumerate(np.nan_to_num(mating, nan=np.inf)):
        if (begin + RINGING) / CONTROL_PERIOD <= length[row]:
            first = round(float(begin) / CONTROL_PERIOD)
            pieces.append(force[row, first : first + round(RINGING / CONTROL_PERIOD)])
    if not pieces:
        return None
    hertz = [_frequency(piece) for piece in pieces]
    damping = [_damping(piece, each) for piece, each in zip(pieces, hertz, strict=True)]
    peak = [piece[: round(1 / CONTROL_PERIOD)].max() for piece in pieces]
    return Ring(*(float(np.median(values)) for values in (hertz, peak, damping)))


def _frequency(force: Floats) -> float:
    power = np.abs(np.fft.rfft(_levelled(force) * np.hanning(len(force)), 1 << 15))
    hertz = np.fft.rfftfreq(1 << 15, CONTROL_PERIOD)
    return float(hertz[np.where((hertz > 1.0) & (hertz < 6.0), power, -1.0).argmax()])


def _damping(force: Floats, hertz: float) -> float:
    """Damping ratio, from the logarithm of the ringing's amplitude in successive pieces of two periods."""
    span = round(PERIODS / hertz / CONTROL_PERIOD)
    pieces = force[: len(force) // span * span].astype(np.float64).reshape(-1, span)
    size = np.log(np.maximum([np.std(_levelled(piece)) for piece in pieces], 1e-6))
    return float(-np.polyfit(np.arange(len(pieces)) * span * CONTROL_PERIOD, size, 1)[0] / (2 * np.pi * hertz))


def _levelled(force: Floats) -> Floats:
    times = np.arange(len(force))
    return force - np.polyval(np.polyfit(times, force, 1), times)
