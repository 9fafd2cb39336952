"""Training of introspection models on snapshots: the features of a stream at moments of each interval."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from rcbht_jax._util.arms import learned_arm
from rcbht_jax._util.digest import data_hash, wrench_digests
from rcbht_jax._util.printable import INTERVALS, left_out
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
from rcbht_jax.encoding.thresholds import limits_of, preset
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import weights
from rcbht_jax.features.recipes import SUBTASK, SUBTASK_RELATIVE, TRIAL, TRIAL_RELATIVE
from rcbht_jax.introspection.alarms import conformal_threshold, held_out, peaks
from rcbht_jax.introspection.chain import FeatureView, online_features_batch
from rcbht_jax.introspection.introspector import PHASE, PHASE_IN_TRIAL
from rcbht_jax.introspection.model import Head, IntrospectionModel, Scope
from rcbht_jax.labels import AXES
from rcbht_jax.learning.class_groups import LARGEST, TooFewTrials, groups_of_classes, learnable, some_items
from rcbht_jax.learning.probability import ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.progress import ProgressCalibration
from rcbht_jax.learning.svm import Grid, select
from rcbht_jax.learning.task_items import leave_out
from rcbht_jax.learning.tasks import FAILURE, LabelledIntervals, TaskSpec, labelled_intervals, track_of
from rcbht_jax.types import Recordings

# A sub-task: ranks, because attributes have long tails; the radial kernel alone, because what a force means depends on
# the time that has passed.
GRID = Grid(kernels=("rbf",), costs=(0.3, 1.0, 3.0), scalings=(True,), balanced=True, inner=3, floor=0.1, ranks=True)
ENDS = 6  # snapshots that a complete interval counts for: the belief at its end matters most and there is one only
TRIAL_GRID = Grid(
    kernels=("linear", "rbf"), costs=(1e-2, 1.0, 10.0), scalings=(True,), balanced=True, inner=3, floor=0.1
)
OUTCOME = "outcome"  # the task whose classifier raises alarms
# Features, class and trial of every training snapshot.
Training = tuple[Float[np.ndarray, "row feature"], Int[np.ndarray, " row"], Shaped[np.ndarray, " row"]]
PICKED = 12  # snapshots per interval and per spacing (even, geometric) for training
MOST = 24_000  # snapshots that train a classifier; the time of a fit grows with their square


@dataclass(frozen=True)
class Snapshots:
    """Moments at which labelled intervals are described from what a stream has received."""

    interval: Int[np.ndarray, " snapshot"]  # row of the labelled intervals
    recording: Int[np.ndarray, " snapshot"]
    begin: Int[np.ndarray, " snapshot"]  # first sample of the interval that is described
    now: Int[np.ndarray, " snapshot"]  # samples received
    complete: Bool[np.ndarray, " snapshot"]  # the labelled interval ends here

    def __len__(self) -> int:
        return len(self.now)

    def take(self, rows: Shaped[np.ndarray, " row"]) -> Snapshots:
        """The chosen rows, by index or mask."""
        return Snapshots(*(getattr(self, field.name)[rows] for field in fields(self)))


def regular_snapshots(items: LabelledIntervals, every: int) -> Snapshots:
    """Snapshots every ``every`` samples since the interval began, and one at its end."""
    return _snapshots(items, lambda size: np.append(np.arange(every, size, every), size))


def training_snapshots(items: LabelledIntervals, every: int, count: int = PICKED, early: bool = True) -> Snapshots:
    """At most ``2 * count`` of the regular snapshots per interval, so that long intervals do not outweigh short ones.

    Half of them are evenly spaced; ``early`` puts the others at the beginning of the interval, where a sub-task is
    hardest to recognise. Without it all are even: before contact nothing depends on the outcome of the trial.
    """

    def choose(size: int) -> Int[np.ndarray, " step"]:
        steps = np.append(np.arange(every, size, every), size)
        even = np.linspace(1, len(steps), count if early else 2 * count)
        first = np.geomspace(1, len(steps), count if early else 1)
        return steps[np.unique(np.rint(np.concatenate([even, first])).astype(np.int64)) - 1]

    return _snapshots(items, choose)


def _snapshots(items: LabelledIntervals, choose: Callable[[int], Int[np.ndarray, " step"]]) -> Snapshots:
    spans = items.intervals[0]
    steps = [choose(int(size)) for size in spans.end - spans.start]
    interval = np.repeat(np.arange(len(steps)), [len(s) for s in steps])
    begin, end = spans.start[interval].astype(np.int64), spans.end[interval]
    now = begin + np.concatenate(steps)
    return Snapshots(interval, spans.recording[interval].astype(np.int64), begin, now, now == end)


def snapshot_features(
    recordings: Recordings,
    snapshots: Snapshots,
    view: FeatureView,
    config: AnyConfig,
    thresholds: AnyLimits,
    progress: Callable[[int], object] | None = None,
) -> Float[np.ndarray, "snapshot feature"]:
    """Features as a stream would have had them; see :func:`rcbht_jax.introspection.chain.online_features_batch`."""
    return online_features_batch(
        config, thresholds, view, recordings.wrench, snapshots.recording, snapshots.begin, snapshots.now, progress
    )


def since_trial_start(snapshots: Snapshots) -> Snapshots:
    """The same moments, described from the first sample of the recording on; sorted by recording and time."""
    order = np.lexsort((snapshots.now, snapshots.recording))
    return replace(snapshots, begin=np.zeros_like(snapshots.begin)).take(order)


@dataclass(frozen=True)
class HeadSpec:
    """What a classifier learns, and from which features.

    >>> HeadSpec(TaskSpec("outcome")).view.spec.families
    ('histogram', 'attributes', 'offset', 'course', 'edges')
    """

    task: TaskSpec
    families: tuple[str, ...] = ()  # of features; none = the recipe for the scope
    relative: bool = False  # the recipe without time and absolute level
    rate: float = 10.0  # snapshots per second
    phase: bool = False  # states from the features of the whole trial, to find out when a sub-task begins
    # per nominal trial as long as those of the task, for the classifier that alarms; 0 = the introspector's own level
    false_alarms: float = 0.0
    hold: float = 0.1  # s, for which that alarm must last
    weighing: tuple[str, ...] = ()  # of labels in the family histogram, see FeatureSpec
    ranks: bool = False  # of a whole trial: features as ranks, as those of a sub-task are; for long tails
    subtask: bool | None = None  # whether the task is about a track; None = found in training

    @property
    def scope(self) -> Scope:
        """The sub-task for a track unless its start is to be detected, the trial for everything else."""
        track = self.task.task == TaskSpec().task if self.subtask is None else self.subtask
        return "subtask" if track and not self.phase else "trial"

    @property
    def view(self) -> FeatureView:
        """Features; in a sub-task those of level, of movement and of time weigh the same."""
        subtask = self.scope == "subtask"
        every, relative = (SUBTASK, SUBTASK_RELATIVE) if subtask else (TRIAL, TRIAL_RELATIVE)
        families = self.families or (relative if self.relative else every)
        return FeatureView(FeatureSpec(families=families, weighing=self.weighing, balance=subtask))

    @property
    def learning(self) -> tuple[Grid, int]:
        """The grid of hyper-parameters, and the snapshots that a complete interval counts for."""
        return (GRID, ENDS) if self.scope == "subtask" else (replace(TRIAL_GRID, ranks=self.ranks), 1)

    @property
    def name(self) -> str:
        """Name of the classifier."""
        if not self.phase:
            return self.task.task
        return PHASE_IN_TRIAL if self.task.task == PHASE else PHASE


def learn(
    x: Float[np.ndarray, "snapshot feature"],
    snapshots: Snapshots,
    items: LabelledIntervals,
    spec: FeatureSpec,
    grid: Grid,
    ends: int,
    seed: int,
    axes: int = len(AXES),
    most: int | None = None,
) -> ProbabilisticSvm:
    """Train a classifier; kernel and cost are chosen by cross-validation grouped by trial.

    Args:
        x: features of ``spec``.
        snapshots: one per row of ``x``.
        items: the task.
        spec: of the features, and of their weights.
        grid: of hyper-parameters.
        ends: times that the last snapshot of a complete interval counts.
        seed: of the folds.
        axes: number of them.
        most: snapshots for the choice, of whole trials (:func:`rcbht_jax.learning.class_groups.some_items`); None =
            all.

    Raises:
        InputError: a class has fewer trials than the cross-validation has folds, or a feature is not finite.
    """
    rows = np.repeat(np.arange(len(snapshots)), np.where(snapshots.complete, ends, 1))
    interval = snapshots.interval[rows]
    y, groups, weight = items.y[interval], items.trial[interval], weights(spec, axes)
    some = some_items(y, groups, groups, seed, most or len(y))
    chosen = select({"": x[rows[some]]}, y[some], groups[some], grid, seed, {"": weight})
    return fit_probabilistic(x[rows], y, groups, items.classes, chosen, seed, weight=weight)


def train_head(
    recordings: Recordings,
    spec: HeadSpec,
    config: AnyConfig,
    thresholds: AnyLimits,
    seed: int = 0,
    progress: Callable[[int, int], object] | None = None,
    items: LabelledIntervals | None = None,
) -> Head:
    """Train one classifier on the training snapshots of its task.

    Its probabilities for a whole trial are calibrated by progress (:mod:`rcbht_jax.learning.progress`), on beliefs
    about held-out trials. Trials with more than 24,000 snapshots in all are learnt in part (:func:`training_items`),
    and hyper-parameters are chosen on about 5,000 of the snapshots.

    ``progress`` is called with the number of snapshots since the last call and the total. ``items`` are those of
    :func:`training_items`, where they are known.

    Raises:
        InputError: as from :func:`training_items`, an encoder of another sampling period, intervals of a track that
            overlap, too few nominal trials for ``false_alarms``, or no failure among the outcomes for it.
    """
    if not np.isclose(config.dt, recordings.dt):
        raise InputError(f"The encoder has a sampling period of {config.dt} s, the recordings of {recordings.dt} s.")
    items = training_items(recordings, spec, config, seed) if items is None else items
    track = track_of(recordings, spec.task)
    _check_apart(items, recordings, track)
    alarm = FAILURE if spec.task.task == OUTCOME and FAILURE in items.classes else ""
    if spec.false_alarms and spec.task.task == OUTCOME and not alarm:
        raise InputError(f"No outcome is {FAILURE}, so no alarm is learned; leave out the rate of false alarms.")
    spec = replace(spec, subtask=bool(track))
    snapshots = training_snapshots(items, _every(spec, config), early=bool(track))
    snapshots = since_trial_start(snapshots) if spec.phase else snapshots
    view, total = spec.view, len(snapshots)
    x = snapshot_features(
        recordings, snapshots, view, config, thresholds, progress and (lambda done: progress(done, total))
    )
    machine = learn(x, snapshots, items, view.spec, *spec.learning, seed, recordings.wrench.shape[2], LARGEST)
    head = Head(spec.name, spec.scope, view, machine, alarm)
    head = replace(head, alarm_hold=spec.hold) if alarm else head
    training = x, items.y[snapshots.interval], items.trial[snapshots.interval]
    if spec.scope == "trial" and not spec.phase:  # the filter over phases takes beliefs as they are
        head = replace(head, progress=_progress(machine, items, snapshots, training, config.dt, seed))
    if alarm and spec.false_alarms:
        level = _alarm_level(recordings, spec, config, thresholds, items, head, training, seed)
        head = replace(head, alarm_level=level)
    return head


def training_items(recordings: Recordings, spec: HeadSpec, config: AnyConfig, seed: int = 0) -> LabelledIntervals:
    """The intervals that train a classifier, of classes with two trials or more.

    Of more than 24,000 snapshots, repeated ones included, it takes some trials in a seeded order, or some intervals of
    few trials (:func:`rcbht_jax.learning.class_groups.some_items`), and counts the others as left out.

    Raises:
        InputError: as from :func:`rcbht_jax.learning.tasks.labelled_intervals`, or fewer than two classes are in two
            trials or more.
    """
    items, _ = learnable(labelled_intervals(recordings, spec.task))
    several = int((groups_of_classes(items.y, items.trial, range(len(items.classes))) > 1).sum())
    if several < 2:
        raise TooFewTrials(
            f"The task {spec.task.task} needs two classes that have two trials or more each; {several or 'no'} class "
            f"has as many.{left_out(items.dropped)}"
        )
    spec = replace(spec, subtask=bool(track_of(recordings, spec.task)))
    snapshots = training_snapshots(items, _every(spec, config), early=bool(spec.subtask))
    size = np.bincount(snapshots.interval, np.where(snapshots.complete, spec.learning[1], 1)).astype(np.int64)
    rows = some_items(items.y, items.trial, items.trial, seed, MOST, size)
    kept, gone, dropped = items.take(rows), ~np.isin(items.trial, items.trial[rows]), Counter(items.dropped)
    reason = f"beyond {MOST:,} snapshots to learn from"
    leave_out(dropped, reason, len(np.unique(items.trial[gone])))
    leave_out(dropped, INTERVALS + reason, len(items.y) - len(rows) - int(gone.sum()))
    return replace(kept, dropped=dict(dropped))


def _check_apart(items: LabelledIntervals, recordings: Recordings, track: str) -> None:
    """Refuse intervals of which two go on at the same time: a stream has one sub-task at a time."""
    spans = items.intervals[0]
    order = np.lexsort((spans.end, spans.start, spans.recording))
    row, start, end = (part[order] for part in (spans.recording, spans.start, spans.end))
    if len(both := np.flatnonzero((row[1:] == row[:-1]) & (start[1:] < end[:-1]))):
        first = int(row[both[0]])
        raise InputError(
            f"Intervals of {track} overlap in recording {first} ({recordings.trial[first]}) at "
            f"{start[both[0] + 1] * recordings.dt:g} s; a stream has one at a time."
        )


def _check_same_beginnings(recordings: Recordings, specs: tuple[HeadSpec, ...]) -> None:
    """Refuse tracks that begin at different times in one recording: those of one track begin a stream's sub-tasks."""
    tracks = list(dict.fromkeys(filter(None, (track_of(recordings, spec.task) for spec in specs))))
    for name in tracks[1:]:
        for row, size in enumerate(recordings.length.tolist()):
            first, other = (
                set(recordings.annotations.begins(row, size, recordings.dt, track)) for track in (tracks[0], name)
            )
            if first and other and first - {0} != other - {0}:
                raise InputError(
                    f"Intervals of {tracks[0]} and {name} begin at different times; a stream has one sub-task at a "
                    "time. Train a model for each of these tracks."
                )


def _progress(
    machine: ProbabilisticSvm,
    items: LabelledIntervals,
    snapshots: Snapshots,
    training: Training,
    dt: float,
    seed: int,
) -> ProgressCalibration:
    """Calibration by progress, from beliefs of classifiers that were not trained on the trial."""
    x, y, groups = training
    p = held_out(machine, *training, x, groups, seed)
    planned = float(np.median(items.seconds[:, 0]))
    return ProgressCalibration.fit(p, y, (snapshots.now - snapshots.begin) * dt, groups, planned)


def _every(spec: HeadSpec, config: AnyConfig) -> int:
    """Samples between snapshots."""
    return max(1, round(1 / (spec.rate * config.dt)))


def _alarm_level(
    recordings: Recordings,
    spec: HeadSpec,
    config: AnyConfig,
    thresholds: AnyLimits,
    items: LabelledIntervals,
    head: Head,
    training: Training,
    seed: int,
) -> float:
    """Level of the alarm from the successes, each streamed through a classifier that was not trained on it."""
    alarm = items.classes.index(FAILURE)
    snapshots = regular_snapshots(items, _every(spec, config))
    snapshots = snapshots.take(np.flatnonzero(items.y[snapshots.interval] != alarm))
    x = snapshot_features(recordings, snapshots, spec.view, config, thresholds)
    groups = items.trial[snapshots.interval]
    probability = held_out(head.machine, *training, x, groups, seed)
    if head.progress is not None:
        probability = head.progress(probability, (snapshots.now - snapshots.begin) * config.dt)
    probability = probability[:, alarm]
    apart = _every(spec, config) * config.dt  # s; more than 1 / rate where the sensor is slower
    steps = int(np.ceil(spec.hold / apart - 1e-9)) + 1
    return conformal_threshold(peaks(probability, groups, steps), spec.false_alarms)


def train_model(
    recordings: Recordings,
    specs: tuple[HeadSpec, ...],
    config: AnyConfig | None = None,
    thresholds: AnyLimits | None = None,
    seed: int = 0,
    progress: Callable[[int, int], object] | None = None,
    items: Sequence[LabelledIntervals] = (),
) -> IntrospectionModel:
    """Train a model with one classifier per specification; see :func:`train_head`, whose ``items`` are those of each.

    ``config`` and ``thresholds`` default to those of the encoder; the sampling period is that of the recordings. The
    fit rule takes FitConfig with FitLimits, whose tolerance should come from the training recordings
    (:func:`rcbht_jax.encoding.rules.limits_for`).

    Raises:
        InputError: as from :func:`train_head`, two classifiers would have the same name, two tracks have intervals
            that begin at different times, or a rate of false alarms without the task outcome.
    """
    if any(spec.false_alarms for spec in specs) and all(spec.task.task != OUTCOME for spec in specs):
        raise InputError(f"The rate of false alarms is for the task {OUTCOME}; add that task, or leave the rate out.")
    config = config or EncoderConfig(dt=recordings.dt)
    limits = preset(axes=recordings.axes, units=recordings.units) if thresholds is None else thresholds
    names = _names(specs)
    _check_same_beginnings(recordings, specs)
    items = items or [training_items(recordings, spec, config, seed) for spec in specs]
    heads = tuple(
        replace(train_head(recordings, spec, config, limits, seed, progress, one), name=name)
        for spec, one, name in zip(specs, items, names, strict=True)
    )
    extra = {"tasks": [asdict(spec.task) for spec in specs], "seed": seed}
    extra |= {"axes": list(recordings.axes), "units": list(recordings.units)}
    kept = limits if isinstance(limits, FitLimits) else np.asarray(limits_of(limits), np.float64)
    rows = np.unique(np.concatenate([one.intervals[0].recording for one in items]))
    extra["arm"] = learned_arm(str(recordings.arm[rows[0]]), recordings.arm)
    seen = wrench_digests(recordings.wrench, recordings.length)[rows]
    return IntrospectionModel(config, kept, heads, data_hash(recordings), extra=extra, digests=seen)


def _names(specs: tuple[HeadSpec, ...]) -> list[str]:
    """Names of the classifiers; the detector gives way to a task called "phase".

    Raises:
        InputError: two are the same.
    """
    taken = any(spec.task.task == PHASE for spec in specs)
    names = [PHASE_IN_TRIAL if spec.phase and taken else spec.name for spec in specs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"Two classifiers would be named {twice[0]}; name each task once.")
    return names
