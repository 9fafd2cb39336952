"""Difference between a repeated result and the committed one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

# Keys whose values may differ between runs: what a machine takes, and what is installed on it.
_ABOUT = re.compile(
    r"libraries|complete|time first|(?:.*[ _])?(?:seconds|microseconds)(?:[ _(].*)?|"
    r"(?:.*[ _])?(?:samples|steps|candidates|readings|trials(?:_of_15_s)?)[ _]per[ _](?:second|minute).*"
)


def numbers(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a result, with its place."""
    for key, within, part in _parts(value, place):
        if not _ABOUT.fullmatch(key) or _is_score(part):
            yield from numbers(part, within)
    if isinstance(value, int | float):
        yield place, float(value)


def _is_score(value: Any) -> bool:
    """Whether an object holds a score, at any depth: names of rows may speak of seconds."""
    if not isinstance(value, dict):
        return False
    return bool({"mean", "accuracy", "low"} & set(value)) or any(map(_is_score, value.values()))


def _parts(value: Any, place: str) -> Iterator[tuple[str, str, Any]]:
    """Key, place and content of every part of an object or a list; none of anything else."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in pairs:
        yield str(key), f"{place} > {key}" if place else str(key), part


def intervals(value: Any, place: str = "") -> Iterator[tuple[str, float, float, float]]:
    """Every score that has a 95 % interval: where it is, the score, the interval's ends."""
    if isinstance(value, dict):
        score = next((value[key] for key in ("mean", "accuracy") if isinstance(value.get(key), int | float)), None)
        ends = value["interval"] if "interval" in value else [value.get("low"), value.get("high")]
        if score is not None and isinstance(ends, list) and all(isinstance(end, int | float) for end in ends):
            yield place, float(score), float(ends[0]), float(ends[1])
    for _, within, part in _parts(value, place):
        yield from intervals(part, within)


def largest_difference(first: Any, second: Any) -> tuple[float, str]:
    """Largest difference of two results' numbers, and where; times are left out, what one lacks counts as infinite."""
    worst = (0.0, "")
    a, b = dict(numbers(first)), dict(numbers(second))
    for place in a | b:
        there = place in a and place in b
        apart = abs(a[place] - b[place]) if there else float("inf")
        if apart > worst[0]:
            worst = apart, place
    return worst


def apart(repeated: Any, committed: Any) -> tuple[int, list[str]]:
    """Number of scores of which both results have an interval, and a line for each whose intervals do not overlap."""
    scores = {place: score for place, *score in intervals(repeated)}
    known = [one for one in intervals(committed) if one[0] in scores]
    margin = 5e-4  # results are rounded
    out = [
        f"{place}: {_score(*scores[place])}, committed {_score(score, low, high)}"
        for place, score, low, high in known
        if scores[place][1] > high + margin or scores[place][2] < low - margin
    ]
    return len(known), out


def _score(score: float, low: float, high: float) -> str:
    return f"{score:.3f} ({low:.3f} to {high:.3f})"


def whole(name: str, repeated: Any, committed: Any) -> str:
    """A sentence on a result made in the same way."""
    difference, place = largest_difference(repeated, committed)
    return f"{name}: largest difference from the committed result {difference:g} {place}".rstrip()


def shorter(name: str, repeated: Any, committed: Any, options: str) -> str:
    """A sentence on a shorter form of a result."""
    count, out = apart(repeated, committed)
    if count:
        text = f"the 95 % intervals of {count - len(out)} of {count} scores overlap the committed ones"
    else:
        here, there = dict(numbers(repeated)), dict(numbers(committed))
        both = {place: abs(here[place] - there[place]) for place in here if place in there}
        place = max(both, key=lambda one: both[one], default="")
        text = f"no interval to compare; largest difference of {len(both)} numbers {both.get(place, 0):g} {place}"
    lines = [f"{name}: a shorter form ({options}); {text}", *(f"  apart: {line}" for line in out)]
    return "\n".join(lines).rstrip()
