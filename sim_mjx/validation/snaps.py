"""Snaps in a force: a quick fall below the level before it, as a tab gives way; and the force before the filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from sim_mjx.assembly.sensor import SensorParams
from sim_mjx.assembly.task import CONTROL_PERIOD

LEAST_DROP = 5.0  # N
FALL = 12  # control periods in which a snap falls
BEFORE, LEVEL = 20, 200  # control periods: the level before a snap is the median from LEVEL to BEFORE of it
BELOW = 0.75  # of that level: the overshoot of a force loop stays above it, because the level before a push is low
RELEASE, DROP = (11.0, 18.0), (7.0, 17.0)  # N, of session B's snaps
APART = 100  # least control periods between two snaps: a snap's own ringing does not count
SETTLED = 1.5  # s after touch, before which the hand still bounces


class Snap(NamedTuple):
    """One tab, or several, giving way."""

    time: float  # s, of the release
    release: float  # N, largest force before the fall
    drop: float  # N, to the lowest force after it


def unfiltered(force: Float[np.ndarray, "*batch time"], sensor: SensorParams) -> Float64[np.ndarray, "*batch time"]:
    """Force at the input of the sensor's low-pass filter, which is inverted exactly.

    Args:
        force: logged, N.
        sensor: of one trial; its ``d`` must not be zero.
    """
    a, b, c, d = (float(value) for value in (sensor.a, sensor.b, sensor.c, sensor.d))
    state = np.zeros(force.shape[:-1])
    out = np.empty(force.shape)
    for sample in range(force.shape[-1]):  # recursive: each input changes the state that the next one is taken from
        out[..., sample] = (force[..., sample] - c * state) / d
        state = a * state + b * out[..., sample]
    return out


def find(force: Float64[np.ndarray, " time"], touch: float = 0.0) -> list[Snap]:
    """Snaps in one force.

    Args:
        force: unfiltered, N, at the control period.
        touch: when the parts first met, s; the bouncing just after it is left out.
    """
    snaps: list[Snap] = []
    fall = force[:-FALL] - force[FALL:]
    earliest = max(LEVEL + FALL, round((touch + SETTLED) / CONTROL_PERIOD))
    for start in (earliest + np.argsort(-fall[earliest:], kind="stable")).tolist():
        if fall[start] < LEAST_DROP / 2:
            break
        around = force[start - FALL : start + FALL]
        first = start + FALL - 1 - int(np.argmax(around[::-1]))  # the last maximum, where a level held
        if any(abs(first * CONTROL_PERIOD - snap.time) < APART * CONTROL_PERIOD for snap in snaps):
            continue
        release, bottom = float(force[first]), float(force[first : first + 3 * FALL].min())
        level = float(np.median(force[first - LEVEL + BEFORE : first - BEFORE + 1]))
        if release - bottom >= LEAST_DROP and bottom < BELOW * level:
            snaps.append(Snap(first * CONTROL_PERIOD, release, release - bottom))
    return sorted(snaps)


def summary(trials: Sequence[Sequence[Snap]]) -> dict[str, Any]:
    """Statistics of the snaps of several trials as JSON values: counts, forces, and how many are as recorded."""
    snaps = [snap for trial in trials for snap in trial]
    shares = {
        name: np.round(np.percentile([getattr(snap, name) for snap in snaps], (5, 50, 95)), 1).tolist() if snaps else []
        for name in ("release", "drop")
    }
    return {
        "trials": len(trials),
        "trials_with_0_1_2_more": [sum(min(len(trial), 3) == count for trial in trials) for count in range(4)],
        **{f"{name}_N_5_50_95_percent": values for name, values in shares.items()},
        "trials_with_a_snap_as_recorded": sum(any(map(as_recorded, trial)) for trial in trials),
    }


def share(summary: dict[str, Any]) -> float:
    """Share of the trials of a summary with a snap as recorded; 0 of none."""
    return float(summary["trials_with_a_snap_as_recorded"] / max(summary["trials"], 1))


def as_recorded(snap: Snap) -> bool:
    """Whether a snap lies within the ranges of session B's snaps."""
    return RELEASE[0] <= snap.release <= RELEASE[1] and DROP[0] <= snap.drop <= DROP[1]
