"""Growing-window line fits: one axis of the wrench into raw primitives (paper, section III-A)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from rcbht_jax.reference.limits import classify
from rcbht_jax.reference.rows import Row, Table

STEP = 5  # samples between two tests of the fit
ACCEPT = 0.90  # R-squared above which the window keeps growing
FLOOR = 1e-4  # sums of squares below this count as zero, N^2 or (Nm)^2
_STRETCH = 1.05  # the end of a segment without duration becomes 1.05 times its start
_GUARD = 1e-6  # decisions closer than this to a limit are repeated with the exact fit

Signal = Float64[np.ndarray, " sample"]


class Line(NamedTuple):
    """Least-squares line, centred: value = mean_value + slope * (time - mean_time)."""

    slope: float
    mean_time: float
    mean_value: float
    residual: float  # sum of squared residuals
    spread: float  # sum of squared deviations from the mean

    def at(self, time: float) -> float:
        """Value of the line at a time."""
        return self.mean_value + self.slope * (time - self.mean_time)


class Window(NamedTuple):
    """A finished segment: samples first..last, whose slope is that of the line over fit_first..fit_last."""

    first: int
    last: int
    fit_first: int
    fit_last: int
    raw: bool  # values are the raw samples, as at the end of the signal, not the fitted line


def fit_line(time: Signal, values: Signal) -> Line:
    """Least-squares line through at least two ``values`` (N or Nm) at ``time`` (s)."""
    n = len(time)
    mean_time, mean_value = float(time.sum()) / n, float(values.sum()) / n
    dt, dv = time - mean_time, values - mean_value
    slope = float(dt @ dv) / float(dt @ dt)
    residual = dv - slope * dt
    return Line(slope, mean_time, mean_value, float(residual @ residual), float(dv @ dv))


def is_good(residual: float, spread: float, floor: float) -> bool:
    """The acceptance test on R-squared; quiet windows, below the floor, always pass (Q6)."""
    if spread < floor or spread == 0.0 or residual < floor:
        return True
    return 1 - residual / spread > ACCEPT


class _GrowingFit:
    """Running sums about the anchor, which decide most windows without another pass over their samples."""

    def __init__(self, time: Signal, values: Signal, floor: float) -> None:
        self._arrays = time, values
        self._time, self._values = time.tolist(), values.tolist()
        self._floor = floor
        self.restart(0)

    def restart(self, anchor: int) -> None:
        self.anchor, self._next = anchor, anchor
        self._sums = (0.0, 0.0, 0.0, 0.0, 0.0)

    def good_to(self, end: int) -> bool:
        """Whether the line over anchor..end is accepted."""
        t0, v0 = self._time[self.anchor], self._values[self.anchor]
        st, sv, stt, stv, svv = self._sums
        for t, v in zip(self._time[self._next : end + 1], self._values[self._next : end + 1], strict=True):
            t -= t0
            v -= v0
            st += t
            sv += v
            stt += t * t
            stv += t * v
            svv += v * v
        self._next, self._sums = end + 1, (st, sv, stt, stv, svv)
        n = end + 1 - self.anchor
        spread = svv - sv * sv / n
        rise = stv - st * sv / n
        residual = spread - rise * rise / (stt - st * st / n)
        if self._is_close_call(residual, spread):
            line = self.exact(end)
            return is_good(line.residual, line.spread, self._floor)
        return is_good(residual, spread, self._floor)

    def exact(self, end: int) -> Line:
        time, values = self._arrays
        return fit_line(time[self.anchor : end + 1], values[self.anchor : end + 1])

    def _is_close_call(self, residual: float, spread: float) -> bool:
        margin = _GUARD * max(spread, self._floor)
        return (
            abs(residual - (1 - ACCEPT) * spread) < margin
            or abs(spread - self._floor) < margin
            or abs(residual - self._floor) < margin
        )


def find_windows(time: Signal, values: Signal, floor: float, old_ending: bool) -> tuple[list[Window], bool]:
    """Cut a signal into windows.

    Returns:
        the windows, and whether the primitive filter runs afterwards: with ``old_ending`` a signal of 5m+1 samples
        that ends inside a window loses its tail and is not filtered.
    """
    fit = _GrowingFit(time, values, floor)
    last = len(time) - 1
    windows: list[Window] = []
    probe = 0
    while True:
        end = min(probe + STEP, last)
        final = probe + STEP > last
        if final and not old_ending:
            return [*windows, Window(fit.anchor, last, fit.anchor, last, raw=True)], True
        anchor = fit.anchor
        if not fit.good_to(end):
            # The very first window has no accepted part to fall back on, so it ends at its own end.
            cut = probe if probe > 0 else end
            windows.append(Window(anchor, cut, anchor, end, raw=False))
            fit.restart(cut)
        probe += STEP
        if final:
            break
    if probe == last + STEP:
        return windows, False
    return [*windows, Window(fit.anchor, last, anchor, last, raw=True)], True


def _primitive(time: Signal, values: Signal, window: Window, limits: tuple[float, ...], clean: bool) -> Row:
    """Row of one window: average, maximum, minimum, start, end, slope, label."""
    own = slice(window.first, window.last + 1)
    fitted = own if clean else slice(window.fit_first, window.fit_last + 1)
    line = fit_line(time[fitted], values[fitted])
    start, end = float(time[window.first]), float(time[window.last])
    if window.raw:
        highest, lowest = float(values[own].max()), float(values[own].min())
    else:
        ends = line.at(start), line.at(end)
        highest, lowest = max(ends), min(ends)
    if start == end:
        end = _STRETCH * start
    label = classify(line.slope, limits, clean)
    return [(highest + lowest) / 2, highest, lowest, start, end, line.slope, float(label)]


def raw_primitives(
    time: Signal,
    values: Signal,
    limits: tuple[float, ...],
    floor: float = FLOOR,
    old_ending: bool = False,
    clean: bool = False,
) -> tuple[Table, bool]:
    """Raw primitives of one axis.

    A segment has the slope and the extremes of the *rejected* fit, outlying samples included (Q7); ``clean`` fits
    every segment to its own samples and drops the one without duration that can follow a rejected first window.

    Args:
        time: s, increasing.
        values: N or Nm.
        limits: impulse, big, medium and small limit, N/s or Nm/s.
        floor: sums of squares below it count as zero, N^2 or (Nm)^2.
        old_ending: end-of-signal rule of the versions before a1ca1d1.
        clean: correct Q5 and Q7.

    Returns:
        rows of seven columns, and whether the primitive filter runs afterwards.
    """
    windows, filtered = find_windows(time, values, floor, old_ending)
    if clean:
        windows = [window for window in windows if window.last > window.first]
    return [_primitive(time, values, window, limits, clean) for window in windows], filtered
