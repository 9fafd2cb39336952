"""Two changes to the fit rule that were tried: breaks that all axes share, and a tolerance that tracks the noise.

Shared breaks: one decision for all axes, by the sum of what they save in squared tolerances; the threshold is that of
one axis, and the curve over the tolerance covers any other. Under noise that of six axes is tried, too. A word that
shares its break is two numbers, and the break a third one for all axes; a word of its own is three. Tracked noise: the
tolerance is the given one, or twice the deviation of the noise, which is an exponential mean of squared second
differences over one second, taken while the run is constant; or, for comparison, the median of the last second's second
differences, at rest or not.

Curves have windows of two samples, words under noise those of 25 ms; sets, copies and measures are those of
experiments.words.rate_distortion. Window, memory and factor were fixed before; nothing was tuned.

Run: python -m experiments.words.tried --seed 0 (reads RCBHT_DATA)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import tyro

from experiments._lib.benchmarks import rounded
from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows, command_of
from experiments._lib.fit_variants import SumsOfAxes, Variant, breaks, words_of
from experiments._lib.word_stability import Words, agreement
from experiments.words.rate_distortion import TARGETS, needed, significant
from experiments.words.sets import OURS, Part, part
from experiments.words.stability import NOISE, WINDOW, noisy_copies
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.types import Recordings

FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # on the default tolerance
OWN, SHARED, SIX = "breaks of its own", "shared breaks", "shared breaks, threshold of six axes"
WIDER = "breaks of its own, tolerance x 2.4"  # factor by which one axis alone must deviate to break all six
REST, MEDIAN = "noise tracked at rest", "median noise of a second"
CURVES = {OWN: Variant(), SHARED: Variant(shared=1), REST: Variant(track="at rest")}
STABLE = {**CURVES, MEDIAN: Variant(track="median"), SIX: Variant(shared=6), WIDER: Variant(wider=6**0.5)}


def signals(recordings: Recordings) -> list[np.ndarray]:
    """``[recording]`` of ``[time, axis]``."""
    rows = zip(recordings.wrench, recordings.length, strict=True)
    return [one[:samples].astype(np.float64) for one, samples in rows]


def approximated(data: Part, config: FitConfig, factor: float, variant: Variant) -> tuple[float, np.ndarray]:
    """Residual, mean over axes, and words of every axis."""
    small = data.limits(config.window)[:, 3]
    missed, total, words = np.zeros((3, len(data.recordings.axes)))
    for y in signals(data.recordings):
        sums = SumsOfAxes(y)
        for axis, starts in enumerate(breaks(y, config, data.tolerance * factor, small, variant)[0]):
            start = np.array(starts)
            missed[axis] += sums.line(start, np.append(start[1:], len(y)), np.full_like(start, axis))[1].sum()
            words[axis] += len(start)
        total += ((y - y.mean(0)) ** 2).sum(0)
    return significant(float((missed / total).mean())), words


def curve(name: str, kind: str) -> dict[str, Any]:
    """Words, and numbers, for each second at several residuals."""
    data, variant, points = part(name), CURVES[kind], []
    config = FitConfig(data.windows[1], data.recordings.dt)
    for factor in FACTORS:
        residual, words = approximated(data, config, factor, variant)
        rate = {"words": words.mean(), "numbers": words.mean() * (2 + 1 / len(words) if variant.shared else 3)}
        per_second = {f"{what} per second": significant(float(each) / data.seconds) for what, each in rate.items()}
        points.append({"factor": factor, "residual": residual, **per_second})
    out: dict[str, Any] = {"points": points}
    for what in ("words", "numbers"):
        pairs = [(point[f"{what} per second"], point["residual"]) for point in points]
        out[f"{what} per second at residual"] = {f"{target:g}": needed(pairs, target) for target in TARGETS}
    return out


def of_clean(name: str, kind: str) -> dict[str, Any]:
    """Residual and words of the recordings themselves, with the window of the rows under noise."""
    data = part(name)
    config = FitConfig(round(WINDOW / data.recordings.dt), data.recordings.dt)
    residual, words = approximated(data, config, 1.0, STABLE[kind])
    return {"residual": residual, "words per second": significant(float(words.mean()) / data.seconds)}


def of_noise(name: str, kind: str, seed: int) -> dict[str, Any]:
    """Agreement of the primitives of two copies at every level of noise."""
    data, found = part(name), {}
    for level in NOISE:
        first, second = (_words(data, copy, STABLE[kind]) for copy in noisy_copies(data, level, seed))
        agreed = rounded(agreement(zip(first, second, strict=True), WINDOW, len(data.tolerance)))
        rate = np.mean([len(one.label) for one in first]) * len(data.recordings) / data.seconds
        found[f"{level:g}"] = agreed | {"words per second": significant(float(rate))}
    return found


def _words(data: Part, copy: Recordings, variant: Variant) -> list[Words]:
    window = round(WINDOW / copy.dt)
    config, limits = FitConfig(window, copy.dt), data.limits(window)
    out = []
    for y in signals(copy):
        found, tolerance = breaks(y, config, data.tolerance, limits[:, 3], variant)
        out += words_of(y, found, copy.dt, limits, tolerance)
    return out


def main(seed: int = 0, only: Only = ALL_ROWS) -> None:
    about = {
        "what": "two changes to the fit rule in NumPy: rate and residual, and stability of primitives under noise",
        "not chosen here": "window, memory and factor of the noise were fixed before; nothing was tuned on these sets",
        "factors": FACTORS,
        "noise, tolerances": NOISE,
    }
    wanted: dict[str, Callable[[], Any]] = {
        f"rate | {name} | {kind}": partial(curve, name, kind) for name in OURS for kind in CURVES
    }
    wanted |= {f"clean | {name} | {kind}": partial(of_clean, name, kind) for name in OURS for kind in STABLE}
    wanted |= {f"noise | {name} | {kind}": partial(of_noise, name, kind, seed) for name in OURS for kind in STABLE}
    Rows("fit_tried", command_of(main, locals()), about, seed).fill(wanted, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
