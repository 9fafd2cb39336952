"""Snaps from words: a force that builds up slowly and is released within a fraction of a second, as when a tab passes.

The rule reads the lines of the fit rule's primitives, published and running ones, after every window. :func:`init` and
:func:`steps` are pure; lanes (axes, trials) are trailing dimensions, and the state has a fixed size. A snap is seen as
soon as the running line shows it, and published when the published words alone show it.
:class:`rcbht_jax.introspection.snaps.SnapDetector` wraps these functions for a stream.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError

Reals = Float64[np.ndarray, "*lanes"]
Counts = Int64[np.ndarray, "*lanes"]
Flags = Bool[np.ndarray, "*lanes"]
AllCounts = Int64[np.ndarray, "window *lanes"]
AllFlags = Bool[np.ndarray, "window *lanes"]
AllReals = Float64[np.ndarray, "way window *lanes"]
Past = Float64[np.ndarray, "way past *lanes"]
Rises = Float64[np.ndarray, "way look *lanes"]

LOAD = np.array([1.0, -1.0])  # signs of the load of an axis
NEVER = -(2**40)  # a sample long before the first one
NOTHING = -1e30  # value where there is no line: finite, so that differences are numbers


@dataclass(frozen=True)
class SnapConfig:
    """What counts as a snap; sizes are those of :func:`steps`.

    Attributes:
        within: seconds in which the force falls.
        hold: seconds before its highest point in which it must not have risen as quickly as it falls: in a ringing it
            has.
        share: of the fall, by which it may have risen within ``within`` at any time in ``hold``.
        turn: of the fall, by which it may have been higher before this point: else the fall is a longer one.
        loaded: of the fall, how far from zero the axis must have been: a release, no push. Sensors are tared.
        apart: seconds after a snap without another one on the same axis.

    Raises:
        InputError: a value is of another type or out of range.
    """

    within: float = 0.04
    hold: float = 0.3
    share: float = 0.75
    turn: float = 0.1
    loaded: float = 0.5
    apart: float = 0.3

    def __post_init__(self) -> None:
        make_plain(self)
        for name, value in (("within", self.within), ("hold", self.hold), ("apart", self.apart)):
            if not 0 < value < math.inf:
                raise InputError(f"A snap's {name} is {value:g} s; expected a positive, finite time.")
        for name, value in (("share", self.share), ("turn", self.turn), ("loaded", self.loaded)):
            if not 0 <= value < math.inf:
                raise InputError(f"A snap's {name} is {value:g}; expected a finite share of its fall, 0 or more.")


def fall_time(config: SnapConfig, dt: float) -> int:
    """Samples in which the force falls, ``dt`` s apart; 0 = they are too few to show a snap.

    >>> fall_time(SnapConfig(), 0.005), fall_time(SnapConfig(), 0.1)
    (8, 0)
    """
    return round(config.within / dt)


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
    falls: Past  # N or Nm, of either sign of the load within ``within`` at the ends of the latest windows
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


def memory(config: SnapConfig, dt: float, window: int) -> tuple[int, int]:
    """Number of lines that are kept, one for each window in which a peak is looked for; and of falls of windows."""
    samples = [round(seconds / dt) for seconds in (2 * config.within, config.hold, config.within + config.apart)]
    lines, hold, late = (math.ceil(count / window) for count in samples)
    return lines + 2, hold + late + 1


def init(config: SnapConfig, dt: float, window: int, lanes: tuple[int, ...]) -> SnapState:
    """The empty state; ``dt`` s between samples, ``window`` samples for each step."""
    lines, falls = memory(config, dt, window)
    shape = lines, *lanes
    none = Lines(np.zeros(shape, np.int64), np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape))
    never = np.full(lanes, NEVER, np.int64)
    return SnapState(none, np.zeros((len(LOAD), falls, *lanes)), never, np.zeros(lanes, bool))


def steps(
    config: SnapConfig,
    dt: float,
    window: int,
    sizes: SnapSizes,
    state: SnapState,
    words: Lines,
    running: Lines,
) -> tuple[SnapState, Snaps]:
    """Snaps in the next windows of every lane; the result does not depend on how windows are divided among calls.

    Args:
        config: what counts as a snap.
        dt: s between samples.
        window: samples of each window.
        sizes: of the lanes' axes.
        state: of the same lanes.
        words: the line that each window published ``[window, *lanes]``; no samples where none.
        running: the line of the run that went on after it ``[window, *lanes]``, up to its latest sample.

    Returns:
        the new state, and what is seen or published at the end of each window ``[window, *lanes]``.

    Example:
        >>> config, sizes = SnapConfig(), SnapSizes(*np.array([3.0, 99, 0, 99]))
        >>> state = init(config, 0.004, 5, (1,))
        >>> words = Lines(*np.array([[[0], [0]], [[100], [0]]]), *np.array([[[0.0], [0]], [[8.0], [0]]]))
        >>> running = Lines(*np.array([[[100], [100]], [[105], [110]]]), *np.array([[[8.0], [8]], [[5.0], [2]]]))
        >>> state, found = steps(config, 0.004, 5, sizes, state, words, running)
        >>> found.seen[:, 0].tolist(), found.start[1].tolist(), found.fall[1].tolist()
        ([True, False], [100], [6.0])
    """
    new, now = words.t1 > words.t0, running.t1
    lines = _remembered(state.lines, words, new)
    run = _fallen(config, dt, lines.after(running))
    falls = np.concatenate([state.falls, run.fall], 1)
    steepest = _steepest(config, dt, window, falls)
    by_run = _released(config, dt, window, sizes, run, now, steepest)
    by_words = _released(config, dt, window, sizes, _fallen(config, dt, lines), now, steepest) if new.any() else by_run
    sure = new & by_words.seen
    rest, first, published, when = _in_turn(config, dt, state, now, sure | by_run.seen, sure)
    found = _Released(first, *(np.where(published, a, b) for a, b in zip(by_words[1:], by_run[1:], strict=True)))
    latest = Lines(*(field[:, -1] for field in lines))
    return SnapState(latest, falls[:, -state.falls.shape[1] :], *rest), Snaps(first, published, *found[1:], when)


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


class _Fallen(NamedTuple):
    """How far the force has fallen at the end of the last line, for either sign of the load."""

    fall: AllReals
    peak: AllReals  # the value from which it fell, the load being positive
    at: Int64[np.ndarray, "way window *lanes"]  # sample of the peak
    start: Int64[np.ndarray, "way window *lanes"]  # the last sample within ``turn`` of it
    rise: AllReals  # to the peak, within the same time before it
    before: AllReals  # the highest value just before the time in which the peak was looked for
    stop: AllCounts  # one past the last sample


def _fallen(config: SnapConfig, dt: float, lines: Lines) -> _Fallen:
    within = fall_time(config, dt)
    end = np.stack([lines.t1[-1] - 1] * len(LOAD))
    values, samples = _points(lines, LOAD, end - within, end)
    peak, at = _highest(values, samples)
    before, _ = _highest(*_points(lines, LOAD, end - 2 * within, end - within - 1))
    fall = peak - _by_way(LOAD, end.ndim) * lines.end[-1]
    rise = peak + _highest(*_points(lines, -LOAD, at - within, at))[0]
    start = np.where(values >= (peak - config.turn * fall)[:, None], samples, NEVER).max(1)
    return _Fallen(np.where(end >= 0, fall, 0.0), peak, at, start, rise, before, lines.t1[-1])


def _steepest(config: SnapConfig, dt: float, window: int, falls: Past) -> Rises:
    """The most that the force has risen within ``within`` in the ``hold`` before each window's end, that included.

    A rise is a fall of the other sign of the load.
    """
    count = math.ceil(round(config.hold / dt) / window) + 1
    return sliding_window_view(falls[::-1], count, 1).max(-1)


class _Released(NamedTuple):
    """Whether the last line ends after a release, and what it is."""

    seen: Flags
    start: Counts
    stop: Counts
    release: Reals
    fall: Reals


def _released(
    config: SnapConfig, dt: float, window: int, sizes: SnapSizes, last: _Fallen, now: AllCounts, steepest: Rises
) -> _Released:
    """Whether the last line ends after a release; ``steepest`` is that of earlier windows, and of the ``now`` last."""
    hold = round(config.hold / dt)
    windows = np.arange(len(now)).reshape(-1, *[1] * (now.ndim - 1))
    which = steepest.shape[1] - len(now) + windows - -(-(now - 1 - last.at) // window)
    rise = np.maximum(last.rise, np.take_along_axis(steepest, np.maximum(which, 0), 1))
    good = (which >= 0) & (last.at >= hold) & (last.stop > 0) & (last.peak >= config.loaded * last.fall)
    good &= (
        (last.fall >= sizes.least) & (last.fall <= sizes.most) & (last.peak >= sizes.low) & (last.peak <= sizes.high)
    )
    good &= (last.before <= last.peak + config.turn * last.fall) & (rise <= config.share * last.fall)
    way = np.where(good[0], 0, 1)[None]
    start, release, fall = (np.take_along_axis(values, way, 0)[0] for values in (last.start, last.peak, last.fall))
    return _Released(good.any(0), start, last.stop, np.where(good[0], release, -release), fall)


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


def line_of(
    t0: NDArray[np.integer], t1: NDArray[np.integer], mean: NDArray[np.floating], slope: NDArray[np.floating]
) -> Lines:
    """Lines from their spans, means and slopes per sample, of one shape."""
    half = np.asarray(slope, np.float64) * (t1 - t0 - 1) / 2
    return Lines(t0.astype(np.int64), t1.astype(np.int64), mean - half, mean + half)
