"""Resampling of readings to equal times: the encoder counts samples, so none may be missing or repeated.

The grid starts at the first sample. A reading on a grid time passes unchanged, bit for bit; between grid times the
signal is linear. Of a source with more readings than the grid, a sample is the mean of the period around its time, so
that noise and vibration above half the rate of the grid do not come back as slow signals. Short gaps are bridged by a
straight line and reported; after a longer one, or a clock that jumps back, the stream starts anew, since what happened
in between is unknown. Nothing is dropped or filled in without a report.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.events import stamp_before
from rcbht_jax.io.messages import Sample
from rcbht_jax.labels import AXES
from rcbht_jax.types import Recordings

ON_GRID = 0.01  # of a period: nearer than this is on the grid
FASTER = 0.91  # of a period between readings, or less: the source is faster than the grid, 1.1 times or more
COUNTED = 50  # readings of which this is the mean
JITTER = 0.25  # of a period: readings further off the grid are reported
PAUSE = 1.0  # s between reports of continuing irregularities: jitter, bridged readings
CLOCK_JUMP = 1.0  # s back in time: the source was restarted
SHORT, WIDEST = 0.05, 60.0  # s: gaps that are bridged by default, if they are no longer; that may be bridged at most
LARGEST = 1e6  # N or Nm: beyond any sensor's range, and single precision sums stay finite

Kind = Literal["gap", "late", "repeated", "not-finite", "jitter", "faster"]


@dataclass(frozen=True)
class Report:
    """An irregularity of the samples."""

    kind: Kind
    text: str
    count: int = 1


@dataclass
class Resampled:
    """The result of one reading: ``samples``, the ``time`` of the last of them, and reports.

    ``anew``: the stream was broken; the receiver must reset before these samples.
    """

    samples: Float[np.ndarray, "time axis"]
    time: float = 0.0
    anew: bool = False
    reports: list[Report] = field(default_factory=list)


class Resampler:
    """Puts readings on a grid of ``dt`` seconds; remembers one reading.

    Args:
        dt: period of the grid.
        bridge: s; gaps up to this long are bridged by a straight line; None = 0.05 s, or four periods if they are
            longer.
        axes: values of a reading.

    Raises:
        InputError: the period is longer than half a minute; the bridge is shorter than two periods, or longer than a
            minute.
    """

    def __init__(self, dt: float, bridge: float | None = None, axes: int = len(AXES)) -> None:
        if 2 * dt > WIDEST:
            raise InputError(
                f"A stream needs a reading every {WIDEST / 2:g} s at least; this one has one every {dt:g} s. Are its "
                "time stamps in seconds?"
            )
        bridge = usual_bridge(dt) if bridge is None else bridge
        if not 2 * dt <= bridge <= WIDEST:
            raise InputError(f"Gaps of {bridge:g} s cannot be bridged; expected {2 * dt:g} to {WIDEST:g} s.")
        self._dt, self._bridge = dt, bridge
        self._origin = self._last = 0.0
        self._value: Float[np.ndarray, " axis"] = np.zeros(axes)
        self._index = -1  # of the latest grid sample; -1 = none yet
        self._faster = False  # since COUNTED readings had shown it; how many there are, and the time of the first:
        self._counted, self._first = 0, 0.0
        self._summed, self._area = 0, self._value  # number of the next mean, and the integral of its period so far
        self._skipped = 0  # readings without a time that were left out since the latest good one
        self._since = 0.0  # s, when jitter and bridged readings were reported; since then:
        self._readings = self._off = self._missing = 0
        self._gaps = False  # there were bridged readings of late, so that further ones are reported later, together

    def feed(self, sample: Sample) -> Resampled:
        """Take one reading.

        A reading without a time is one period after the one before. One that is not finite is left out, so that
        the straight line to the next reading replaces it.
        """
        value = np.asarray(sample.wrench, np.float64)
        time = self._next() if sample.time is None else sample.time
        if not (np.isfinite(value).all() and np.abs(value).max() <= LARGEST and math.isfinite(time)):
            self._skipped += sample.time is None
            return self._nothing("not-finite", "a reading that is not finite, or absurd, was left out")
        if self._index < 0:
            return self._start(time, value)
        step = time - self._last
        if step <= 0 and step >= -CLOCK_JUMP:
            if step == 0:
                return self._nothing("repeated", f"a second reading of {time:.6f} s was left out")
            return self._nothing("late", f"a reading {-step:.6f} s older than the latest was left out")
        if step < 0:
            return self._anew(time, value, f"the clock went back by {-step:.3f} s; everything starts anew")
        if step > self._bridge + ON_GRID * self._dt:
            slow = "" if self._index else "; a source that is always so slow needs a longer --max-gap"
            return self._anew(time, value, f"no reading for {step:.3f} s; everything starts anew{slow}")
        return self._advance(time, value, step)

    def _next(self) -> float:
        """Time of a reading without a stamp; readings that were left out count one period each."""
        return self._origin + (self._index + 1 + self._skipped) * self._dt

    def _nothing(self, kind: Kind, text: str) -> Resampled:
        return Resampled(np.zeros((0, len(self._value)), np.float32), self._last, reports=[Report(kind, text)])

    def _start(self, time: float, value: Float[np.ndarray, " axis"]) -> Resampled:
        self._origin = self._last = self._since = time
        self._value, self._index, self._skipped, self._gaps = value, 0, 0, False
        self._counted, self._first, self._summed, self._area = 0, time, 0, np.zeros_like(value)
        return Resampled(value[None].astype(np.float32), time)

    def _anew(self, time: float, value: Float[np.ndarray, " axis"], text: str) -> Resampled:
        reports = [Report("gap", text), *self.finish()]
        resampled = self._start(time, value)
        resampled.anew, resampled.reports = True, reports
        return resampled

    def _advance(self, time: float, value: Float[np.ndarray, " axis"], step: float) -> Resampled:
        position = (time - self._origin) / self._dt
        nearest = round(position)
        on = abs(position - nearest) < ON_GRID
        means = self._means(time, value)  # always, so that the first one that is used is of a whole period
        samples = means if self._faster else self._points(value, step, nearest if on else position)
        if on and len(samples) and not self._faster:
            samples[-1] = value
        self._last, self._value, self._skipped = time, value, 0
        self._index += len(samples)
        reports = self._reports(step, position - nearest) + self._measure(time)
        stamp = stamp_before(self._origin, -self._index, self._dt)
        return Resampled(samples.astype(np.float32), stamp, reports=reports)

    def _points(
        self, value: Float[np.ndarray, " axis"], step: float, position: float
    ) -> Float[np.ndarray, "time axis"]:
        """Values of the straight line from the reading before at the grid times up to a position."""
        indices = np.arange(self._index + 1, math.floor(position) + 1)
        share = np.clip(((self._origin + indices * self._dt) - self._last) / step, 0, 1)[:, None]
        return self._value + (value - self._value) * share

    def _means(self, time: float, value: Float[np.ndarray, " axis"]) -> Float[np.ndarray, "time axis"]:
        """Means of the straight lines between readings over the periods around grid times that have ended."""
        start, stop = ((moment - self._origin) / self._dt for moment in (self._last, time))
        moments = np.array([start, *(np.arange(self._summed, math.floor(stop + 0.5)) + 0.5), stop])
        share = ((moments - start) / (stop - start))[:, None]
        values = self._value + (value - self._value) * share
        areas = np.diff(moments)[:, None] * (values[1:] + values[:-1]) / 2
        areas[0] += self._area
        self._area, first = areas[-1], self._index + 1 - self._summed
        self._summed += len(areas) - 1
        return areas[max(first, 0) : -1]

    def _measure(self, time: float) -> list[Report]:
        """Whether the source has more readings than the grid; reported when it is found."""
        if self._faster:
            return []
        self._counted += 1
        if self._counted < COUNTED:
            return []
        period = (time - self._first) / self._counted
        self._counted, self._first = 0, time
        if period > FASTER * self._dt:
            return []
        self._faster, self._off = True, 0
        text = f"readings come at {1 / period:.4g} Hz; a sample is their mean over a period of {1 / self._dt:.4g} Hz"
        return [Report("faster", text)]

    def _reports(self, step: float, off: float) -> list[Report]:
        missing = round(step / self._dt) - 1
        self._readings += 1
        self._off += abs(off) > JITTER and not self._faster
        reports = []
        if missing > 0 and self._gaps:
            self._missing += missing
        elif missing > 0:
            reports, self._gaps = [Report("gap", _bridged(missing), missing)], True
        return reports + (self.finish() if self._last - self._since >= PAUSE - ON_GRID * self._dt else [])

    def finish(self) -> list[Report]:
        """The remaining reports of jitter and bridged readings at the end of a stretch."""
        off, missing = self._off, self._missing
        since = f"{plural(self._readings, 'reading')} in {self._last - self._since:.3g} s"
        self._since, self._gaps = self._last, missing > 0
        self._readings = self._off = self._missing = 0
        reports = []
        if off:
            text = f"of {since}, {off} were more than {JITTER:g} periods off the grid of {1 / self._dt:g} Hz"
            reports.append(Report("jitter", text, off))
        if missing:
            reports.append(Report("gap", f"among {since}, {_bridged(missing)}", missing))
        return reports


def usual_bridge(dt: float, source: float = 0.0) -> float:
    """Longest gap that is filled by default, s: two periods of the source at least, whose steps are no gaps.

    >>> usual_bridge(0.005), usual_bridge(0.01, 0.1)
    (0.05, 0.2)
    """
    return min(max(SHORT, 4 * dt, 2 * source), WIDEST)


def on_grid(
    wrench: Float[np.ndarray, "reading axis"],
    time: Float[np.ndarray, " reading"],
    rate: float,
    bridge: float | None = None,
) -> Float[np.ndarray, "sample axis"]:
    """Readings as an encoder of this rate gets them.

    Args:
        wrench: of one trial.
        time: stamps of the readings, s; NaN = none.
        rate: samples per second.
        bridge: as of :class:`Resampler`.

    >>> on_grid(np.array([[0.0], [2.0], [4.0]]), np.array([0.0, 0.02, 0.04]), 100).ravel().tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    grid = Resampler(1 / rate, bridge, wrench.shape[1])
    stamps = (None if np.isnan(stamp) else stamp for stamp in time.tolist())
    readings = (Sample(tuple(row), stamp) for row, stamp in zip(wrench.tolist(), stamps, strict=True))
    return np.concatenate([grid.feed(reading).samples for reading in readings])


def resampled(recordings: Recordings, rate: float) -> Recordings:
    """Recordings as an encoder of this rate gets them; those of this rate unchanged, else without annotations.

    Args:
        recordings: the data set.
        rate: samples per second.

    Raises:
        InputError: as from :class:`Resampler`.

    Example:
        >>> fast = Recordings.from_arrays(np.arange(400.0).reshape(1, 400, 1), rate=400, axes=["grip"])
        >>> resampled(fast, 100).wrench[0, -2:, 0].tolist()
        [392.0, 396.0]
    """
    if math.isclose(rate * recordings.dt, 1, rel_tol=1e-6):
        return recordings
    pairs = zip(recordings.wrench, recordings.length.tolist(), strict=True)
    bridge = usual_bridge(1 / rate, recordings.dt)
    parts = [on_grid(wrench[:length], np.arange(length) * recordings.dt, rate, bridge) for wrench, length in pairs]
    return Recordings.from_arrays(parts, rate, axes=recordings.axes, units=recordings.units)


def _bridged(missing: int) -> str:
    return f"{missing} missing reading{'s were' if missing > 1 else ' was'} bridged by a straight line"
