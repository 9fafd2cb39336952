"""Thresholds from context: the authors' rule, which reads limits off the states of an assembly.

The impulse limit of an axis is a share of its steepest primitive during insertion, when the snaps engage; the
constant limit a share of the mean slope during rotation, when the hand only leans on its edge. The limits in
between are equally spaced, and most axes copy theirs from a neighbour (the authors' ``gradClassFolder``; one
trial there, any number here).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.types import LabelTrack, Recordings

IMPULSE_SHARE = 0.85
CONSTANT_SHARE = 0.90
# Axis whose impulse and whose constant limit each axis takes: the authors' rule, and every axis its own.
AUTHORS_COPY = (("Fx", "Fx"), ("Fz", "Fx"), ("Fz", "Fx"), ("My", "My"), ("My", "My"), ("My", "My"))
OWN = tuple((axis, axis) for axis in AXES)


@dataclass(frozen=True)
class Context:
    """What the rule found; ``[axis]`` in N/s or Nm/s, NaN where no trial says anything."""

    impulse: NDArray[np.float64]
    constant: NDArray[np.float64]
    thresholds: GradientThresholds  # [6, 4]
    trials: NDArray[np.int64]  # [2] trials that spoke for the impulse and for the constant limit


def spectrum(impulse: NDArray[np.floating], constant: NDArray[np.floating]) -> NDArray[np.float64]:
    """Limits ``[..., 4]``, equally spaced from the impulse limit down to the constant one ``[...]``."""
    share = np.arange(4) / 3
    return np.asarray(impulse[..., None] * (1 - share) + constant[..., None] * share, np.float64)


def trial_limits(
    primitive: LabelTrack, onset: NDArray[np.floating], end: NDArray[np.floating], dt: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Impulse and constant limit of every trial and axis, ``[trial, axis]``; NaN where a state is missing or empty.

    Args:
        primitive: filtered primitives ``[trial, axis, slot]``.
        onset: float ``[trial, 4]``, start of approach, rotation, insertion, mating, s; NaN = missing.
        end: float ``[trial]``, end of the record, s; insertion ends there where the trial never mates.
        dt: seconds between samples.
    """
    start, stop = primitive.t0 * dt, primitive.t1 * dt
    used = primitive.label > 0
    s2, s3, s4 = (onset[:, k, None, None] for k in (1, 2, 3))
    s4 = np.where(np.isnan(s4), end[:, None, None], s4)
    slope = np.where(used, primitive.grad, 0).astype(np.float64)
    # Comparisons with a missing mark are false: such a trial has no primitive inside.
    insertion = used & (start > s3) & (stop < s4)
    # From the first that starts in rotation to the one before the first that ends in insertion.
    rotation = used & (start > s2) & (stop <= s3)
    steepest = np.where(insertion, np.abs(slope), -np.inf).max(-1)
    count = rotation.sum(-1)
    mean = np.abs(np.where(rotation, slope, 0).sum(-1)) / np.maximum(count, 1)
    impulse = np.where(insertion.any(-1), IMPULSE_SHARE * steepest, np.nan)
    return impulse, np.where(count > 0, CONSTANT_SHARE * mean, np.nan)


def combine(
    impulse: NDArray[np.floating],
    constant: NDArray[np.floating],
    fallback: GradientThresholds,
    copy: tuple[tuple[str, str], ...] = AUTHORS_COPY,
) -> Context:
    """Medians over the trials, copied between axes and spaced.

    Args:
        impulse: float ``[trial, axis]``, NaN = silent.
        constant: float ``[trial, axis]``, NaN = silent.
        fallback: where no trial speaks, and the lowest constant limit is a thousandth of its small one.
        copy: per axis, whose impulse and whose constant limit it takes.

    Raises:
        InputError: ``copy`` does not name six pairs of axes.
    """
    if len(copy) != len(AXES) or not {name for pair in copy for name in pair} <= set(AXES):
        raise InputError(f"the copying rule {copy} does not name an impulse and a constant axis for each of six axes.")
    base = np.asarray(fallback.limits, np.float64)
    medians = [_median(values) for values in (impulse, constant)]
    rows = [[AXES.index(pair[which]) for pair in copy] for which in (0, 1)]
    top, bottom = (
        np.where(np.isnan(found), base[:, column], found)
        for found, column in ((medians[0][rows[0]], 0), (medians[1][rows[1]], 3))
    )
    bottom = np.maximum(bottom, base[:, 3] * 1e-3)
    # A rotation steeper than the insertion says nothing about constancy.
    top = np.maximum(top, bottom * (1 + 1e-6))
    speaking = np.array([int((~np.isnan(values)).any(1).sum()) for values in (impulse, constant)])
    return Context(medians[0], medians[1], GradientThresholds(spectrum(top, bottom)), speaking)


def _median(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Over the trials that speak, per axis."""
    found = [column[~np.isnan(column)] for column in values.T]
    return np.array([np.median(column) if column.size else np.nan for column in found])


def calibrate(
    recordings: Recordings,
    rows: NDArray[np.integer],
    config: EncoderConfig,
    robot: str = "hiro",
    copy: tuple[tuple[str, str], ...] = AUTHORS_COPY,
) -> Context:
    """The rule applied to the online primitives of some recordings, obtained with the robot's preset.

    Args:
        recordings: the data set; its harmonised onsets are used.
        rows: recordings to learn from.
        config: static configuration of the encoder.
        robot: whose preset labels the primitives and stands in for what no trial says.
        copy: see :func:`combine`.

    Raises:
        InputError: no recordings, or no trial says anything about any limit.
    """
    if not len(rows):
        raise InputError("there is no trial to calibrate on.")
    base = preset(robot)
    length = recordings.length[rows]
    tracks = encode_batch(config, base, recordings.wrench[rows], length)
    end = length * recordings.dt
    found = trial_limits(tracks.primitive, recordings.onset_harmonised[rows], end, recordings.dt)
    context = combine(*found, base, copy)
    if not context.trials.any():
        raise InputError("no trial has a rotation or an insertion with a primitive in it; the states may be missing.")
    return context
