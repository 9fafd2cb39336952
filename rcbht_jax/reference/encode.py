"""One recording into the label tables of the original offline programs, axis by axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64
from numpy.typing import ArrayLike

from rcbht_jax.errors import InputError
from rcbht_jax.reference import limits as lim
from rcbht_jax.reference.behaviour_filter import filter_behaviours
from rcbht_jax.reference.behaviours import compose_behaviours
from rcbht_jax.reference.motion import compose_motions
from rcbht_jax.reference.motion_filter import Boundaries, boundaries, filter_motions
from rcbht_jax.reference.primitives import filter_primitives
from rcbht_jax.reference.rows import Table
from rcbht_jax.reference.segment import FLOOR, raw_primitives
from rcbht_jax.reference.versions import Version, find_version

MIN_SAMPLES = 7  # fewer can end in a segment of one sample, which has no slope
WIDTHS = {"prim_raw": 7, "prim": 7, "mc_raw": 11, "mc": 11, "llb_raw": 17, "llb": 17}

Signal = Float64[np.ndarray, "sample 6"]
Tables = tuple[Float64[np.ndarray, "_row _column"], ...]


@dataclass(frozen=True)
class OfflineLabels:
    """Label tables of one recording; each field of tables holds six arrays, Fx Fy Fz Mx My Mz.

    Rows are in time order. Times in seconds, values in N or Nm, labels as codes of ``rcbht_jax.labels``.
    Primitives: average, maximum, minimum, start, end, slope, label.
    Compositions: label, average, maximum, amplitude, tags 1 and 2, start and end of the first and of the second
    part, middle.
    Behaviours: label, averages 1, 2 and joint, maxima 1, 2 and joint, amplitudes 1, 2 and joint, tags 1 and 2,
    start and end of the first and of the second part, middle.
    """

    prim_raw: Tables  # [row, 7] before the filter, as in the published feature files
    prim: Tables  # [row, 7] after the filter
    mc_raw: Tables  # [row, 11]
    mc: Tables  # [row, 11]
    llb_raw: Tables  # [row, 17]
    llb: Tables  # [row, 17]
    thresholds: Float64[np.ndarray, "6 8"]  # limits applied, impulse down to minus impulse, N/s or Nm/s
    states: Float64[np.ndarray, " time"]  # state vector, s: starts of the states and the end of the recording
    version: str  # key of VERSIONS
    clean: bool  # quirks corrected
    samples: int  # length of the recording
    time_start: float  # first time stamp, s


def sample_times(samples: int, dt: float) -> Float64[np.ndarray, " {samples}"]:
    """Time stamps from zero, s, bit for bit those of the recorded files.

    Labels depend on exact ratios of durations, so the stamps must be the decimal numbers of the files and not
    products with a rounding error.
    """
    return np.round(np.arange(samples) * dt, 6)


def state_onsets(onset: ArrayLike) -> list[float]:
    """Start times of the states, s, without the trailing NaN of missing states.

    Raises:
        InputError: there are no states, too many, or one is not finite.
    """
    values: list[float] = np.asarray(onset, np.float64).ravel().tolist()
    while values and np.isnan(values[-1]):
        values.pop()
    if not values:
        raise InputError("The state vector is empty; expected the start times of one to five states.")
    if len(values) > 5 or not np.all(np.isfinite(values)):
        raise InputError(f"The state vector is {values}; expected one to five finite start times.")
    return values


def state_vector(onset: ArrayLike, t_end: float) -> list[float]:
    """State vector: the values of a state file and the last time stamp ``t_end``, s.

    Raises:
        InputError: there are no states, too many, or one is not finite.
    """
    values = state_onsets(onset)
    if len(values) == 5:
        return [*values[:4], t_end]
    return values if values[-1] == t_end and len(values) > 1 else [*values, t_end]


def encode(
    time: ArrayLike,
    wrench: ArrayLike,
    onset: ArrayLike,
    *,
    robot: str = "hiro",
    version: str = "master",
    clean: bool = False,
    limits: Float[np.ndarray, "axis limit"] | None = None,
    calibrated: bool = False,
    floor: float = FLOOR,
) -> OfflineLabels:
    """Label one recording with the offline taxonomy of the original programs.

    >>> from rcbht_jax.labels import LLB
    >>> time = sample_times(400, 0.005)
    >>> wrench = np.zeros((400, 6))
    >>> wrench[200:, 2] = 5.0  # N, a step of Fz
    >>> labels = encode(time, wrench, [0.0, 0.5])
    >>> [LLB(code).name for code in labels.llb[2][:, 0]]  # of Fz: contact, then constant
    ['CT', 'FX']

    Args:
        time: ``[sample]`` s, from zero or later, increasing; see :func:`sample_times`.
        wrench: ``[sample, 6]`` Fx Fy Fz Mx My Mz, N and Nm.
        onset: start times of the states as in the state file, s; the first is zero, trailing NaN are missing
            states. Both arms of a two-arm trial use those of the right arm (Q1).
        robot: one of ``rcbht_jax.encoding.thresholds.ROBOTS``; selects the hand-set limits.
        version: one of ``VERSIONS``.
        clean: correct the quirks listed in :mod:`rcbht_jax.reference`.
        limits: limits to apply without change, N/s and Nm/s, instead of the rules of the original programs.
        calibrated: use the limits shipped with the two-arm simulation.
        floor: sums of squares below it count as zero in the fit test, N^2 or (Nm)^2 (Q6).

    Raises:
        InputError: the input has the wrong shape, is too short, not finite, not in time order or has no states, or
            the robot or version does not exist.
    """
    stamps, signal = _checked(time, wrench)
    rules = find_version(version)
    states = state_vector(onset, float(stamps[-1]))
    applied = _limits(signal, robot, clean, limits, calibrated)
    bounds = boundaries(states, rules)
    axes = [
        _encode_axis(stamps, signal[:, axis], tuple(applied[axis].tolist()), floor, bounds, rules, clean)
        for axis in range(6)
    ]
    layers = zip(WIDTHS.items(), zip(*axes, strict=True), strict=True)
    tables = {
        name: tuple(np.array(rows, np.float64).reshape(-1, width) for rows in layer) for (name, width), layer in layers
    }
    return OfflineLabels(
        **tables,
        thresholds=lim.mirrored(applied),
        states=np.array(states),
        version=version,
        clean=clean,
        samples=len(stamps),
        time_start=float(stamps[0]),
    )


def _limits(
    signal: Signal,
    robot: str,
    clean: bool,
    limits: Float[np.ndarray, "axis limit"] | None,
    calibrated: bool,
) -> Float64[np.ndarray, "6 4"]:
    if limits is not None:
        if calibrated:
            raise InputError("Both limits and calibrated are given; expected one of them.")
        return lim.explicit(limits)
    extent = lim.domain(signal, clean)
    return lim.calibrated(extent, clean) if calibrated else lim.hand_set(extent, robot)


def _encode_axis(
    time: Float64[np.ndarray, " sample"],
    values: Float64[np.ndarray, " sample"],
    limits: tuple[float, ...],
    floor: float,
    bounds: Boundaries,
    version: Version,
    clean: bool,
) -> Sequence[Table]:
    """The six tables of one axis."""
    prim_raw, filtered = raw_primitives(time, values, limits, floor, version.old_ending, clean)
    prim = filter_primitives(prim_raw, clean) if filtered else prim_raw
    mc_raw = compose_motions(prim, clean)
    mc = filter_motions(mc_raw, bounds, version, clean)
    llb_raw = compose_behaviours(mc)
    llb = filter_behaviours(llb_raw, clean)
    return prim_raw, prim, mc_raw, mc, llb_raw, llb


def _checked(time: ArrayLike, wrench: ArrayLike) -> tuple[Float64[np.ndarray, " sample"], Signal]:
    stamps, signal = np.asarray(time, np.float64), np.asarray(wrench, np.float64)
    if signal.ndim != 2 or signal.shape[1] != 6:
        raise InputError(f"The wrench has shape {signal.shape}; expected [samples, 6].")
    if stamps.shape != signal.shape[:1]:
        raise InputError(f"Time has shape {stamps.shape}; expected [{len(signal)}], one stamp per sample.")
    if len(stamps) < MIN_SAMPLES:
        raise InputError(f"The recording has {len(stamps)} samples; expected at least {MIN_SAMPLES}.")
    for name, values in (("time", stamps), ("wrench", signal)):
        if not np.all(np.isfinite(values)):
            row = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise InputError(f"The {name} of sample {row} is not a finite number; remove or repair it.")
    backwards = np.flatnonzero(np.diff(stamps) <= 0)
    if backwards.size:
        raise InputError(f"Time does not increase after sample {backwards[0]}; expected increasing stamps.")
    if stamps[0] < 0:
        raise InputError(f"Time starts at {stamps[0]} s; expected zero or later.")
    return stamps, signal
