"""Snaps by brute force: every sample of every line is looked at, in plain Python, from the words of one axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rcbht_jax.introspection.snaps import SnapConfig

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


def released(config: SnapConfig, dt: float, sizes: Sequence[float], lines: Sequence[Line]) -> int | None:
    """First sample of the fall with which the last line ends; None = it does not."""
    least, most, low, high = sizes
    within, hold = round(config.within / dt), round(config.hold / dt)
    end = lines[-1][1] - 1
    for way in (1.0, -1.0):
        peak, at = highest(lines, way, end - within, end)
        fall = peak - way * lines[-1][3]
        near = [
            k
            for line in lines
            for k in {max(line[0], end - within), min(line[1] - 1, end)}
            if max(line[0], end - within) <= k <= min(line[1] - 1, end)
            and way * value(line, k) >= peak - config.turn * fall
        ]
        before = highest(lines, way, end - 2 * within, end - within - 1)[0]
        lowest = -highest(lines, -way, at - hold, at)[0]
        if (
            lines[0][0] <= at - hold
            and least <= fall <= most
            and low <= peak <= high
            and peak >= config.loaded * fall
            and before <= peak + config.turn * fall
            and lowest >= peak - config.share * fall
        ):
            return max(near)
    return None


def snaps(
    config: SnapConfig, dt: float, sizes: Sequence[float], windows: Sequence[tuple[Line | None, Line]]
) -> Iterator[Said]:
    """What is said after each window, given the word that it published and the running line."""
    words: list[Line] = []
    seen, open_ = -(10**9), False
    for word, running in windows:
        words += [word] if word else []
        now = running[1]
        sure = released(config, dt, sizes, words) if word else None
        likely = released(config, dt, sizes, [*words, running])
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
