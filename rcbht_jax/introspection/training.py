"""From recordings to heads: what a stream would have seen, picked so that every part of a sub-task counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.digest import data_hash
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import weights
from rcbht_jax.features.recipes import SUBTASK, SUBTASK_RELATIVE, TRIAL, TRIAL_RELATIVE
from rcbht_jax.introspection.alarms import conformal_threshold, held_out, peaks
from rcbht_jax.introspection.chain import FeatureView, online_features_batch
from rcbht_jax.introspection.introspector import PHASE
from rcbht_jax.introspection.model import Head, IntrospectionModel, Scope
from rcbht_jax.learning.probability import ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.svm import Grid, select
from rcbht_jax.learning.tasks import OUTCOMES, LabelledIntervals, TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

# A sub-task: ranks, because attributes have long tails; the radial kernel alone, because what a force means depends on
# the time that has passed.
GRID = Grid(kernels=("rbf",), costs=(0.3, 1.0, 3.0), scalings=(True,), balanced=True, inner=3, floor=0.1, ranks=True)
ENDS = 6  # looks that a complete sentence counts for: what it says matters most and is seen least

TRIAL_GRID = Grid(
    kernels=("linear", "rbf"), costs=(1e-2, 1.0, 10.0), scalings=(True,), balanced=True, inner=3, floor=0.1
)
PICKED = 12  # looks per sentence and per spacing (even, geometric) for training


@dataclass(frozen=True)
class Snapshots:
    """Moments at which sentences are looked at."""

    sentence: NDArray[np.int64]  # [look] item of the task
    recording: NDArray[np.int64]  # [look]
    begin: NDArray[np.int64]  # [look] first sample of the sentence
    now: NDArray[np.int64]  # [look] samples received
    whole: NDArray[np.bool_]  # [look] the sentence is complete

    def __len__(self) -> int:
        return len(self.now)

    def take(self, rows: NDArray[Any]) -> Snapshots:
        """The chosen looks."""
        return Snapshots(*(getattr(self, name)[rows] for name in ("sentence", "recording", "begin", "now", "whole")))


def regular_snapshots(items: LabelledIntervals, every: int) -> Snapshots:
    """Looks every ``every`` samples since the sentence began, and one at its end."""
    return _looks(items, lambda size: np.append(np.arange(every, size, every), size))


def training_snapshots(items: LabelledIntervals, every: int, count: int = PICKED, early: bool = True) -> Snapshots:
    """At most ``2 * count`` of the streamed looks per sentence, so that long sentences do not outweigh short ones.

    Half of them are evenly spaced; ``early`` puts the others at the beginning of the sentence, when a sub-task is
    hardest to tell. Without it all are even: before contact a trial says nothing about its outcome.
    """

    def choose(size: int) -> NDArray[np.int64]:
        steps = np.append(np.arange(every, size, every), size)
        even = np.linspace(1, len(steps), count if early else 2 * count)
        first = np.geomspace(1, len(steps), count if early else 1)
        return steps[np.unique(np.rint(np.concatenate([even, first])).astype(np.int64)) - 1]

    return _looks(items, choose)


def _looks(items: LabelledIntervals, choose: Callable[[int], NDArray[np.int64]]) -> Snapshots:
    where = items.intervals[0]
    steps = [choose(int(size)) for size in where.end - where.start]
    sentence = np.repeat(np.arange(len(steps)), [len(s) for s in steps])
    begin, end = where.start[sentence].astype(np.int64), where.end[sentence]
    now = begin + np.concatenate(steps)
    return Snapshots(sentence, where.recording[sentence].astype(np.int64), begin, now, now == end)


def snapshot_features(
    recordings: Recordings,
    looks: Snapshots,
    sight: FeatureView,
    config: EncoderConfig,
    thresholds: GradientThresholds,
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float32]:
    """Features ``[look, feature]`` as a stream would have had them."""
    return online_features_batch(
        config, thresholds, sight, recordings.wrench, looks.recording, looks.begin, looks.now, progress=progress
    )


def from_the_beginning(looks: Snapshots) -> Snapshots:
    """The same moments, seen as parts of the whole trial: its sentence begins with the record."""
    order = np.lexsort((looks.now, looks.recording))
    return replace(looks, begin=np.zeros_like(looks.begin)).take(order)


@dataclass(frozen=True)
class HeadSpec:
    """What a head is to learn, and from which features."""

    task: TaskSpec
    families: tuple[str, ...] = ()  # none = those of the module for the head's scope
    relative: bool = False  # of these, only families that hold neither time nor absolute values
    rate: float = 10.0  # looks per second
    phase: bool = False  # tell the states from the trial's sentence, to find out when a sub-task begins
    false_alarms: float = 0.0  # per nominal trial, for the head that alarms; 0 = leave its level to the introspector
    hold: float = 0.1  # s, for which that alarm must last

    @property
    def scope(self) -> Scope:
        """States are told from the sub-task's sentence unless it is to be found, everything else from the trial's."""
        return "subtask" if self.task.task == "states" and not self.phase else "trial"

    @property
    def sight(self) -> FeatureView:
        """What it sees; where the force is, how it moves and for how long weigh the same in a sub-task."""
        subtask = self.scope == "subtask"
        every, relative = (SUBTASK, SUBTASK_RELATIVE) if subtask else (TRIAL, TRIAL_RELATIVE)
        families = self.families or (relative if self.relative else every)
        return FeatureView(FeatureSpec(families=families, balance=subtask))

    @property
    def learning(self) -> tuple[Grid, int]:
        """What kernel and cost are chosen from, and the looks that a complete sentence counts for."""
        return (GRID, ENDS) if self.scope == "subtask" else (TRIAL_GRID, 1)

    @property
    def name(self) -> str:
        """Of the head."""
        return PHASE if self.phase else self.task.task


def learn(
    x: NDArray[np.floating[Any]],
    looks: Snapshots,
    items: LabelledIntervals,
    spec: FeatureSpec,
    grid: Grid,
    ends: int,
    seed: int,
) -> ProbabilisticSvm:
    """A machine from looks at training sentences; kernel and cost are chosen by cross-validation grouped by trial.

    Args:
        x: features of ``spec``, ``[look, feature]``.
        looks: where they come from.
        items: the task.
        spec: of the features; says how they are weighed.
        grid: what to choose from.
        ends: looks that a complete sentence counts for.
        seed: of the folds.
    """
    rows = np.repeat(np.arange(len(looks)), np.where(looks.whole, ends, 1))
    sentence = looks.sentence[rows]
    y, groups, weight = items.y[sentence], items.trial[sentence], weights(spec)
    chosen = select({"": x[rows]}, y, groups, grid, seed, {"": weight})
    return fit_probabilistic(x[rows], y, groups, items.classes, chosen, seed, weight=weight)


def train_head(
    recordings: Recordings,
    spec: HeadSpec,
    config: EncoderConfig,
    thresholds: GradientThresholds,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Head:
    """Learn one head; kernel and cost are chosen by cross-validation grouped by trial.

    ``progress`` is called with the number of looks done since the last call and the total.

    Raises:
        InputError: fewer than two classes, a class with a single trial, or too few nominal trials for ``false_alarms``.
    """
    items = labelled_intervals(recordings, spec.task)
    looks = training_snapshots(items, max(1, round(1 / (spec.rate * config.dt))), early=spec.task.task == "states")
    looks = from_the_beginning(looks) if spec.phase else looks
    sight, total = spec.sight, len(looks)
    x = snapshot_features(
        recordings, looks, sight, config, thresholds, progress and (lambda done: progress(done, total))
    )
    machine = learn(x, looks, items, sight.spec, *spec.learning, seed)
    alarm = OUTCOMES[0] if spec.task.task == "outcome" else ""
    level = 0.0
    if alarm and spec.false_alarms:
        training = x, items.y[looks.sentence], items.trial[looks.sentence]
        level = _alarm_level(recordings, spec, config, thresholds, items, machine, training, seed)
    return Head(spec.name, spec.scope, sight, machine, alarm, level)


def _alarm_level(
    recordings: Recordings,
    spec: HeadSpec,
    config: EncoderConfig,
    thresholds: GradientThresholds,
    items: LabelledIntervals,
    machine: ProbabilisticSvm,
    training: tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.str_]],
    seed: int,
) -> float:
    """Level of the alarm from the successes, each streamed through a machine that did not see it."""
    alarm = items.classes.index(OUTCOMES[0])
    looks = regular_snapshots(items, max(1, round(1 / (spec.rate * config.dt))))
    looks = looks.take(np.flatnonzero(items.y[looks.sentence] != alarm))
    x = snapshot_features(recordings, looks, spec.sight, config, thresholds)
    groups = items.trial[looks.sentence]
    said = held_out(machine, *training, x, groups, seed)[:, alarm]
    return conformal_threshold(peaks(said, groups, round(spec.hold * spec.rate) + 1), spec.false_alarms)


def train_model(
    recordings: Recordings,
    specs: tuple[HeadSpec, ...],
    config: EncoderConfig | None = None,
    thresholds: GradientThresholds | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> IntrospectionModel:
    """Learn a model with one head per specification; see :func:`train_head`."""
    config, thresholds = config or EncoderConfig(dt=recordings.dt), thresholds or preset()
    heads = tuple(train_head(recordings, spec, config, thresholds, seed, progress) for spec in specs)
    extra = {"tasks": [asdict(spec.task) for spec in specs], "seed": seed}
    return IntrospectionModel(
        config, np.asarray(thresholds.limits, np.float64), heads, data_hash(recordings), extra=extra
    )
