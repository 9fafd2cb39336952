"""Trials, golden tables and hand-made rows for the tests of the offline taxonomy."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.labels import AXES, LLB, MC
from rcbht_jax.reference import OfflineLabels, encode

SETS = (
    "REAL_HIRO_ONE_SA_ERROR_CHARAC",
    "REAL_HIRO_ONE_SA_SUCCESS",
    "SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob",
    "SIM_HIRO_ONE_SA_SUCCESS",
    "SIM_HIRO_TWO_SA_SUCCESS",
)
TWO_ARMS = "SIM_HIRO_TWO_SA_SUCCESS"


class Golden(NamedTuple):
    """Recorded tables of one axis."""

    trial: str
    arm: str
    axis: str
    tables: dict[str, NDArray[np.float64]]


def onset(folder: Path) -> list[float]:
    """Values of the right arm's state file."""
    return [float(word) for word in (folder / "R_State.dat").read_text().split()]


class Job(NamedTuple):
    """One recording to label."""

    folder: Path
    arm: str
    version: str
    states: list[float]


def job(folder: Path, arm: str, version: str, states: list[float] | None = None) -> Job:
    """Job with the state times of the trial's own file unless others are given."""
    return Job(folder, arm, version, onset(folder) if states is None else states)


def encode_job(work: Job) -> OfflineLabels:
    """Labels of one recording, with the calibration of its data set."""
    table = np.loadtxt(work.folder / f"{work.arm}_Torques.dat", usecols=range(7))
    two_arms = work.folder.parent.name == TWO_ARMS
    return encode(table[:, 0], table[:, 1:], work.states, version=work.version, calibrated=two_arms)


def encode_all(jobs: Sequence[Job]) -> list[OfflineLabels]:
    """Labels of many recordings, in fresh processes, which the run-time type checks do not slow down."""
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(encode_job, jobs, chunksize=4))


def golden_axes(stored: dict[str, NDArray], trial: int, arm: int) -> Iterator[Golden]:
    """Recorded tables of the six axes of one arm of one trial."""
    arms = len(stored["arms"])
    for k, axis in enumerate(AXES):
        n = (trial * arms + arm) * 6 + k
        tables = {
            layer: stored[layer][stored[f"{layer}_off"][n] : stored[f"{layer}_off"][n + 1]]
            for layer in ("prim_raw", "prim", "mc_raw", "mc", "llb_raw", "llb")
        }
        yield Golden(str(stored["trial"][trial]), str(stored["arms"][arm]), axis, tables)


def primitive_row(start: float, end: float, low: float, high: float, label: int, slope: float = 1.0) -> list[float]:
    """A primitive."""
    return [float(x) for x in ((high + low) / 2, high, low, start, end, slope, label)]


def motion_row(
    label: MC,
    times: tuple[float, float, float, float],
    avg: float = 1.0,
    amp: float = 1.0,
    tags: tuple[int, int] = (1, 1),
) -> list[float]:
    """A motion composition whose maximum lies half an amplitude above its average."""
    row = (label, avg, avg + amp / 2, amp, *tags, *times, (times[0] + times[3]) / 2)
    return [float(x) for x in row]


def motion_rows(labels: str, amp: float = 1.0) -> list[list[float]]:
    """Compositions of one second each, by name."""
    return [
        motion_row(MC[label.upper()], (k, k + 0.5, k + 0.5, k + 1), amp=amp) for k, label in enumerate(labels.split())
    ]


def behaviour_row(label: LLB, start: float, end: float, avg: float = 1.0, amp: float = 1.0) -> list[float]:
    """A low-level behaviour of two equal halves."""
    middle = (start + end) / 2
    row = (label, *[avg] * 6, *[amp] * 3, 1, 1, start, middle, middle, end, middle)
    return [float(x) for x in row]
