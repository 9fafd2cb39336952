"""Recorded trials as streams: snapshots, the classifiers of sub-tasks, and the filter that detects their beginnings.

A head "state" reads the features of the sub-task, a head "phase" those of the whole trial so far.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.arrays import Flags, Floats
from experiments._lib.frozen import relative_of
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.introspection.alarms import PhaseFilter
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.introspection.training import (
    Snapshots,
    learn,
    regular_snapshots,
    since_trial_start,
    snapshot_features,
    training_snapshots,
)
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

Encoder = tuple[AnyConfig, AnyLimits]
Head = tuple[FeatureSpec, Grid, int]  # features, grid, and the snapshots that a complete interval counts for

Starts = dict[int, float]  # state -> s, when it was detected


def halves(items: LabelledIntervals, seed: int) -> Flags:
    """Which intervals train: those of a random half of the trials."""
    trials = np.unique(items.trial)
    return np.isin(items.trial, np.random.default_rng(seed).permutation(trials)[: len(trials) // 2])


def described(
    data: Recordings, snapshots: Snapshots, spec: FeatureSpec, encoder: Encoder, title: str
) -> NDArray[np.float32]:
    """Features of snapshots, with their progress."""
    with tqdm(total=len(snapshots), desc=title, file=sys.stderr, disable=None) as bar:
        return snapshot_features(data, snapshots, FeatureView(spec), *encoder, bar.update)


@dataclass(frozen=True)
class Detected:
    """Beliefs ``[snapshot, class]`` about streamed trials, where no beginning is given."""

    snapshots: Snapshots
    phase: Floats  # of the head "phase"
    filtered: Floats  # of the filter over them, whose states only follow each other
    starts: dict[int, Starts]  # recording -> the beginnings that the filter detects
    state: Floats  # of the head "state", with these beginnings


class Stream:
    """One data set: its snapshots, ``rate`` a second, described once for all splits.

    The head "phase" is only needed where beginnings are to be detected.
    """

    def __init__(
        self, data: Recordings, task: TaskSpec, encoder: Encoder, heads: Mapping[str, Head], rate: float
    ) -> None:
        self.data, self.encoder, self.heads = data, encoder, heads
        self.items = labelled_intervals(data, task)
        every = round(1 / (rate * data.dt))
        self.training, self.regular = training_snapshots(self.items, every), regular_snapshots(self.items, every)
        self.trial = since_trial_start(self.regular)
        self._x: dict[str, NDArray[np.float32]] = {}
        self._trained: dict[str, tuple[tuple[Any, ...], ProbabilisticSvm]] = {}  # of each head, the newest

    def x(self, which: str) -> NDArray[np.float32]:
        """Features of the training, regular or trial snapshots, all families."""
        if which not in self._x:
            chosen = {
                "training": self.training,
                "regular": self.regular,
                "trial": self.trial,
                "trial training": since_trial_start(self.training),
            }[which]
            self._x[which] = self.described(chosen, "phase" if which.startswith("trial") else "state")
        return self._x[which]

    def described(self, snapshots: Snapshots, head: str) -> NDArray[np.float32]:
        return described(self.data, snapshots, self.heads[head][0], self.encoder, head)

    def used(self, x: NDArray[np.float32], head: str, relative: bool) -> Floats:
        """The columns that a head uses, all or those without an offset or a duration."""
        spec = self.heads[head][0]
        kept = relative_of(spec).families if relative else spec.families
        return x[:, np.isin([name.split(".")[0] for name in names(spec)], kept)].astype(np.float64)

    def trained(self, head: str, relative: bool, inside: Flags, seed: int) -> ProbabilisticSvm:
        """A classifier of the present state, of the snapshots of the training trials."""
        key = (relative, inside.tobytes(), seed)
        if self._trained.get(head, ((), None))[0] != key:
            spec, grid, ends = self.heads[head]
            which, snapshots = "training", self.training
            if head == "phase":
                which, snapshots = "trial training", since_trial_start(snapshots)
            rows = np.flatnonzero(inside[snapshots.interval])
            x, spec = self.used(self.x(which)[rows], head, relative), relative_of(spec) if relative else spec
            self._trained[head] = key, learn(x, snapshots.take(rows), self.items, spec, grid, ends, seed)
        return self._trained[head][1]

    def given(self, relative: bool, inside: Flags, seed: int) -> tuple[Snapshots, Floats]:
        """The streamed snapshots, and the beliefs of the head "state" where each beginning is given."""
        rows = np.flatnonzero(~inside[self.regular.interval])
        machine = self.trained("state", relative, inside, seed)
        return self.regular.take(rows), machine.probability(self.used(self.x("regular")[rows], "state", relative))

    def detected(self, relative: bool, inside: Flags, seed: int) -> Detected:
        """The beliefs where no beginning is given."""
        rows, dt = np.flatnonzero(~inside[self.trial.interval]), self.data.dt
        snapshots = self.trial.take(rows)
        phase = self.trained("phase", relative, inside, seed)
        p = phase.probability(self.used(self.x("trial")[rows], "phase", relative))
        filtered, starts, state = np.empty_like(p), {}, np.empty_like(p)
        for recording in np.unique(snapshots.recording).tolist():
            mine = snapshots.recording == recording
            filtered[mine], starts[recording] = followed(p[mine], snapshots.now[mine] * dt, self.items.classes)
        own = with_beginnings(snapshots, starts, dt)
        order = np.lexsort((own.now, own.recording))
        x = self.used(self.described(own.take(order), "state"), "state", relative)
        state[order] = self.trained("state", relative, inside, seed).probability(x)
        return Detected(snapshots, p, filtered, starts, state)


def followed(p: Floats, time: Floats, classes: tuple[str, ...]) -> tuple[Floats, Starts]:
    """Beliefs of the filter over time ``[snapshot, class]``, and when each state but the first is detected."""
    phases, starts, out = PhaseFilter(classes), {}, []
    for row, t in zip(p, time.tolist(), strict=True):
        if phases.update(row, t):
            starts[phases.current] = t
        out.append(phases.filtered)
    return np.array(out), starts


def with_beginnings(snapshots: Snapshots, starts: dict[int, Starts], dt: float) -> Snapshots:
    """The same moments with sub-tasks that begin at their detection."""
    begin = np.zeros_like(snapshots.begin)
    for recording, detected in starts.items():
        mine = snapshots.recording == recording
        for time in sorted(detected.values()):
            sample = round(time / dt)
            begin[mine & (snapshots.now > sample)] = sample
    return replace(snapshots, begin=begin)
