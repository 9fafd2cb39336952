"""Small parts of every set, for comparing words with other descriptions of a signal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from experiments._lib.benchmarks import REAL, SIM1, SIM2, of_sources, recorded
from experiments._lib.other_robots import KITTING, of_other_robot
from rcbht_jax.calibration.rest import auto_thresholds, rest_not_constant
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.encoding.tolerance import auto_tolerance
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

CONTACT = {name: KITTING[name] for name in ("force", "torque", "left", "right")}
OTHERS = {  # file or folder, mapping, channels
    "caps": ("caps/runs_40hz", "caps_40hz", None),
    "kitting": ("kitting", "kitting", CONTACT),
    "failures LP1": ("robot_execution_failures/lp1.csv", "robot_execution_failures", None),
}
COUNTS = {"REAL, session A": 6, "SIM1": 6, "two-arm": 6, "caps": 12, "kitting": 12, "failures LP1": 24}
OURS = tuple(COUNTS)[:3]  # recorded with the robot whose thresholds are known
SHORT = 100  # samples: recordings of fewer get smaller windows


def annotated_samples(recordings: Recordings, track: str, labels: tuple[str, ...]) -> NDArray[np.bool_]:
    """Samples ``[recording, time, axis]`` with one of these labels."""
    codes = [recordings.annotations.labels[track].index(label) for label in labels]
    samples = recordings.wrench.shape[1]
    rows = [recordings.annotations.of_samples(i, track, samples, recordings.dt) for i in range(len(recordings))]
    return np.broadcast_to(np.isin(np.stack(rows), codes)[..., None], recordings.wrench.shape)


def moving(track: LabelTrack, rest: NDArray[np.bool_], constant: int) -> NDArray[np.float64]:
    """Samples ``[2, recording, axis]`` at rest whose label is not constant, and at rest."""
    rows = [slice(row, row + 1) for row in range(len(rest))]
    each = [rest_not_constant(jax.tree.map(itemgetter(row), track), rest[row], 1, constant) for row in rows]
    whole = rest.sum(1).astype(np.float64)
    return np.stack([np.stack(each) * whole, whole])


@dataclass(frozen=True)
class Part:
    """Recordings of a set, and what the rules need for them."""

    recordings: Recordings
    hiro: bool  # the preset holds; else limits come from rest

    @property
    def signals(self) -> list[list[NDArray[np.float64]]]:
        """``[recording][axis]`` of ``[time]``."""
        rows = zip(self.recordings.wrench, self.recordings.length, strict=True)
        return [list(one[:samples].astype(np.float64).T) for one, samples in rows]

    @property
    def seconds(self) -> float:
        return float(self.recordings.length.sum() * self.recordings.dt)

    @property
    def tolerance(self) -> NDArray[np.float64]:
        """The default of the fit rule ``[axis]``."""
        needed = FitConfig(self.windows[0], self.recordings.dt).needed
        return auto_tolerance(self.recordings.wrench, self.recordings.length, needed)

    @property
    def windows(self) -> tuple[int, int]:
        """The usual window of the fit rule, and a small one."""
        return (3, 2) if self.recordings.length.max() < SHORT else (5, 2)

    @property
    def published(self) -> tuple[int, ...]:
        """Windows of the published rules; fewer of them where each has to be compiled for one set."""
        return (5, 10, 20) if self.hiro else (2, 5) if self.windows[0] < 5 else (5, 20)

    def limits(self, window: int, rule: str = "paper") -> NDArray[np.float64]:
        """Gradient limits ``[axis, 4]``."""
        found = preset("hiro", self.recordings.axes) if self.hiro else auto_thresholds(self.recordings, window, rule)
        return np.asarray(found.limits, np.float64)

    def words(self, rule: str, window: int, tolerance: Any = None, of: Recordings | None = None) -> LabelTracks:
        """Labels by either rule of these recordings, or of copies of them."""
        copies = of or self.recordings
        options = {"rule": rule, "tolerance": tolerance} if rule == "fit" else {}
        return rcbht_jax.encode(
            copies.wrench,
            1 / copies.dt,
            window=window,
            thresholds=self.limits(window, rule),
            lengths=copies.length,
            **options,
        )


def spread(recordings: Recordings, count: int) -> Recordings:
    """So many of the recordings, from the first to the last."""
    return recordings.take(np.linspace(0, len(recordings) - 1, min(count, len(recordings))).astype(int))


@cache
def _recorded() -> Recordings:
    return recorded()


@cache
def part(name: str) -> Part:
    """The recordings of one of COUNTS."""
    if name in OURS:
        source = dict(zip(OURS, (REAL, SIM1, SIM2), strict=True))[name]
        found = of_sources(_recorded(), (source,))
        return Part(spread(found.take(found.session == "A") if source == REAL else found, COUNTS[name]), True)
    return Part(spread(of_other_robot(*OTHERS[name], keep_copies=True), COUNTS[name]), False)
