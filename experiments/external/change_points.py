"""Segmentation by change points that are found without labels, each segment then labelled by the one method.

Changes: ClaSP (Schaefer, Ermshaus and Leser 2021) of the library aeon with its default width, on the norm of the force,
with the median number of changes of the other runs; and those that CLaP (Ermshaus, Schaefer and Leser 2025) of its
authors' library keeps, on all axes, which learns width and number from the run. The one method
(:mod:`experiments.external.method`) learns from the annotated segments of other runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from experiments.external import method
from rcbht_jax.errors import InputError
from rcbht_jax.features.spans import Intervals
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

FORCE = 3  # axes


def clasp(series: Float[np.ndarray, "time axis"], count: int, seed: int) -> NDArray[np.int64]:
    """First samples of the segments of one run, 0 left out: so many changes as ClaSP ranks highest."""
    from aeon.segmentation import ClaSPSegmenter

    return np.asarray(ClaSPSegmenter(n_cps=count).fit_predict(np.linalg.norm(series[:, :FORCE], axis=1)))


def clap(series: Float[np.ndarray, "time axis"], count: int, seed: int) -> NDArray[np.int64]:
    """First samples of the segments of one run, 0 left out: the changes between states of CLaP."""
    from claspy.segmentation import BinaryClaSPSegmentation
    from claspy.state_detection import AgglomerativeCLaPDetection

    found = BinaryClaSPSegmentation(n_jobs=1, random_state=seed).fit_predict(series)
    if not len(found):
        return np.zeros(0, np.int64)
    return np.asarray(AgglomerativeCLaPDetection(n_jobs=1, random_state=seed).fit(series, found).get_change_points())


ORACLE = "annotated changes (oracle)"
DETECTORS = {"ClaSP, number of changes from other runs": clasp, "CLaP, its own number of changes": clap}


def cut(items: LabelledIntervals, recordings: Recordings, marks: list[NDArray[np.int64]]) -> LabelledIntervals:
    """The segments between the marks of each run, with a placeholder class."""
    edges = [np.concatenate([[0], at, [n]]) for at, n in zip(marks, recordings.length.tolist(), strict=True)]
    row = np.repeat(np.arange(len(edges)), [len(edge) - 1 for edge in edges])
    intervals = Intervals(
        recording=row,
        start=np.concatenate([edge[:-1] for edge in edges]).astype(np.int64),
        end=np.concatenate([edge[1:] for edge in edges]).astype(np.int64),
        dt=recordings.dt,
    )
    return replace(
        items, y=np.zeros(len(row), np.int64), trial=recordings.trial[row], session=recordings.session[row],
        intervals=(intervals,),
    )  # fmt: skip


def label(recordings: Recordings, marks: list[NDArray[np.int64]], seed: int) -> list[NDArray[np.int64]]:
    """The class of every sample of each annotated run, by classifiers of the segments of all other runs."""
    track = recordings.annotations.choose()
    known = labelled_intervals(recordings, TaskSpec(track, outcomes=()))
    found = cut(known, recordings, marks)
    parts = [method.describe(recordings, items) for items in (known, found)]
    words, wrench = (np.concatenate(pair) for pair in zip(*parts, strict=True))
    codes = np.array([recordings.annotations.labels[track].index(name) for name in known.classes])
    y = np.concatenate([known.y, found.y])
    of_known, of_found = known.intervals[0].recording, found.intervals[0].recording
    out = []
    for run, samples in enumerate(recordings.length.tolist()):
        train, test = np.flatnonzero(of_known != run), len(known.y) + np.flatnonzero(of_found == run)
        best = method.believe(words, wrench, y, train, test, seed).argmax(1)
        out.append(np.repeat(codes[best], np.diff(np.concatenate([[0], marks[run], [samples]]))))
    return out


def oracle(recordings: Recordings) -> list[NDArray[np.int64]]:
    """The annotated changes of each run."""
    track = recordings.annotations.of(recordings.annotations.choose())
    first = np.rint(track.start / recordings.dt).astype(np.int64)
    starts = [np.unique(first[track.recording == row]) for row in range(len(recordings))]
    return [at[(at > 0) & (at < n)] for at, n in zip(starts, recordings.length.tolist(), strict=True)]


def scored(recordings: Recordings, detector: str, seed: int) -> tuple[list[NDArray[Any]], dict[str, Any]]:
    """Labels of every run by one of DETECTORS, or ORACLE, and how many segments were found and annotated.

    Raises:
        InputError: a library of the peers is missing.
    """
    track = recordings.annotations.of(recordings.annotations.choose())
    changes = np.bincount(track.recording, minlength=len(recordings)) - 1
    try:
        marks = oracle(recordings) if detector == ORACLE else _found(recordings, DETECTORS[detector], changes, seed)
    except ImportError as error:
        raise InputError('change points need the libraries aeon and claspy; see "make peers".') from error
    counts = {"segments found": sum(len(at) + 1 for at in marks), "segments annotated": len(track)}
    return label(recordings, marks, seed), counts


def _found(
    recordings: Recordings, detect: Callable[..., NDArray[np.int64]], changes: NDArray[np.int64], seed: int
) -> list[NDArray[np.int64]]:
    marks = []
    for row, samples in enumerate(recordings.length.tolist()):
        count = round(float(np.median(np.delete(changes, row))))
        found = np.unique(detect(recordings.wrench[row, :samples].astype(np.float64), count, seed))
        marks.append(found[(found > 0) & (found < samples)].astype(np.int64))  # an edge is no change
    return marks
