"""Rate and distortion of words: residual of the wrench over words per second, and stability under noise.

Residuals are one minus R2 of each axis, pooled over the recordings of a set, mean over axes; words per second are those
of one axis, mean over axes. Intervals come from recordings drawn with replacement. Every method has one knob, which
makes its curve: the tolerance of the fit rule and of the streaming filters (factors on the fit rule's default), the
window of the published rules and of SAX, a penalty of the optimum. Stability: two copies with independent white noise,
and copies at other rates, for both rules and for the bottom-up lines, which see the whole recording.

Run: python -m experiments.words.rate_distortion --seed 0
Reads RCBHT_DATA and RCBHT_EXTERNAL; the rows of SAX and ABBA need tslearn and fABBA (make peers).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import tyro

from experiments._lib import piecewise, symbolic
from experiments._lib.arrays import Floats
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.intervals import drawn
from experiments._lib.piecewise import Approximation
from experiments.words import stability
from experiments.words.fit_quality import residuals
from experiments.words.sets import COUNTS, Part, part
from rcbht_jax.learning.metrics import percentile_interval

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # on the default tolerance
PENALTIES = (2.5, 15.0, 90.0, 540.0, 3240.0)  # squared tolerances per piece
WIDTHS = (3, 5, 10, 20, 40, 80)  # of SAX and of equal windows, samples
ALPHA = 0.1  # of fABBA
TARGETS = (0.05, 0.01, 0.002)  # residuals at which curves are compared
Point = tuple[str, Floats]  # its name; words, squared residuals and squared deviations [3, recording, axis]
Curve = list[Point]
Method = Callable[[Part], Curve]

# Properties of a method: when it can publish a word, and how many numbers a word has besides its length.
KINDS = {
    "published rules": ("stream, may wait for long", 2),
    "fit": ("stream", 2),
    "fit, small window": ("stream", 2),
    "sliding window": ("stream", 2),
    "swing filter": ("stream", 1),
    "slide filter": ("stream", 2),
    "ABBA chain": ("stream", 1),
    "equal windows": ("stream", 2),
    "SAX": ("range known before", 1),
    "1d-SAX": ("range known before", 2),
    "fABBA symbols": ("whole recording", 1),
    "bottom-up, as many as fit": ("whole recording", 2),
    "bottom-up, as many as fit, small window": ("whole recording", 2),
    "optimum": ("whole recording", 2),
}


def point(at: str, sums: Floats, seconds: float) -> dict[str, Any]:
    """One point of a curve; words and residual of every axis."""
    words, residual = rates(sums.sum(1), seconds)
    return {
        "at": at,
        "words per second": significant(float(words.mean())),
        "residual": significant(float(residual.mean())),
        "words per second by axis": [significant(value) for value in words.tolist()],
        "residual by axis": [significant(value) for value in residual.tolist()],
    }


def rates(sums: Floats, seconds: float | Floats) -> tuple[Floats, Floats]:
    """Words per second and residual, of sums ``[3, ...]``."""
    words, missed, total = sums
    return words / seconds, missed / np.where(total > 0, total, 1.0)


def significant(value: float) -> float:
    return float(f"{value:.4g}")


def of_approximations(data: Part, at: str, found: Iterable[Sequence[Approximation]]) -> Point:
    """The point of approximations ``[recording][axis]``."""
    sums = [
        [(one.words, ((y - one.values) ** 2).sum(), ((y - y.mean()) ** 2).sum()) for y, one in zip(*both, strict=True)]
        for both in zip(data.signals, found, strict=True)
    ]
    return at, np.moveaxis(np.array(sums, float), -1, 0)


def of_rule(data: Part, rule: str, at: str, window: int, tolerance: Any = None) -> Point:
    """The point of the primitives of either rule, as lines with their own mean and slope."""
    track = data.words(rule, window, tolerance).primitive
    words = np.asarray(track.label > 0).sum(-1)
    return at, np.stack([words, *residuals(track, data.recordings)])


def paper(data: Part) -> Curve:
    return [of_rule(data, "paper", f"window {window}", window) for window in data.published]


def fit(data: Part, small: bool) -> Curve:
    window, tolerance = data.windows[small], data.tolerance
    return [of_rule(data, "fit", f"tolerance x{factor:g}", window, tolerance * factor) for factor in FACTORS]


def bottom_up(data: Part, small: bool) -> Curve:
    """The best merged lines, of every recording and axis as many as the fit rule has words."""
    orders = [[piecewise.bottom_up(y) for y in row] for row in data.signals]
    curve = []
    for factor in FACTORS:
        counts = np.asarray(data.words("fit", data.windows[small], data.tolerance * factor).primitive.label > 0).sum(-1)
        found = [
            [piecewise.lines(y, piecewise.left_over(o, k)) for y, o, k in zip(row, order, count, strict=True)]
            for row, order, count in zip(data.signals, orders, counts.tolist(), strict=True)
        ]
        curve.append(of_approximations(data, f"as many as fit x{factor:g}", found))
    return curve


def of_each(data: Part, at: str, make: Callable[..., Approximation], of_axes: Iterable[Sequence[float]]) -> Point:
    """The point of a method that takes every axis by itself, with some numbers of that axis."""
    numbers = list(of_axes)
    found = [[make(y, *own) for y, own in zip(row, numbers, strict=True)] for row in data.signals]
    return of_approximations(data, at, found)


def by_tolerance(data: Part, make: Callable[[Floats, float], Approximation], knobs: Sequence[float], at: str) -> Curve:
    """A method whose knob is a multiple of the default tolerance."""
    return [of_each(data, f"{at} x{knob:g}", make, ([t * knob] for t in data.tolerance.tolist())) for knob in knobs]


def by_width(
    data: Part, make: Callable[[Floats, int, float, float], Approximation], widths: Sequence[int] = WIDTHS
) -> Curve:
    """A method whose knob is the samples of a window; it knows mean and deviation of every axis."""
    every = [np.concatenate(parts) for parts in zip(*data.signals, strict=True)]
    scale = [(float(y.mean()), float(y.std()) or 1.0) for y in every]
    fitting = [width for width in widths if 2 * width <= data.recordings.length.max()]
    return [of_each(data, f"window {width}", make, ((width, *known) for known in scale)) for width in fitting]


def optimum(data: Part) -> Curve:
    def make(y: Floats, root: float) -> Approximation:
        return piecewise.lines(y, piecewise.optimal(y, root * root))

    curve = by_tolerance(data, make, np.sqrt(PENALTIES).tolist(), "")
    return [(f"penalty {penalty:g}", sums) for (_, sums), penalty in zip(curve, PENALTIES, strict=True)]


METHODS: dict[str, Method] = {
    "published rules": paper,
    "fit": partial(fit, small=False),
    "fit, small window": partial(fit, small=True),
    "sliding window": lambda data: by_tolerance(
        data, lambda y, t: piecewise.lines(y, piecewise.sliding_window(y, t)), FACTORS, "tolerance"
    ),
    "swing filter": lambda data: by_tolerance(data, piecewise.swing, FACTORS, "bound"),
    "slide filter": lambda data: by_tolerance(data, piecewise.slide, FACTORS, "bound"),
    "equal windows": lambda data: by_width(
        data, lambda y, width, *_: piecewise.lines(y, np.arange(width, len(y), width))
    ),
    "bottom-up, as many as fit": partial(bottom_up, small=False),
    "bottom-up, as many as fit, small window": partial(bottom_up, small=True),
    "optimum": optimum,
    "ABBA chain": lambda data: by_tolerance(data, symbolic.abba_chain, FACTORS, "tolerance"),
    "fABBA symbols": lambda data: by_tolerance(
        data, lambda y, t: symbolic.fabba(y, t, ALPHA), FACTORS, "tolerance"
    ),
    "SAX": lambda data: by_width(data, symbolic.sax),
    "1d-SAX": lambda data: by_width(  # the library takes most of a millisecond for a window
        data, partial(symbolic.sax, slopes=True), WIDTHS[2:] if data.windows[0] == 5 else WIDTHS
    ),
}  # fmt: skip


def needed(curve: Iterable[tuple[float, float]], target: float) -> float | None:
    """Words per second at which a curve reaches a residual: a line on logarithmic scales between its points.

    None where no point of it does, or where all do. A point counts only if no point with fewer words is better.
    """
    best: list[tuple[float, float]] = []
    for rate, left in sorted(curve):
        if not best or left < best[-1][1]:
            best.append((rate, left))
    for (rate, left), (more, less) in pairwise(best):
        if less <= target < left:
            share = np.log(left / target) / np.log(left / max(less, 1e-12))
            return significant(float(rate * (more / rate) ** share))
    return None


def needed_by_chance(curve: Curve, seconds: Floats, target: float) -> list[float] | None:
    """The interval of :func:`needed` from recordings drawn with replacement; None where one draw in twenty has none."""
    many = drawn(len(seconds), 0)
    points = [rates(np.einsum("dr,sra->sda", many, sums), (many @ seconds)[:, None]) for _, sums in curve]
    means = np.array([[each.mean(-1) for each in both] for both in points])  # [point, 2, draw]
    found = [needed(map(tuple, one), target) for one in np.moveaxis(means, -1, 0).tolist()]
    known = np.array([value for value in found if value is not None])
    if len(known) < 0.95 * len(found):
        return None
    return [significant(end) for end in percentile_interval(known, len(seconds))]


def rate_row(name: str, method: str) -> dict[str, Any]:
    data = part(name)
    curve, seconds = METHODS[method](data), data.recordings.length * data.recordings.dt
    points = [point(at, sums, data.seconds) for at, sums in curve]
    reached = {f"{t:g}": needed([(p["words per second"], p["residual"]) for p in points], t) for t in TARGETS}
    ends = {key: needed_by_chance(curve, seconds, float(key)) for key, value in reached.items() if value is not None}
    return {"points": points, "words per second at residual": reached, "interval of words per second": ends}


def about() -> dict[str, Any]:
    facts = {}
    for name in COUNTS:
        found = part(name)
        facts[name] = {
            "recordings": len(found.recordings),
            "axes": list(found.recordings.axes),
            "seconds": significant(found.seconds),
            "rate": significant(1 / found.recordings.dt),
            "windows of fit": list(found.windows),
            "tolerance": [significant(value) for value in found.tolerance.tolist()],
        }
    return {
        "what": "residual of words against words per second; stability of words under noise and resampling",
        "not chosen here": "the default tolerance and window of the fit rule; no method was tuned on these sets",
        "kinds": {name: list(kind) for name, kind in KINDS.items()},
        "letters of SAX": symbolic.LETTERS,
        "alpha of fABBA": ALPHA,
        "sets": facts,
    }


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    """Measure every method on every set, and how stable words are."""
    wanted: dict[str, Callable[[], Any]] = {
        f"rate | {name} | {method}": partial(rate_row, name, method) for method in METHODS for name in COUNTS
    }
    Rows("rate_distortion", command_of(main, locals()), about(), seed).fill(wanted | stability.rows(seed), only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
