"""One steady grid for samples as they were recorded: filter, interpolation, and notes of irregularities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from rcbht_jax._util.optional import require
from rcbht_jax._util.untrusted import MAX_VALUES
from rcbht_jax.errors import InputError

JITTER = 0.25  # of a period: largest distance of a sample from the grid at which a recording is still steady
DRIFT = 0.02  # of a period: largest error that rounding the period may cause at a recording's end
GAP = 5  # periods without a sample
MISSING = 5  # samples in a row without a value that are interpolated
SPAN = 7  # steps in a row whose mean is a period
EVEN = 0.75  # of the usual step: difference between spans of as many steps in which no sample is lost
BURSTS = 0.05  # share of the steps that differ from the usual one by a factor of GAP where samples come in bursts
HELD = 10  # samples in a row of one value, by which an axis is saturated or stuck
MOST = 0.9  # share of the samples that must agree
SHORTEST, LONGEST = 1e-6, 1e3  # s: periods of samples that sensors have
EQUAL = 1e-3  # relative difference below which two rates are one
NEAR = 0.05  # the same difference for recordings whose samples are not evenly spaced
TICKS = (1e-6, 1e-5, 1e-4, 1e-3, 4e-3, 1e-2, 1 / 64)  # s, of clocks that stamp samples


@dataclass(frozen=True)
class Clock:
    """How a recording was sampled."""

    period: float  # s
    steady: bool  # every sample lies within JITTER of the grid
    bursts: bool = False  # several samples come at nearly one time, after a while without any

    @property
    def rate(self) -> float:
        """Samples per second."""
        return 1 / self.period


def tidy(
    time: Float[np.ndarray, " sample"], values: Float[np.ndarray, "sample axis"]
) -> tuple[Float[np.ndarray, " row"], Float[np.ndarray, "row axis"], list[str]]:
    """Samples in order of time, s, each time once, and without missing values, NaN; and notes.

    Raises:
        InputError: a value is infinite, times are missing, run backwards or repeat with other values, fewer than two
            samples are left, or more than ``MISSING`` values in a row are missing. The message names no file.
    """
    if not np.isfinite(time).all():
        raise InputError(f"sample {int(np.flatnonzero(~np.isfinite(time))[0])} has no time.")
    few = max(2, len(time) // 100)  # that may be out of order, or repeat
    time, values, moved = _ordered(time, values, few)
    time, values, repeated = _once(time, values, few)
    if len(time) < 2:
        raise InputError("there are fewer than two samples at different times.")
    if np.isinf(values).any():
        raise InputError(f"sample {int(np.argwhere(np.isinf(values))[0, 0])} is infinite; expected numbers.")
    values, missing = _filled(time, values)
    return time, values, [*moved, *repeated, *missing]


def _ordered(time: NDArray[Any], values: NDArray[Any], few: int) -> tuple[NDArray[Any], NDArray[Any], list[str]]:
    """Samples in order of time, and a note if some were not."""
    back = np.flatnonzero(np.diff(time) < 0)
    if not len(back):
        return time, values, []
    if len(back) > few:
        raise InputError(
            f"time runs backwards {len(back)} times, first at sample {int(back[0]) + 1}; if the table holds several "
            "recordings, name the column that separates them with --group."
        )
    order = np.argsort(time, kind="stable")
    if np.ptp(time[order] - time) > 0.1 * np.ptp(time):
        raise InputError(
            f"time starts anew at sample {int(back[0]) + 1}; if the table holds several recordings, name the "
            "column that separates them with --group; if its clock was set back, give --source-rate, which replaces "
            "the stamps."
        )
    return time[order], values[order], [f"unordered:{len(back)}"]


def _once(time: NDArray[Any], values: NDArray[Any], few: int) -> tuple[NDArray[Any], NDArray[Any], list[str]]:
    """The first sample of each time, and a note if there were others."""
    fresh = np.concatenate([[True], np.diff(time) > 0])
    if fresh.all():
        return time, values, []
    repeats = int((~fresh).sum())
    other = ~fresh[1:] & ~np.isclose(values[1:], values[:-1], rtol=0, atol=0, equal_nan=True).all(1)
    if other.sum() > few:
        raise InputError(
            f"time stamps repeat {repeats} of {len(time)} times, with other values; if the table holds "
            "several recordings, name the column that separates them with --group, else give --source-rate, which "
            "replaces the stamps."
        )
    return time[fresh], values[fresh], [f"repeated:{repeats}"]


def _filled(time: NDArray[Any], values: NDArray[Any]) -> tuple[NDArray[Any], list[str]]:
    """Missing values interpolated, and a note if there were any."""
    missing = np.isnan(values)
    if not missing.any():
        return values, []
    longest = max(int(runs(column).max(initial=0)) for column in missing.T)
    if longest > MISSING or missing.all(0).any():
        raise InputError(
            f"{longest} values in a row are missing, first at sample {int(np.flatnonzero(missing.any(1))[0])}; "
            f"at most {MISSING} are interpolated. Cut the recording there, or leave the channel out."
        )
    filled = [np.interp(time, time[~gone], column[~gone]) for column, gone in zip(values.T, missing.T, strict=True)]
    return np.stack(filled, 1), [f"missing:{int(missing.any(1).sum())}"]


def runs(mask: Bool[np.ndarray, " sample"]) -> NDArray[np.int64]:
    """Lengths of the stretches where a mask holds.

    >>> runs(np.array([True, True, False, True])).tolist()
    [2, 1]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return edges[1::2] - edges[::2]


def clock(time: Float[np.ndarray, " sample"]) -> Clock:
    """The clock of increasing times of at least two samples.

    >>> clock(np.arange(100) * 0.021).steady
    True
    """
    period = (time[-1] - time[0]) / (len(time) - 1)
    away = time - time[0] - np.arange(len(time)) * period
    if np.abs(away).max() <= JITTER * period:
        return Clock(_short(period, DRIFT / len(time)), True)
    every = np.diff(time)
    middle = float(np.median(every))
    odd = max((every > GAP * middle).sum(), (every < middle / GAP).sum())
    if odd >= HELD and odd > BURSTS * len(every):
        return Clock(1 / _nice(1 / _within_bursts(every)), False, bursts=True)
    if middle < SHORTEST:  # no sensor is this fast, and the rate may not even be finite
        return Clock(middle, False)
    # The mean gives the rate more exactly; over several steps, jitter hides lost samples less.
    steps = min(SPAN, len(time) // 2)
    spans = time[steps:] - time[:-steps]
    least, most = np.quantile(spans, (BURSTS, 1 - BURSTS))
    if most - least < EVEN * middle:  # no sample is lost: a sensor between the rows of a faster log
        return Clock(1 / _nice(steps / float(np.clip(spans, least, most).mean())), False)
    if _are_rounded(every, float(np.ptp(away))):
        return Clock(1 / _nice(1 / period), False)
    period = float(spans[spans < (1 + 0.5 / steps) * np.median(spans)].mean()) / steps
    return Clock(1 / _nice(1 / (period if abs(period / middle - 1) < NEAR else middle)), False)


def _are_rounded(steps: NDArray[np.float64], spread: float) -> bool:
    """Whether even samples have rounded stamps, as those of 800 Hz in ms: steps of two sizes, a clock's tick apart.

    Where many samples are lost, stamps lie further than two ticks (``spread``) from those of even ones.
    """
    long = steps > (steps.min() + steps.max()) / 2
    if min(long.sum(), (~long).sum()) < 3 * HELD:
        return False
    sizes = np.where(long, np.median(steps[long]), np.median(steps[~long]))
    tick = float(np.ptp(sizes))
    known = np.isclose(tick, TICKS, rtol=0.05, atol=0.0).any()
    return bool(known and spread < 2 * tick and np.abs(steps - sizes).max() < 0.05 * tick)


def _within_bursts(steps: NDArray[np.float64]) -> float:
    """The mean step of samples in bursts, from the beginning of the first whole one to that of the last; no pauses."""
    steps = steps[steps <= GAP * np.quantile(steps, 1 - BURSTS)]
    begins = np.flatnonzero(steps > steps.mean()) + 1
    return float(steps[begins[0] : begins[-1]].mean() if len(begins) > 1 else steps.mean())


def checked_period(period: float) -> float:
    """The period, s; InputError: no sensor has it."""
    if not SHORTEST <= period <= LONGEST:
        raise InputError(
            f"the time step is {period:g} s; expected {SHORTEST:g} to {LONGEST:g} s. Is the unit of time right?"
        )
    return period


def checked_rate(rate: float, what: str = "the rate") -> float:
    """The samples per second, which ``what`` names; InputError: no sensor has as many or as few."""
    least, most = 1 / LONGEST, 1 / SHORTEST
    if not least <= rate <= most:
        raise InputError(f"{what} is {rate:g}; expected {least:g} to {most:.0f} samples per second.")
    return rate


def _short(period: float, tolerance: float) -> float:
    """The period within a relative tolerance that has, or whose rate has, the fewest digits: 0.021 s, or 300 Hz."""
    for digits in range(1, 12):
        for value in (float(f"{period:.{digits}g}"), 1 / float(f"{1 / period:.{digits}g}")):
            if abs(value / period - 1) < min(tolerance, EQUAL):
                return value
    return float(period)


def _nice(rate: float) -> float:
    """A round rate within one percent."""
    rounded = float(f"{rate:.2g}")
    return rounded if abs(rounded / rate - 1) < 0.01 else float(f"{rate:.3g}")


def common(clocks: list[Clock]) -> float:
    """The period of most recordings, s: one of evenly sampled ones if there are any; at a draw the longest.

    >>> common([Clock(0.005, True), Clock(0.005, True), Clock(0.001, True)])
    0.005
    """
    candidates = {one.period for one in clocks if one.steady} or {one.period for one in clocks}

    def votes(period: float) -> tuple[int, int, float]:
        exact = sum(one.period == period for one in clocks)
        return sum(agrees(one, period) for one in clocks), exact, period

    return max(candidates, key=votes)


def agrees(one: Clock, period: float) -> bool:
    """Whether a recording has this period, as far as its samples show."""
    return abs(one.period - period) < (EQUAL if one.steady else NEAR) * period


def on_grid(
    time: Float[np.ndarray, " sample"], values: Float[np.ndarray, "sample axis"], source: Clock, period: float
) -> tuple[Float[np.ndarray, "row axis"], list[str]]:
    """Finite samples on the steady grid of a period, s, that begins with the first one; and notes.

    Evenly spaced samples of the same rate stay as they are. Those of a higher rate lose what the grid cannot hold in a
    filter without delay (Butterworth, forwards and backwards, 0.4 of the new rate), then they are interpolated.

    Raises:
        InputError: the grid would have too many samples, or scipy is missing.
    """
    gaps = np.diff(time)[np.diff(time) > GAP * source.period]
    notes = [f"gap:{gaps.max():.3g}"] if len(gaps) else []
    notes += [f"gaps:{len(gaps)}"] if len(gaps) > 1 else []
    if source.steady and abs(source.period - period) * len(time) <= JITTER * period:  # to its last sample
        return values, notes
    rows = _rows(time, period, values.shape[1])
    if rows < 2:
        raise InputError(f"it lasts {time[-1] - time[0]:.3g} s, less than two samples at {1 / period:g} Hz.")
    if source.period < (1 - NEAR) * period:
        values, time = _filtered(time, values, source.period, period)
        notes.append("filtered")
    grid = time[0] + np.arange(rows) * period
    moved = np.stack([np.interp(grid, time, column) for column in values.T], 1)
    # A clock that only jitters has the grid's rate.
    near = abs(source.period / period - 1) < NEAR and not source.steady
    return moved, [*notes, "uneven" if near else f"resampled:{source.rate:.6g}"]


def _rows(time: Float[np.ndarray, " sample"], period: float, axes: int) -> int:
    """Samples of a grid from the first to the last time."""
    rows = int((time[-1] - time[0]) / period + 1e-6) + 1
    if rows * axes > MAX_VALUES:
        raise InputError(
            f"{time[-1] - time[0]:.6g} s at {1 / period:g} samples per second are too many; is its unit s?"
        )
    return rows


def _filtered(
    time: Float[np.ndarray, " sample"], values: Float[np.ndarray, "sample axis"], source: float, period: float
) -> tuple[Float[np.ndarray, "row axis"], Float[np.ndarray, " row"]]:
    """Low-passed samples on an even grid of the source's own rate."""
    rows = _rows(time, source, values.shape[1])
    grid = time[0] + np.arange(rows) * source
    even = np.stack([np.interp(grid, time, column) for column in values.T], 1)
    signal = require("scipy.signal", "import")
    sections = signal.butter(6, 0.8 * source / period, output="sos")  # 0.8 of the new Nyquist frequency
    return signal.sosfiltfilt(sections, even, axis=0, padlen=min(len(even) - 1, round(12 * period / source))), grid


def saturated(values: Float[np.ndarray, "sample axis"]) -> list[int]:
    """Numbers of the axes whose largest or smallest value is held for ``HELD`` samples, and is not that of rest.

    >>> saturated(np.clip(np.linspace(-1, 9, 100), -2, 5)[:, None])
    [0]
    """
    found = []
    for number, column in enumerate(values.T):
        # Zero and the first value are those of rest; a channel of a few steps holds its values anyway.
        extremes = {float(column.min()), float(column.max())} - {0.0, float(column[0])}
        held = max((int(runs(column == extreme).max(initial=0)) for extreme in extremes), default=0)
        if held >= HELD and len(np.unique(column)) >= HELD:
            found.append(number)
    return found


def fresh(values: Float[np.ndarray, "sample axis"]) -> NDArray[np.int64]:
    """Numbers of the samples with new values where all axes hold theirs for a steady number of samples; else of all.

    A log that is written more often than the sensor measures holds values like this; a steady ramp in whole numbers
    also does, but all of its steps have one or two sizes. A first value that is held for less time than others is left
    out, because it was measured before the log began.

    >>> fresh(np.repeat(np.random.default_rng(0).normal(size=(40, 2)), 5, axis=0)[3:])[:3].tolist()
    [2, 7, 12]
    """
    new = np.flatnonzero((values[1:] != values[:-1]).any(1)) + 1
    if not sparse(new):
        return np.arange(len(values))
    sizes = [np.unique(size[size > 0].round(9)) for size in abs(values[new] - values[new - 1]).T]
    if max(map(len, sizes)) <= 2:
        return np.arange(len(values))
    return new if new[0] < np.median(np.diff(new)) - 1 else np.concatenate([[0], new])


def sparse(rows: NDArray[np.integer]) -> bool:
    """Whether rows of a log follow each other in steady steps of two or more, as those of a slower sensor.

    >>> sparse(np.arange(0, 40, 2)), sparse(np.arange(20))
    (True, False)
    """
    steps = np.diff(rows)
    if len(steps) < HELD or (middle := np.median(steps)) < 2:
        return False
    return bool((abs(steps - middle) > 1).mean() <= 1 - MOST)


def stuck(values: Float[np.ndarray, "sample axis"]) -> list[int]:
    """Numbers of the axes that hold a value for ``HELD`` samples, though they change with nearly all others.

    Zero and the first value are those of rest, the largest and smallest those of :func:`saturated`.

    >>> noise = np.random.default_rng(0).normal(size=(100, 2))
    >>> noise[40:, 1] = noise[40, 1]
    >>> stuck(noise)
    [1]
    """
    found = []
    for number, column in enumerate(values.T):
        begins = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
        lengths = np.diff(begins, append=len(column))
        long = lengths >= HELD
        rest = np.isin(column[begins], [0.0, column[0], column.min(), column.max()])
        if (long & ~rest).any() and (~long).sum() > max(HELD, MOST * lengths[~long].sum()):
            found.append(number)
    return found
