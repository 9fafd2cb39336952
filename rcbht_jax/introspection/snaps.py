"""Snaps from words: a force that builds up slowly and is released within a fraction of a second, as when a tab passes.

The detector reads the lines of the fit rule's primitives, published and running ones, a hundred times a second.
:func:`init` and :func:`steps` are pure; lanes (axes, trials) are trailing dimensions, and the state has a fixed size. A
snap is seen as soon as the running line shows it, and published when the published words alone show it.
:class:`SnapDetector` wraps these functions for a stream.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike, NDArray

from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.events import Snap, stamp_before

Reals = Float64[np.ndarray, "*lanes"]
Counts = Int64[np.ndarray, "*lanes"]
Flags = Bool[np.ndarray, "*lanes"]
AllCounts = Int64[np.ndarray, "window *lanes"]
AllFlags = Bool[np.ndarray, "window *lanes"]

LOAD = np.array([1.0, -1.0])  # signs of the load of an axis
NEVER = -(2**40)  # a sample long before the first one
LOOK = 0.01  # s of each window, if it has two samples in this time
TOLERANCES = 10.0  # of the words in the smallest fall
NOTHING = -1e30  # value where there is no line: finite, so that differences are numbers


@dataclass(frozen=True)
class SnapConfig:
    """What counts as a snap; sizes are those of :func:`steps`.

    Attributes:
        within: seconds in which the force falls.
        hold: seconds before its highest point in which it must not have risen by as much as it falls: in a ringing it
            has.
        share: of the fall, by which it may have risen in this time.
        turn: of the fall, by which it may have been higher before this point: else the fall is a longer one.
        loaded: of the fall, how far from zero the axis must have been: a release, no push. Sensors are tared.
        apart: seconds after a snap without another one on the same axis.

    Raises:
        InputError: a value is out of range.
    """

    within: float = 0.05
    hold: float = 0.1
    share: float = 0.75
    turn: float = 0.1
    loaded: float = 0.5
    apart: float = 0.3

    def __post_init__(self) -> None:
        for name, value in (("within", self.within), ("hold", self.hold), ("apart", self.apart)):
            if not 0 < value < math.inf:
                raise InputError(f"A snap's {name} is {value:g} s; expected a positive, finite time.")
        for name, value in (("share", self.share), ("turn", self.turn), ("loaded", self.loaded)):
            if not 0 <= value < math.inf:
                raise InputError(f"A snap's {name} is {value:g}; expected a finite share of its fall, 0 or more.")


class SnapSizes(NamedTuple):
    """Limits of the size of a snap, N or Nm, of each lane or of all."""

    least: Float64[np.ndarray, "*axes"]  # smallest fall, > 0
    most: Float64[np.ndarray, "*axes"]  # largest fall
    low: Float64[np.ndarray, "*axes"]  # smallest load from which it falls
    high: Float64[np.ndarray, "*axes"]  # largest


class Lines(NamedTuple):
    """Straight lines, one after the other ``[line, *lanes]``; those with no samples are no lines."""

    t0: Counts  # first sample
    t1: Counts  # one past the last
    begin: Reals  # N or Nm at the first sample
    end: Reals  # at the last

    def after(self, line: Lines) -> Lines:
        """These and one more ``[*lanes]``."""
        return Lines(*(np.concatenate([old, new[None]]) for old, new in zip(self, line, strict=True)))


class SnapState(NamedTuple):
    """State of every lane; its size does not depend on the length of the stream."""

    lines: Lines  # the latest published ones
    seen: Counts  # samples received when the latest snap was seen
    open: Flags  # whether it is not published yet


class Snaps(NamedTuple):
    """Snaps of every lane at the end of windows; values where there is no snap are undefined."""

    seen: Flags  # a snap is seen for the first time
    published: Flags  # it will not change any more
    start: Counts  # first sample of the fall: the last one within ``turn`` of its highest point
    stop: Counts  # sample after the last that is known
    release: Reals  # N or Nm, value from which it falls
    fall: Reals  # N or Nm, > 0
    when: Counts  # samples received when it was seen


def memory(config: SnapConfig, dt: float, window: int) -> int:
    """Number of lines that are kept: one for each window within the times of ``config``."""
    return math.ceil((2 * config.within + config.hold) / dt / window) + 2


def init(config: SnapConfig, dt: float, window: int, lanes: tuple[int, ...]) -> SnapState:
    """The empty state; ``dt`` s between samples, ``window`` samples for each step."""
    shape = memory(config, dt, window), *lanes
    lines = Lines(np.zeros(shape, np.int64), np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape))
    never = np.full(lanes, NEVER, np.int64)
    return SnapState(lines, never, np.zeros(lanes, bool))


def steps(
    config: SnapConfig,
    dt: float,
    sizes: SnapSizes,
    state: SnapState,
    words: Lines,
    running: Lines,
) -> tuple[SnapState, Snaps]:
    """Snaps in the next windows of every lane; the result does not depend on how windows are divided among calls.

    Args:
        config: what counts as a snap.
        dt: s between samples.
        sizes: of the lanes' axes.
        state: of the same lanes.
        words: the line that each window published ``[window, *lanes]``; no samples where none.
        running: the line of the run that went on after it ``[window, *lanes]``, up to its latest sample.

    Returns:
        the new state, and what is seen or published at the end of each window ``[window, *lanes]``.

    Example:
        >>> config, sizes = SnapConfig(), SnapSizes(*np.array([3.0, 99, 0, 99]))
        >>> words = Lines(*np.array([[[0], [0]], [[100], [0]]]), *np.array([[[0.0], [0]], [[8.0], [0]]]))
        >>> running = Lines(*np.array([[[100], [100]], [[105], [110]]]), *np.array([[[8.0], [8]], [[5.0], [2]]]))
        >>> state, found = steps(config, 0.005, sizes, init(config, 0.005, 5, (1,)), words, running)
        >>> found.seen[:, 0].tolist(), found.start[1].tolist(), found.fall[1].tolist()
        ([True, False], [100], [6.0])
    """
    new, now = words.t1 > words.t0, running.t1
    lines = _remembered(state.lines, words, new)
    by_run = _released(config, dt, sizes, lines.after(running))
    by_words = _released(config, dt, sizes, lines) if new.any() else by_run
    sure = new & by_words.seen
    rest, first, published, when = _in_turn(config, dt, state, now, sure | by_run.seen, sure)
    found = _Released(first, *(np.where(published, a, b) for a, b in zip(by_words[1:], by_run[1:], strict=True)))
    return SnapState(Lines(*(field[:, -1] for field in lines)), *rest), Snaps(first, published, *found[1:], when)


def _remembered(old: Lines, words: Lines, new: AllFlags) -> Lines:
    """The latest published lines after each window ``[line, window, *lanes]``."""
    order, lines = np.argsort(~new, 0, kind="stable"), len(old.t0)
    which = np.arange(lines).reshape(-1, *[1] * new.ndim) + np.cumsum(new, 0)

    def latest(before: NDArray[Any], then: NDArray[Any]) -> NDArray[Any]:
        line = np.concatenate([before, np.take_along_axis(then, order, 0)])
        return np.take_along_axis(line, which.reshape(-1, *line.shape[1:]), 0).reshape(which.shape)

    return Lines(*(latest(before, then) for before, then in zip(old, words, strict=True)))


def _in_turn(
    config: SnapConfig,
    dt: float,
    state: SnapState,
    now: AllCounts,
    shown: AllFlags,
    sure: AllFlags,
) -> tuple[tuple[Counts, Flags], AllFlags, AllFlags, AllCounts]:
    """Which of the releases are new, and which are published; only few windows have one.

    Returns:
        the fields ``seen`` and ``open`` of the state; of every window whether a snap is seen, whether one is published,
        and the samples received when the latest was seen.
    """
    apart, forget = round(config.apart / dt), round((config.within + config.apart) / dt)
    seen, waiting = state.seen, state.open
    first, published, when = np.zeros_like(shown), np.zeros_like(shown), np.zeros_like(now)
    for row in np.flatnonzero(shown.any(tuple(range(1, shown.ndim)))):
        if row:  # later, the words show another fall than the run
            waiting = waiting & (now[row - 1] - seen <= forget)
        first[row] = shown[row] & ~waiting & (now[row] - seen > apart)
        published[row] = sure[row] & (first[row] | waiting)
        seen = when[row] = np.where(first[row], now[row], seen)
        waiting = (waiting | first[row]) & ~published[row]
    return (seen, waiting & (now[-1] - seen <= forget)), first, published, when


class _Released(NamedTuple):
    """Whether the last line ends after a release, and what it is."""

    seen: Flags
    start: Counts
    stop: Counts
    release: Reals
    fall: Reals


def _released(config: SnapConfig, dt: float, sizes: SnapSizes, lines: Lines) -> _Released:
    within, hold = round(config.within / dt), round(config.hold / dt)
    there = lines.t1[-1] > lines.t0[-1]
    known = np.where(lines.t1 > lines.t0, lines.t0, -NEVER).min(0)
    end = np.stack([lines.t1[-1] - 1] * len(LOAD))
    values, samples = _points(lines, LOAD, end - within, end)
    peak, at = _highest(values, samples)
    before, _ = _highest(*_points(lines, LOAD, end - 2 * within, end - within - 1))
    lowest = -_highest(*_points(lines, -LOAD, at - hold, at))[0]
    fall = peak - _by_way(LOAD, end.ndim) * lines.end[-1]
    good = there & (known <= at - hold) & (fall >= sizes.least) & (fall <= sizes.most) & (peak >= config.loaded * fall)
    good &= (peak >= sizes.low) & (peak <= sizes.high)
    good &= (before <= peak + config.turn * fall) & (lowest >= peak - config.share * fall)
    start = np.where(values >= (peak - config.turn * fall)[:, None], samples, NEVER).max(1)
    which = np.where(good[0], 0, 1)[None]
    start, release, fall = (np.take_along_axis(values, which, 0)[0] for values in (start, peak, fall))
    return _Released(good.any(0), start, lines.t1[-1], np.where(good[0], release, -release), fall)


def _by_way(way: Float64[np.ndarray, " way"], dims: int) -> Float64[np.ndarray, "way ..."]:
    return way.reshape(-1, *[1] * (dims - 1))


def _points(
    lines: Lines,
    way: Float64[np.ndarray, " way"],
    first: Int64[np.ndarray, "way *lanes"],
    last: Int64[np.ndarray, "way *lanes"],
) -> tuple[Float64[np.ndarray, "way point *lanes"], Int64[np.ndarray, "way point *lanes"]]:
    """Both ends of every line within ``first`` to ``last``: value times ``way``, NOTHING where none is; and sample."""
    way = _by_way(way, lines.t0.ndim + 1)
    a, b = np.maximum(lines.t0, first[:, None]), np.minimum(lines.t1 - 1, last[:, None])
    samples, there = np.concatenate([a, b], 1), (a <= b) & (lines.t1 > lines.t0)
    slope = (lines.end - lines.begin) / np.maximum(lines.t1 - 1 - lines.t0, 1)
    t0, begin, slope = (np.concatenate([field, field]) for field in (lines.t0, lines.begin, slope))
    values = way * (begin + slope * (samples - t0))
    return np.where(np.concatenate([there, there], 1), values, NOTHING), samples


def _highest(
    values: Float64[np.ndarray, "way point *lanes"], samples: Int64[np.ndarray, "way point *lanes"]
) -> tuple[Float64[np.ndarray, "way *lanes"], Int64[np.ndarray, "way *lanes"]]:
    """The highest of the points, and its sample."""
    which = values.argmax(1, keepdims=True)
    return np.take_along_axis(values, which, 1)[:, 0], np.take_along_axis(samples, which, 1)[:, 0]


# --- the detector -----------------------------------------------------------------------------------------------------


def line_of(
    t0: NDArray[np.integer], t1: NDArray[np.integer], mean: NDArray[np.floating], slope: NDArray[np.floating]
) -> Lines:
    """Lines from their spans, means and slopes per sample, of one shape."""
    half = np.asarray(slope, np.float64) * (t1 - t0 - 1) / 2
    return Lines(t0.astype(np.int64), t1.astype(np.int64), mean - half, mean + half)


class SnapDetector:
    """Snaps in a stream of forces, found with words of the fit rule; chunks of any size give the same events.

    Args:
        rate: samples per second.
        axes: their names.
        least: smallest fall that is a snap, N or Nm: a number, or one for each axis.
        most: largest fall.
        load: smallest and largest absolute value from which it falls; numbers, or one for each axis.
        window: samples for each step of the encoder, >= 2; a snap is seen at the end of a step. Default 10 ms.
        tolerance: of the fit rule; default a tenth of the smallest fall.
        config: what else counts as a snap.

    Raises:
        InputError: sizes that are not positive, not in order or not one for each axis, or a bad rate or window.

    Example:
        >>> force = np.interp(np.arange(600) / 200, [0, 0.5, 2.0, 2.03, 3], [0, 0, 9, 2, 2])  # let go after 2 s
        >>> seen, published = SnapDetector(200.0, ["Fz"], least=3.0).push(force[:, None])
        >>> seen.begin, seen.seen, round(seen.fall, 1), published.seen, published.published, round(published.fall, 1)
        (400, 2.02, 3.5, 2.02, 2.04, 5.8)
    """

    def __init__(
        self,
        rate: float,
        axes: Sequence[str],
        least: ArrayLike,
        most: ArrayLike = math.inf,
        load: tuple[ArrayLike, ArrayLike] = (0.0, math.inf),
        window: int | None = None,
        tolerance: ArrayLike | None = None,
        config: SnapConfig = SnapConfig(),
    ) -> None:
        if not 0 < rate < math.inf:
            raise InputError(f"The rate is {rate:g} samples per second; expected a positive, finite number.")
        self.axes, self.config = tuple(axes), config
        self.sizes = _sizes(len(self.axes), least, most, *load)
        self._words = FitConfig(max(2, round(LOOK * rate)) if window is None else window, 1 / rate)
        wide = self.sizes.least / TOLERANCES if tolerance is None else np.asarray(tolerance, np.float64)
        slopes = np.tile([4.0, 3.0, 2.0, 1.0], (len(self.axes), 1))  # only the lines are used, not the labels
        self._limits = FitLimits(slopes, wide)
        self._encoder = Encoder(self._words, self._limits)
        self.reset()

    @property
    def dt(self) -> float:
        """Seconds between samples."""
        return self._words.dt

    def columns(self, axes: Sequence[str], dt: float) -> list[int]:
        """Column numbers of its axes in a signal with these axes and ``dt`` s between samples.

        Raises:
            InputError: the signal lacks an axis or has another rate.

        Example:
            >>> SnapDetector(200.0, ["Fz"], least=3.0).columns(("Fx", "Fy", "Fz"), 0.005)
            [2]
        """
        if not set(self.axes) <= set(axes) or not np.isclose(dt, self.dt):
            raise InputError(
                f"The detector needs {', '.join(self.axes)} at {1 / self.dt:g} Hz; the signal has {', '.join(axes)} at "
                f"{1 / dt:g} Hz."
            )
        return [tuple(axes).index(axis) for axis in self.axes]

    def warm_up(self) -> None:
        """Compile the encoder now, instead of in the first :meth:`push`."""
        list(Encoder(self._words, self._limits).lines(np.zeros((self._words.window, len(self.axes)))))

    def reset(self) -> None:
        """Start a new stream."""
        self._encoder.restart()
        self._state = init(self.config, self.dt, self._words.window, (len(self.axes),))

    def push(self, samples: ArrayLike, time: float | None = None) -> list[Snap]:
        """Feed any number of samples ``[time, axis]``; returns the snaps that are seen or published with them.

        Args:
            samples: tared, N or Nm.
            time: stamp of the last of them, s; None = samples received x period.

        Raises:
            InputError: wrong shape, a value that is not finite, or more samples than are counted (``MOST_SAMPLES`` of
                :mod:`rcbht_jax.encoding.stream`); then nothing is consumed.
        """
        blocks = self._encoder.lines(samples)
        end = self._encoder.received + len(np.asarray(samples))
        stamp = round(end * self.dt, 9) if time is None else time
        events = []
        for block in blocks:
            words, running = (line_of(*lines) for lines in block)
            self._state, found = steps(self.config, self.dt, self.sizes, self._state, words, running)
            events += self._events(found, running.t1, end, stamp)
        return events

    def _events(self, new: Snaps, samples: NDArray[np.integer], end: int, stamp: float) -> list[Snap]:
        def at(count: int) -> float:
            """Stamp of the latest of so many samples."""
            return stamp_before(stamp, end - count, self.dt)

        found = []
        for which in zip(*np.nonzero(new.seen | new.published), strict=True):
            sample, begin, release, fall = int(samples[which]), new.start[which], new.release[which], new.fall[which]
            published = at(sample) if new.published[which] else None
            about = int(begin), at(int(begin) + 1), float(release), float(fall), at(int(new.when[which]))
            found.append(Snap(sample, at(sample), self.axes[which[1]], *about, published))
        return found


def _sizes(axes: int, *values: ArrayLike) -> SnapSizes:
    """Sizes ``[axis]``, checked."""
    try:
        least, most, low, high = (np.broadcast_to(np.asarray(value, np.float64), (axes,)) for value in values)
    except (ValueError, TypeError):
        raise InputError(f"least, most and load must be numbers, or have one for each of {axes} axes.") from None
    if not ((least > 0) & (least <= most) & (low >= 0) & (low <= high) & (least < math.inf)).all():
        raise InputError(
            f"least is {values[0]!r}, most {values[1]!r} and load {values[2]!r} to {values[3]!r}; "
            "expected 0 < least <= most, and 0 <= low <= high for the load."
        )
    return SnapSizes(least, most, low, high)
