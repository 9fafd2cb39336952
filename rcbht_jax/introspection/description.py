"""A recording in sentences: which axes changed when, by how much and how fast, and what rang.

Built from the lines of primitives (best those of the fit rule). A change is a rise or fall between two turning points
that are at least a given height apart (zigzag rule), or between one and a level stretch; its times are those at which a
tenth and nine tenths of it are done. Several changes in alternation, equally far apart and without a new push, are a
ringing. What begins together is one sentence. Forces that are let go at once have a sentence of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from rcbht_jax._util.selection import rows_of
from rcbht_jax.encoding.arrays import encode
from rcbht_jax.encoding.tolerance import USUAL, noise_of
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.snap_rule import SnapConfig, fall_time
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.types import LabelTrack, Recordings

NOISE = 10.0  # standard deviations: the noise of a long recording spans less
UNTARED = 1.1  # of the load before a snap: where the force falls by more, zero is hardly that of the sensor
TOGETHER = 0.1  # s between onsets that are reported as one
PLATEAU = 0.5  # s of a level stretch that divides one rise into two
SLOWEST_HALF = 1.0  # s between turning points of a ringing at most
_SWINGS = 4  # changes that make a ringing
_UNEVEN = 3.0  # ratio of the longest to the shortest half period of a ringing
_PUSH = 2.0  # ratio of a swing to the one before or, at the first, after it: what exceeds it does not ring by itself


@dataclass(frozen=True)
class Change:
    """One rise or fall of an axis.

    Attributes:
        axis: its name.
        start: s, when a tenth of it is done.
        end: s, when nine tenths of it are done.
        rise: N or Nm, negative for a fall.
    """

    axis: str
    start: float
    end: float
    rise: float


@dataclass(frozen=True)
class Ringing:
    """Rises and falls of an axis in alternation.

    Attributes:
        axis: its name.
        start: s.
        end: s.
        height: N or Nm, of the largest swing.
        frequency: Hz.
    """

    axis: str
    start: float
    end: float
    height: float
    frequency: float


def polyline(track: LabelTrack, dt: float) -> tuple[Float[np.ndarray, " knot"], Float[np.ndarray, " knot"]]:
    """First and last points of the lines of one axis's primitives: times in s, values.

    Args:
        track: primitives of one axis, ``[slot]``.
        dt: s between samples.
    """
    used = np.asarray(track.label) > 0
    t0, t1, mean, slope = (np.asarray(getattr(track, name))[used].astype(float) for name in ("t0", "t1", "avg", "grad"))
    half = slope * (t1 - t0 - 1) * dt / 2
    times = np.stack([t0, t1 - 1], 1).ravel() * dt
    return times, np.stack([mean - half, mean + half], 1).ravel()


def turning_points(values: NDArray[np.floating], least: float) -> list[int]:
    """Indices of the extremes that follow each other at a distance of at least ``least``, first and last included.

    Example:
        >>> turning_points(np.array([0.0, 0.2, 5.0, 4.9, 5.1, 1.0, 1.2]), 1.0)
        [0, 4, 5]
    """
    found, low, high, way = [0], 0, 0, 0
    for index, value in enumerate(values.tolist()):
        low = index if value < values[low] else low
        high = index if value > values[high] else high
        if way >= 0 and values[high] - value >= least and high > found[-1] - (way == 0):
            found, low, way = _turned(found, high, way), index, -1
        elif way <= 0 and value - values[low] >= least and low > found[-1] - (way == 0):
            found, high, way = _turned(found, low, way), index, 1
    last = high if way > 0 else low
    return [*found, last] if way and last > found[-1] else found


def _turned(found: list[int], extreme: int, way: int) -> list[int]:
    """The first extreme replaces the beginning, where nothing has turned yet."""
    return [*found, extreme] if way else [extreme]


def changes(axis: str, times: NDArray[np.floating], values: NDArray[np.floating], least: float) -> list[Change]:
    """Changes of one axis by at least ``least``, in order.

    Args:
        axis: its name.
        times: of the knots of :func:`polyline`, s.
        values: of the knots, N or Nm.
        least: smallest change, > 0.

    Example:
        >>> changes("Fz", np.array([0.0, 1.0, 1.5, 3.0]), np.array([0.0, 0.0, 10.0, 10.0]), 1.0)
        [Change(axis='Fz', start=1.05, end=1.45, rise=10.0)]
    """
    if not len(values):
        return []
    points = turning_points(values, least)
    out = []
    for first, last in _parts(points, times, values, least):
        rise = float(values[last] - values[first])
        done = np.maximum.accumulate((values[first : last + 1] - values[first]) / rise)
        start, end = (_when(times[first : last + 1], done, share) for share in (0.1, 0.9))
        out.append(Change(axis, start, end, rise))
    return out


def _parts(
    points: list[int], times: NDArray[np.floating], values: NDArray[np.floating], least: float
) -> list[tuple[int, int]]:
    """Pairs of knots that bound a change: turning points, and level stretches of half a second between them.

    A smooth rise begins and ends slowly: level stretches at its ends belong to it up to twice the duration of the rest.
    """
    level = (np.diff(times) >= PLATEAU) & (np.abs(np.diff(values)) < least / 2)
    level[1::2] = False  # between two lines there is one sample, however long that is
    found = []
    for first, last in pairwise(points):
        cuts = [first, *(edge for k in range(first, last) if level[k] for edge in (k, k + 1)), last]
        parts = [(a, b) for a, b in pairwise(cuts) if abs(values[b] - values[a]) >= least] or [(first, last)]
        (start, stop), (begin, end) = parts[0], parts[-1]
        earliest, latest = times[start] - 2 * (times[stop] - times[start]), times[end] + 2 * (times[end] - times[begin])
        within = [cut for cut in cuts if earliest <= times[cut] <= latest]
        parts[0] = within[0], stop
        parts[-1] = parts[-1][0], within[-1]
        found += parts
    return found


def _when(times: NDArray[np.floating], done: NDArray[np.floating], share: float) -> float:
    after = int(np.searchsorted(done, share))
    gap = done[after] - done[after - 1]
    part = (share - done[after - 1]) / gap
    return float(times[after - 1] + part * (times[after] - times[after - 1]))


def with_ringing(series: Sequence[Change]) -> list[Change | Ringing]:
    """Changes of one axis, those in quick, even alternation reported as one ringing."""
    out: list[Change | Ringing] = []
    run: list[Change] = []
    for change in series:
        if run and not _goes_on([*run, change]):
            out += _summarised(run)
            run = run[-1:] if len(run) < _SWINGS and _goes_on([run[-1], change]) else []
            out = out[:-1] if run else out
        run.append(change)
    return out + _summarised(run)


def _goes_on(run: list[Change]) -> bool:
    gaps = np.diff([(change.start + change.end) / 2 for change in run])
    heights = np.abs([change.rise for change in run])
    even = gaps.max() <= min(SLOWEST_HALF, _UNEVEN * gaps.min())
    return bool(even and heights[0] <= _PUSH * heights[1] and (heights[1:] <= _PUSH * heights[:-1]).all())


def _summarised(run: list[Change]) -> list[Change | Ringing]:
    if len(run) < _SWINGS:
        return list(run)
    middles = [(change.start + change.end) / 2 for change in run]
    frequency = (len(run) - 1) / 2 / (middles[-1] - middles[0])
    height = max(abs(change.rise) for change in run)
    return [Ringing(run[0].axis, run[0].start, run[-1].end, height, frequency)]


def sentences(found: Sequence[Change | Ringing], units: Mapping[str, str]) -> list[tuple[float, str]]:
    """Time and text of each sentence, in order; axes that begin to change within 0.1 s share one.

    A rise or fall is given in full, and its duration is the time from a tenth to nine tenths of it.

    Args:
        found: changes and ringings of all axes.
        units: of each axis.

    Example:
        >>> sentences([Change("Fz", 1.0, 1.3, 13.0), Change("My", 1.05, 1.2, -0.4)], {"Fz": "N", "My": "Nm"})
        [(1.0, 'Fz rises 13 N in 0.3 s, My falls 0.4 Nm in 0.15 s')]
    """
    groups: list[list[Change | Ringing]] = []
    for one in sorted(found, key=lambda item: item.start):
        if groups and one.start - groups[-1][0].start <= TOGETHER:
            groups[-1].append(one)
        else:
            groups.append([one])
    return [
        (round(group[0].start, 3), ", ".join(_text(one, units.get(one.axis, "")) for one in group)) for group in groups
    ]


def _text(one: Change | Ringing, unit: str) -> str:
    seconds = _number(max(one.end - one.start, 0.0))
    unit = f" {unit}" if unit else ""
    if isinstance(one, Ringing):
        return f"{one.axis} rings at {_number(one.frequency)} Hz for {seconds} s, by up to {_number(one.height)}{unit}"
    way = "rises" if one.rise > 0 else "falls"
    return f"{one.axis} {way} {_number(abs(one.rise))}{unit} in {seconds} s"


def _number(value: float) -> str:
    return f"{value:.0f}" if 99.5 <= value < 1e6 else f"{value:.2g}"  # two digits of more are 1e+02


def describe(
    track: LabelTrack, axes: Sequence[str], units: Mapping[str, str], dt: float, least: Sequence[float]
) -> list[tuple[float, str]]:
    """Time and text of each sentence about one recording.

    Args:
        track: primitives ``[axis, slot]``; those of the fit rule follow the signal best.
        axes: their names.
        units: of each axis.
        dt: s between samples.
        least: of each axis, the smallest change that is reported.

    Example:
        >>> import rcbht_jax as rj
        >>> force = np.interp(np.arange(600) / 200, [0, 1, 1.5, 3], [0, 0, 12, 12])
        >>> track = rj.encode(force[:, None], rate=200, rule="fit", tolerance=0.2).primitive
        >>> describe(track, ["Fz"], {"Fz": "N"}, 0.005, [1.0])
        [(1.05, 'Fz rises 12 N in 0.4 s')]
    """
    found: list[Change | Ringing] = []
    for index, axis in enumerate(axes):
        lane = jax.tree.map(lambda values, index=index: np.asarray(values)[index], track)
        found += with_ringing(changes(axis, *polyline(lane, dt), least[index]))
    return sentences(found, units)


def describe_recording(
    recordings: Recordings, row: int, share: float = 0.2, track: str = "", snaps: SnapDetector | None = None
) -> list[tuple[float, str]]:
    """Time and text of each sentence about a recording, with the names of annotated intervals where they begin.

    Args:
        recordings: any axes.
        row: which one; -1 is the last.
        share: of an axis's usual range in this recording (1st to 99th percentile), the smallest change to report; not
            less than what noise alone would change.
        track: of annotations to name; default the first, or its harmonised variant.
        snaps: detector of snaps; default on all axes in N, its smallest fall the smallest change of the
            one that changes most.

    Returns:
        seconds and text, in order of time; durations as of :func:`sentences`. A snap by clearly more than its load
        says that the sensor looks untared: it may be a first contact.

    Raises:
        InputError: no such recording, a share that is not between 0 and 1, or snaps of other axes or of another rate.

    Example:
        >>> push = np.interp(np.arange(600) / 200, [0, 1, 1.5, 3], [0, 0, 12, 12])[:, None]
        >>> describe_recording(Recordings.from_arrays([push], 200.0, axes=["grip"], units=["N"]), 0)
        [(1.05, 'grip rises 12 N in 0.4 s')]
        >>> push = np.interp(np.arange(600) / 200, [0, 1, 2.5, 2.53, 3], [0, 0, 9, 2, 2])[:, None]
        >>> describe_recording(Recordings.from_arrays([push], 200.0, axes=["grip"], units=["N"]), 0)[1]
        (2.5, 'snap: grip lets go 5.8 N from 9 N; seen at 2.52 s, published at 2.54 s')
    """
    if not 0 < share < 1:
        raise InputError(f"The smallest change is {share:g} of an axis's range; expected a number between 0 and 1.")
    (row,) = rows_of(row, len(recordings)).tolist()
    wrench = recordings.wrench[row, : recordings.length[row]]
    sentences = []
    if len(wrench) > 1:
        primitives = encode(wrench, rate=1 / recordings.dt, rule="fit").primitive
        low, high = np.percentile(wrench, USUAL, axis=0)
        least = np.where(high > low, np.maximum(share * (high - low), NOISE * noise_of([wrench])), np.inf)
        units = dict(zip(recordings.axes, recordings.units, strict=True))
        sentences = describe(primitives, recordings.axes, units, recordings.dt, least.tolist())
        sentences += _snaps(recordings, wrench, least, snaps)
    track = recordings.annotations.choose(track)
    if track:
        marks = recordings.annotations.of_recording(row).of(track)
        begun = zip(marks.start.tolist(), marks.names().tolist(), strict=True)
        sentences += [(round(start, 3), f"[{track}: {label}]") for start, label in begun]
    # labels of one time stay in their order: one may last no time
    return sorted(sentences, key=lambda one: (one[0], "[" if one[1].startswith(f"[{track}: ") else one[1]))


def _snaps(
    recordings: Recordings,
    wrench: Float[np.ndarray, "time axis"],
    least: Float[np.ndarray, " axis"],
    snaps: SnapDetector | None,
) -> list[tuple[float, str]]:
    """Time and text of each snap, as it was published or, if it never was, last seen."""
    if snaps is None:
        forces = [axis for axis, unit in enumerate(recordings.units) if unit == "N" and np.isfinite(least[axis])]
        if not forces or not fall_time(SnapConfig(), recordings.dt):
            return []
        names = [recordings.axes[axis] for axis in forces]
        snaps = SnapDetector(1 / recordings.dt, names, float(least[forces].max()))
    snaps.reset()
    columns = snaps.columns(recordings.axes, recordings.dt)
    events = snaps.push(wrench[:, columns], (len(wrench) - 1) * recordings.dt)
    sentences = []
    for event in {(event.axis, event.seen): event for event in events}.values():  # the latest event of each snap
        unit = recordings.units[recordings.axes.index(event.axis)]
        end = "" if event.published is None else f", published at {event.published:.2f} s"
        force, load = (f"{_number(abs(size))}{unit and f' {unit}'}" for size in (event.fall, event.release))
        what = f"{event.axis} lets go {force} from {load}"
        if abs(event.fall) > UNTARED * abs(event.release):
            end += '; more than its load: the sensor looks untared, see "rcbht import --tare"'
        sentences.append((round(event.start, 3), f"snap: {what}; seen at {event.seen:.2f} s{end}"))
    return sentences
