"""Contextual calibration: the authors' rule, which derives the limits from the states of an assembly.

The impulse limit of an axis is a fraction of its steepest primitive during insertion, when the snaps engage; the
constant limit is a fraction of the mean slope during rotation, when the part only leans on its edge. The two limits in
between are equally spaced, and most axes copy theirs from another one (the authors' ``gradClassFolder``). The authors
use one trial; here limits are medians over any number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, Thresholds, limits_of, preset, validate
from rcbht_jax.errors import InputError
from rcbht_jax.labels import AXES
from rcbht_jax.learning.tasks import PLAIN, USUAL
from rcbht_jax.robots.snap_assembly import HARMONISED, RECORDED, STATES
from rcbht_jax.types import LabelTrack, Recordings

IMPULSE_SHARE = 0.85
CONSTANT_SHARE = 0.90
# Axis whose impulse and whose constant limit each axis takes: the authors' rule, and every axis its own.
AUTHORS_COPY = (("Fx", "Fx"), ("Fz", "Fx"), ("Fz", "Fx"), ("My", "My"), ("My", "My"), ("My", "My"))
OWN = tuple((axis, axis) for axis in AXES)


@dataclass(frozen=True)
class Context:
    """Thresholds of the rule, and the medians they are made of."""

    impulse: Float[np.ndarray, " axis"]  # N/s or Nm/s, NaN where no trial has an insertion
    constant: Float[np.ndarray, " axis"]  # N/s or Nm/s, NaN where no trial has a rotation
    thresholds: GradientThresholds  # [6, 4]
    trials: Int[np.ndarray, "2 axis"]  # numbers of trials behind the impulse and the constant limit of each axis

    @property
    def ungraded(self) -> tuple[str, ...]:
        """The axes whose limits are all one: insertion is hardly steeper than rotation, or than rest (``least``)."""
        rows = np.asarray(self.thresholds.limits, np.float64)
        return tuple(axis for axis, row in zip(AXES, rows, strict=True) if row[0] <= row[3] * (1 + 1e-5))


def spectrum(
    impulse: Float[np.ndarray, "*batch"], constant: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch 4"]:
    """Four limits, equally spaced from the impulse limit down to the constant one.

    >>> spectrum(np.array([30.0]), np.array([3.0])).round(6).tolist()
    [[30.0, 21.0, 12.0, 3.0]]
    """
    share = np.arange(4) / 3
    return np.asarray(impulse[..., None] * (1 - share) + constant[..., None] * share, np.float64)


def trial_limits(
    primitive: LabelTrack, onset: Float[np.ndarray, "trial 4"], end: Float[np.ndarray, " trial"], dt: float
) -> tuple[Float[np.ndarray, "trial axis"], Float[np.ndarray, "trial axis"]]:
    """Impulse and constant limit of every trial and axis, ``[trial, axis]``; NaN where a state is missing or empty.

    Args:
        primitive: filtered primitives ``[trial, axis, slot]``.
        onset: start of approach, rotation, insertion, mating, s; NaN = missing.
        end: end of the record, s; the insertion of a trial without mating ends there.
        dt: seconds between samples.
    """
    start, stop = primitive.t0 * dt, primitive.t1 * dt
    used = primitive.label > 0
    s2, s3, s4 = (onset[:, k, None, None] for k in (1, 2, 3))
    s4 = np.where(np.isnan(s4), end[:, None, None], s4)
    slope = np.where(used, primitive.grad, 0).astype(np.float64)
    # Comparisons with a missing onset are false: such a trial has no primitive inside.
    insertion = used & (start > s3) & (stop < s4)
    # From the first that starts in rotation to the one before the first that ends in insertion.
    rotation = used & (start > s2) & (stop <= s3)
    steepest = np.where(insertion, np.abs(slope), -np.inf).max(-1)
    count = rotation.sum(-1)
    mean = np.abs(np.where(rotation, slope, 0).sum(-1)) / np.maximum(count, 1)
    impulse = np.where(insertion.any(-1), IMPULSE_SHARE * steepest, np.nan)
    return impulse, np.where(count > 0, CONSTANT_SHARE * mean, np.nan)


def combine(
    impulse: Float[np.ndarray, "trial axis"],
    constant: Float[np.ndarray, "trial axis"],
    fallback: GradientThresholds,
    copy: tuple[tuple[str, str], ...] = AUTHORS_COPY,
    least: Float[np.ndarray, " axis"] | float = 0.0,
) -> Context:
    """Medians over the trials, copied between axes and spaced.

    Args:
        impulse: N/s or Nm/s, NaN = missing.
        constant: N/s or Nm/s, NaN = missing.
        fallback: limits ``[6, 4]`` used where no trial has a value; a constant limit is at least a thousandth of the
            small limit.
        copy: for each axis, the axes that its impulse and its constant limit are copied from.
        least: constant limits at least, so that rest is constant, N/s or Nm/s.

    Raises:
        InputError: ``copy`` does not name six pairs of axes, or the fallback is not ordered.
    """
    if len(copy) != len(AXES) or not {name for pair in copy for name in pair} <= set(AXES):
        raise InputError(f"The copying rule {copy} does not name an impulse and a constant axis for each of six axes.")
    base = np.asarray(fallback.limits, np.float64)
    validate(base)
    medians = [_median(values) for values in (impulse, constant)]
    rows = [[AXES.index(pair[which]) for pair in copy] for which in (0, 1)]
    top, bottom = (
        np.where(np.isnan(copied), base[:, column], copied)
        for copied, column in ((medians[0][rows[0]], 0), (medians[1][rows[1]], 3))
    )
    bottom = np.maximum(np.maximum(bottom, base[:, 3] * 1e-3), least)
    # Where rotation or rest is steeper than the insertion the limits would be out of order.
    top = np.maximum(top, bottom * (1 + 1e-6))
    trials = np.stack([(~np.isnan(x)).sum(0)[row] for x, row in zip((impulse, constant), rows, strict=True)])
    return Context(medians[0], medians[1], GradientThresholds(spectrum(top, bottom)), trials)


def _onsets(recordings: Recordings, boundaries: str) -> Float[np.ndarray, "recording 4"]:
    """Onsets of the four states in s, corrected where there are corrections and the recorded ones are not asked for."""
    labels = recordings.annotations.labels
    track = HARMONISED if HARMONISED in labels and boundaries != PLAIN else RECORDED
    if labels.get(track) != STATES:
        there = ", ".join(f"{name} ({', '.join(labels[name])})" for name in labels) or "no annotations"
        raise InputError(
            f"The authors' rule needs a track {RECORDED} of {', '.join(STATES)}; there is {there}. Choose another "
            "method."
        )
    return recordings.starts(track)


def _median(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Per axis, over the trials that have a value."""
    columns = [column[~np.isnan(column)] for column in values.T]
    return np.array([np.median(column) if column.size else np.nan for column in columns])


def calibrate(
    recordings: Recordings,
    rows: NDArray[np.integer],
    config: EncoderConfig,
    base: Thresholds | None = None,
    copy: tuple[tuple[str, str], ...] = AUTHORS_COPY,
    least: Float[np.ndarray, " axis"] | float = 0.0,
    boundaries: str = USUAL,
) -> Context:
    """Apply the rule to the primitives that some thresholds give.

    Args:
        recordings: the data set, with the four states on the track states.
        rows: recordings to calibrate on.
        config: static configuration of the encoder.
        base: ``[6, 4]``; they label the primitives, and replace limits for which there is no data. None = HIRO's.
        copy: see :func:`combine`.
        least: see :func:`combine`.
        boundaries: "recorded" = onsets of the track states; else of states-harmonised, if there is one.

    Raises:
        InputError: no recordings, none with a rotation or an insertion that contains a primitive, no such track, or
            other axes than those of a wrench.
    """
    if not len(rows):
        raise InputError("rows is empty; there is no trial to calibrate on.")
    if recordings.axes != AXES:
        raise InputError(
            f"The authors' rule is for the axes {', '.join(AXES)}, not for {', '.join(recordings.axes)}; choose "
            "another method."
        )
    base = GradientThresholds(limits_of(preset() if base is None else base))
    length = recordings.length[rows]
    tracks = encode_batch(config, base, recordings.wrench[rows], length)
    end = length * recordings.dt
    impulse, constant = trial_limits(tracks.primitive, _onsets(recordings, boundaries)[rows], end, recordings.dt)
    context = combine(impulse, constant, base, copy, least)
    if np.isnan([context.impulse, context.constant]).all():
        raise InputError(
            "No trial has a rotation or an insertion with a primitive in it; states may be missing, or the "
            "thresholds that label the primitives may be those of another robot."
        )
    return context
