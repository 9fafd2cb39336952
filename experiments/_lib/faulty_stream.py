"""Hours of a wrench stream whose sensor fails now and then: the same readings for the same seed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.io.messages import Sample

HERTZ = 500
CYCLE = 20  # s of one task: free, contact, oscillation, held
RANGE = 40.0  # N, Nm; where the sensor saturates
FAULTS = (
    "drop-out", "NaN burst", "clock ahead", "clock back", "clock stumbles", "saturation", "absurd values",
    "stamps twice", "jitter",
)  # fmt: skip
SHARE = 0.02  # seconds in which a fault begins
LONGEST = 20  # s that a fault lasts at most


def readings(seconds: int, seed: int, counts: Counter[str]) -> Iterator[list[Sample]]:
    """Readings of one second after the other, drop-outs included.

    ``counts`` counts faults by name, and as "bad readings" and "stamps twice, readings" what must be left out.
    """
    rng, cycle = np.random.default_rng(seed), _cycle()
    clock, kind, left = 1.7e9, "", 0
    for second in range(seconds):
        start = second % CYCLE * HERTZ
        values = cycle[start : start + HERTZ] + rng.normal(0, 0.05, (HERTZ, 6))
        times = clock + np.arange(HERTZ) / HERTZ
        clock += 1
        if not left and rng.random() < SHARE:
            kind = FAULTS[rng.integers(len(FAULTS))]
            left = int(rng.integers(1, LONGEST)) if kind in ("drop-out", "saturation") and rng.random() < 0.5 else 1
            counts[kind] += 1
            if kind.startswith("clock"):
                clock += _jump(kind, rng)
        elif not left:
            kind = ""
        left = max(left - 1, 0)
        values, times = _spoilt(kind, values, times, rng, counts)
        yield [Sample(tuple(row), time) for row, time in zip(values.tolist(), times.tolist(), strict=True)]


def _cycle() -> NDArray[np.float64]:
    """One task ``[time, axis]``."""
    time = np.arange(CYCLE * HERTZ) / HERTZ
    push = np.clip((time - 5) * 4, 0, 25) * (time < 18)
    ring = 8 * np.exp(-(time - 10).clip(0) / 1.5) * np.sin(2 * np.pi * 2.4 * time) * (time > 10)
    force = push + ring
    return np.stack([0.2 * force, 0.1 * ring, -force, 0.03 * force, 0.05 * ring, 0.01 * push], 1)


def _jump(kind: str, rng: np.random.Generator) -> float:
    """Seconds by which the source's clock changes."""
    if kind == "clock stumbles":  # less than a restart: readings come too late until it has caught up
        return -float(rng.uniform(0.1, 0.9))
    far = math.exp(rng.uniform(math.log(2), math.log(3600)))
    return far if kind == "clock ahead" else -far


def _spoilt(
    kind: str, values: NDArray[np.float64], times: NDArray[np.float64], rng: np.random.Generator, counts: Counter[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A second of readings as a fault leaves them."""
    first = int(rng.integers(HERTZ - 1))
    some = slice(first, first + int(rng.integers(1, HERTZ)))
    if kind == "drop-out":
        return np.delete(values, some, 0), np.delete(times, some)
    if kind in ("NaN burst", "absurd values"):
        bad = (np.nan, np.inf, -np.inf) if kind == "NaN burst" else (1e7, -1e30, 1e300)
        values[some, rng.integers(6)] = rng.choice(bad)
        counts["bad readings"] += len(values[some])
    elif kind == "saturation":
        values = np.clip(20 * values, -RANGE, RANGE)
    elif kind == "stamps twice":
        values, times = np.repeat(values, 2, 0), np.repeat(times, 2)
        counts["stamps twice, readings"] += HERTZ
    elif kind == "jitter":
        times = times + rng.uniform(0, 0.4, HERTZ) / HERTZ
    return values, times
