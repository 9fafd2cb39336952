"""Snaps by brute force: every sample of every line is looked at, in plain Python, from the words of one axis."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rcbht_jax.introspection.snap_rule import SnapConfig

Line = tuple[int, int, float, float]  # first sample, end, value at the first and at the last sample


@dataclass
class Said:
    sample: int
    begin: int
    published: bool
    seen: int


def value(line: Line, sample: int) -> float:
    t0, t1, begin, end = line
    return begin + (end - begin) / max(t1 - 1 - t0, 1) * (sample - t0)


def highest(lines: Sequence[Line], way: float, first: int, last: int) -> tuple[float, int]:
    points = [
        (way * value(line, k), k) for line in lines for k in range(max(line[0], first), min(line[1] - 1, last) + 1)
    ]
    return max(points, key=lambda point: (round(point[0], 9), -point[1])) if points else (-1e30, 0)


def fallen(config: SnapConfig, dt: float, way: float, lines: Sequence[Line]) -> float:
    """How far the last line ends below the highest point of a moment ago."""
    end = lines[-1][1] - 1
    return highest(lines, way, end - round(config.within / dt), end)[0] - way * lines[-1][3]


def steepest(config: SnapConfig, dt: float, now: int, at: int, rises: Sequence[tuple[int, float]]) -> float:
    """Largest rise before ``at``, of the last sample and the rise of each window; infinite if it is long ago."""
    window = rises[-1][0] - rises[-2][0] if len(rises) > 1 else 1
    late, hold = (math.ceil(round(time / dt) / window) for time in (config.within + config.apart, config.hold))
    before = [rise for last, rise in rises if last <= at][-hold - 1 :]
    return max(before, default=0.0) if math.ceil((now - 1 - at) / window) <= late + 1 else math.inf


def released(
    config: SnapConfig,
    dt: float,
    sizes: Sequence[float],
    lines: Sequence[Line],
    now: int,
    falls: Sequence[tuple[int, dict[float, float]]],
) -> int | None:
    """First sample of the fall with which the last line ends; None = it does not."""
    least, most, low, high = sizes
    within, hold = round(config.within / dt), round(config.hold / dt)
    end = lines[-1][1] - 1
    for way in (1.0, -1.0):
        peak, at = highest(lines, way, end - within, end)
        fall = fallen(config, dt, way, lines)
        rise = steepest(config, dt, now, at, [(last, sizes[-way]) for last, sizes in falls])
        rise = max(rise, peak + highest(lines, -way, at - within, at)[0])
        near = [
            k
            for line in lines
            for k in {max(line[0], end - within), min(line[1] - 1, end)}
            if max(line[0], end - within) <= k <= min(line[1] - 1, end)
            and way * value(line, k) >= peak - config.turn * fall
        ]
        before = highest(lines, way, end - 2 * within, end - within - 1)[0]
        if (
            at >= hold
            and least <= fall <= most
            and low <= peak <= high
            and peak >= config.loaded * fall
            and before <= peak + config.turn * fall
            and rise <= config.share * fall
        ):
            return max(near)
    return None


def snaps(
    config: SnapConfig, dt: float, sizes: Sequence[float], windows: Sequence[tuple[Line | None, Line]]
) -> Iterator[Said]:
    """What is said after each window, given the word that it published and the running line."""
    words: list[Line] = []
    falls: list[tuple[int, dict[float, float]]] = []
    seen, open_ = -(10**9), False
    for word, running in windows:
        words += [word] if word else []
        now = running[1]
        falls.append((now - 1, {way: fallen(config, dt, way, [*words, running]) for way in (1.0, -1.0)}))
        sure = released(config, dt, sizes, words, now, falls) if word else None
        likely = released(config, dt, sizes, [*words, running], now, falls)
        found = sure if sure is not None else likely
        first = not open_ and found is not None and now - seen > round(config.apart / dt)
        published = sure is not None and (first or open_)
        if first:
            seen = now
        if first or published:
            begin = sure if published else likely
            yield Said(now, begin or 0, published, seen)
        forgotten = now - seen > round((config.within + config.apart) / dt)
        open_ = (open_ or first) and not published and not forgotten
