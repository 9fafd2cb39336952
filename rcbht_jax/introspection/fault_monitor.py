"""Detection of faults in a stream: one classifier per sub-task and a time limit, both with few false alarms.

A linear SVM per sub-task separates nominal trials from each cause of failure, using features of the sub-task so far;
the probability that the trial is not nominal raises the alarm of the *words*. The *clock* raises the alarm when a
sub-task lasts too long. Alarm levels and time limits are conformal thresholds (Angelopoulos and Bates 2023, section 1)
of nominal trials, for a chosen probability of a false alarm in a new one.

The words keep that probability with ``calibration="split"``, where a random half of the nominal trials trains nothing
and sets the levels: on average over the trials drawn, if the new one and that half are exchangeable. By default, with
``"cross"``, each trial is scored by a classifier that was not trained on it, and the final classifier is trained on
all. Its values are spread wider, and the hold time is chosen afterwards, so false alarms exceed the probability where
nominal trials are few and features many. In simulations of exchangeable trials they were 0.02 for 0.01 with 100 nominal
trials and 100 features; and for 0.05, 0.11 with 19 trials and 300 features, 0.07 with 39 and 60, 0.06 with 39 and 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from rcbht_jax._util.values import expect
from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.alarms import (
    Alarm,
    check_calibration,
    conformal_threshold,
    held_half,
    held_out,
    sustained_peak,
)
from rcbht_jax.learning.class_groups import groups_of_classes
from rcbht_jax.learning.probability import ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec

NOMINAL = "none"  # the cause of a trial without a fault
COLUMNS = ("trial", "subtask", "begin", "now", "features")  # of snapshots
SLACK = 1e-5  # share by which snapshots may be further apart than the rate has them: it may be rounded to six digits


@dataclass(frozen=True)
class SubtaskSnapshots:
    """Features of streams at successive moments; rows of a trial are consecutive and in order of time.

    Raises:
        InputError: columns of different lengths, or rows that are not in that order.
    """

    trial: Int[np.ndarray, " snapshot"]  # number of the trial, from 0
    subtask: Int[np.ndarray, " snapshot"]  # number of the present sub-task, from 0
    begin: Int[np.ndarray, " snapshot"]  # first sample of the sub-task
    now: Int[np.ndarray, " snapshot"]  # samples received since the trial began, > begin
    features: Float[np.ndarray, "snapshot feature"]  # of the sub-task so far
    dt: float  # s between samples

    def __post_init__(self) -> None:
        lengths = {name: len(getattr(self, name)) for name in COLUMNS}
        if len(set(lengths.values())) > 1:
            raise InputError(f"The columns of the snapshots have different lengths: {lengths}.")
        later = np.diff(self.now) > 0
        if (
            not (self.now > self.begin).all()
            or not ((np.diff(self.trial) > 0) | (np.diff(self.trial) == 0) & later).all()
        ):
            raise InputError("snapshots must be sorted by trial and time, each after the beginning of its sub-task.")

    @property
    def time(self) -> Float[np.ndarray, " snapshot"]:
        """Seconds since the trial began."""
        return self.now * self.dt

    @property
    def elapsed(self) -> Float[np.ndarray, " snapshot"]:
        """Seconds since the sub-task began."""
        return (self.now - self.begin) * self.dt

    def of_trials(self, mask: Bool[np.ndarray, " trial"]) -> SubtaskSnapshots:
        """The snapshots of some trials, which keep their numbers."""
        rows = mask[self.trial]
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    def by_trial(self, subtask: int) -> dict[int, Int[np.ndarray, " row"]]:
        """Rows of a sub-task, by trial."""
        rows = np.flatnonzero(self.subtask == subtask)
        parts = np.split(rows, np.flatnonzero(np.diff(self.trial[rows])) + 1)
        return {int(self.trial[part[0]]): part for part in parts if len(part)}


def schedule_snapshots(
    begins: Int[np.ndarray, "trial subtask"], length: Int[np.ndarray, " trial"], every: int
) -> tuple[Int[np.ndarray, " snapshot"], ...]:
    """Times of the snapshots: every ``every`` samples since the sub-task began, and at the end of the sub-task.

    Args:
        begins: first sample of each sub-task, increasing; -1 where the trial did not reach it.
        length: samples in each trial.
        every: samples between snapshots.

    Returns:
        ``trial``, ``subtask``, ``begin`` and ``now`` of :class:`SubtaskSnapshots`.

    >>> schedule_snapshots(np.array([[0, 4], [0, -1]]), np.array([7, 4]), 3)[3]
    array([3, 4, 7, 3, 4])
    """
    parts = []
    for row, (starts, end) in enumerate(zip(begins, length.tolist(), strict=True)):
        reached = np.flatnonzero(starts >= 0)
        for subtask, begin, stop in zip(reached, starts[reached], [*starts[reached[1:]], end], strict=True):
            now = np.append(np.arange(begin + every, stop, every), stop)
            parts.append(np.stack([np.full_like(now, value) for value in (row, subtask, begin)] + [now]))
    return tuple(np.concatenate(parts, 1))


@dataclass(frozen=True)
class FaultMonitorConfig:
    """How a monitor learns.

    Raises:
        InputError: a value is of another type or out of range.
    """

    rate: float = 10.0  # snapshots per second, at least
    false_alarms: float = 0.01  # of the words, per nominal trial
    clock_false_alarms: float = 0.0025  # of the clock, per nominal trial and timed sub-task
    holds: tuple[float, ...] = (0.3, 0.5, 1.0, 2.0, 4.0)  # s for which an alarm must last; one of them is chosen
    cost: float = 0.1  # of the linear SVM
    snapshots: int = 8  # per sub-task and trial used in training, evenly spaced
    fewest: int = 3  # trials of a cause; rarer causes are not used in training
    calibration: str = "cross"  # or "split": nominal trials that train nothing set the alarm levels of the words

    def __post_init__(self) -> None:
        make_plain(self)
        check_calibration(self.calibration)
        if not self.rate > 0 or not self.holds or min(self.holds) < 0 or min(self.snapshots, self.fewest) < 1:
            raise InputError(
                f"rate is {self.rate}, holds are {self.holds}, snapshots {self.snapshots} and fewest {self.fewest}; "
                "expected a positive rate, one time or more of zero or more, and counts of one or more."
            )


@dataclass(frozen=True)
class FaultMonitor:
    """Classifiers, alarm levels and time limits, by sub-task.

    >>> rng = np.random.default_rng(0)
    >>> cause = np.array(["none"] * 120 + ["jamming"] * 20)
    >>> begins, length = np.zeros((140, 1), int), np.full(140, 20)
    >>> trial, subtask, begin, now = schedule_snapshots(begins, length, every=1)
    >>> features = rng.normal(size=(len(trial), 1)) + 6.0 * (cause[trial] == "jamming")[:, None]
    >>> snapshots = SubtaskSnapshots(trial, subtask, begin, now, features, dt=0.1)
    >>> monitor = FaultMonitor.fit(snapshots, cause)
    >>> first = monitor.alarms(snapshots, 140)["words"]  # s, inf = none
    >>> int(np.isfinite(first[120:]).sum()), int(np.isfinite(first[:120]).sum()) <= 3
    (20, True)
    """

    machines: dict[int, ProbabilisticSvm]
    levels: dict[int, float]  # probability of a fault above which the words raise the alarm
    hold: float  # s for which it must stay there
    limits: dict[int, float]  # s that a sub-task may last
    # share of the training failures that the words detect, held out; mean over the kinds; those of causes with fewer
    # trials than FaultMonitorConfig.fewest count as not detected, although the monitor may detect them
    detected: float
    rate: float = FaultMonitorConfig.rate  # snapshots per second, at least, for which the levels hold

    @staticmethod
    def fit(
        snapshots: SubtaskSnapshots,
        cause: Shaped[np.ndarray, " trial"],
        *,
        subtasks: Sequence[int] | None = None,
        durations: Mapping[int, Float[np.ndarray, " _trial"]] | None = None,
        kind: Shaped[np.ndarray, " _trial"] | None = None,
        visible: Float[np.ndarray, " _trial"] | None = None,
        deadline: Float[np.ndarray, " _trial"] | None = None,
        own: Bool[np.ndarray, " _trial"] | None = None,
        config: FaultMonitorConfig | None = None,
        seed: int = 0,
    ) -> FaultMonitor:
        """Learn from streamed trials; the hold time is the one that detects most failures in held-out trials.

        Args:
            snapshots: of the training trials; trials without a snapshot are left out. Folds are grouped by trial.
            cause: class of each trial, NOMINAL or why it failed.
            subtasks: those that get a classifier, if both nominal and faulty trials reach them; None = all.
            durations: duration of each timed sub-task, s, NaN where it did not end, which counts as longer than any;
                none = no clock.
            kind: classes over which the share of detected failures is averaged; None = ``cause``.
            visible: s since the trial began before which a fault cannot show; earlier snapshots do not train. None = 0.
            deadline: s; later alarms do not count as detection. NaN = the trial does not count. None = no deadline.
            own: trials of the monitored robot; its nominal trials set alarm levels and time limits. None = all.
            config: None = the defaults.
            seed: of the folds, and of the half that the calibration "split" takes.

        Raises:
            InputError: no sub-task has both nominal and faulty trials, there are too few nominal trials for the
                chosen probability of false alarms (each half of the calibration "split" needs enough), too many in
                which a timed sub-task did not end, snapshots of trials that have no cause or fewer per second than
                the config has, or an argument with values for another number of trials.
        """
        config = FaultMonitorConfig() if config is None else config
        expect("The config", config, FaultMonitorConfig)
        cause = np.asarray(cause)
        _check_snapshots(snapshots, len(cause), config.rate)
        lasting = {f"durations of sub-task {number}": lasted for number, lasted in (durations or {}).items()}
        _check_trials(len(cause), {"kind": kind, "visible": visible, "deadline": deadline, "own": own, **lasting})
        nominal, streamed = cause == NOMINAL, np.isin(np.arange(len(cause)), snapshots.trial)
        visible = np.zeros(len(cause)) if visible is None else visible
        deadline = np.full(len(cause), np.inf) if deadline is None else deadline
        calm = nominal if own is None else nominal & own
        limits = {
            subtask: _limit(subtask, lasted[streamed & calm], config.clock_false_alarms)
            for subtask, lasted in (durations or {}).items()
        }
        held = np.zeros(len(cause), bool)
        if config.calibration == "split":
            held[held_half(np.flatnonzero(calm & streamed), seed)] = True
        shown = (snapshots.time >= visible[snapshots.trial]) & ~held[snapshots.trial]
        machines, probability = {}, np.zeros(len(snapshots.trial))
        for subtask in np.unique(snapshots.subtask).tolist() if subtasks is None else subtasks:
            rows = _training_rows(snapshots, subtask, shown, cause, config)
            trained = snapshots.trial[rows]
            if calm[trained].any() and not nominal[trained].all():  # else no trial sets the level
                machines[subtask] = _classifier(snapshots, subtask, rows, cause, config.cost, seed, probability)
        if not machines:
            raise InputError(f"no sub-task shows {config.fewest} nominal trials and as many of a cause of failure.")
        scored = streamed & ~nominal & ~np.isnan(deadline)

        def held_for(hold: float, those: Bool[np.ndarray, " trial"], fault: Float[np.ndarray, " row"]) -> FaultMonitor:
            steps, share = math.ceil(hold * config.rate * (1 - SLACK)) + 1, config.false_alarms / len(machines)
            levels = {subtask: _level(snapshots, subtask, those, fault, steps, share) for subtask in machines}
            raised = _detected(snapshots, levels, np.where(scored, deadline, -np.inf), probability, steps)
            detected = _mean_share(raised[scored], (cause if kind is None else kind)[scored])
            return FaultMonitor(machines, levels, hold, limits, detected, config.rate)

        options = [held_for(hold, calm & ~held, probability) for hold in config.holds]
        best = max(options, key=lambda option: option.detected)  # the shortest of equals
        return held_for(best.hold, held, best.predict(snapshots)) if config.calibration == "split" else best

    def predict(self, snapshots: SubtaskSnapshots) -> Float[np.ndarray, " snapshot"]:
        """Probability of a fault; 0 in sub-tasks without a classifier."""
        probability = np.zeros(len(snapshots.trial))
        for subtask, machine in self.machines.items():
            rows = np.flatnonzero(snapshots.subtask == subtask)
            probability[rows] = _fault(machine, machine.probability(snapshots.features[rows]))
        return probability

    def alarms(self, snapshots: SubtaskSnapshots, trials: int) -> dict[str, Float[np.ndarray, " trial"]]:
        """Seconds from the beginning of each of ``trials`` trials to the first alarm; inf = none.

        Returns:
            ``"words"``: by the classifiers; ``"clock"``: by the time limits.

        Raises:
            InputError: there are snapshots of more trials, or fewer per second than those that set the levels.
        """
        _check_snapshots(snapshots, trials, self.rate)
        first = {name: np.full(trials, np.inf) for name in ("words", "clock")}
        probability, time = self.predict(snapshots), snapshots.time
        for subtask, level in self.levels.items():
            for trial, rows in snapshots.by_trial(subtask).items():
                alarm = Alarm(level, self.hold)
                pairs = zip(probability[rows].tolist(), time[rows].tolist(), strict=True)
                first["words"][trial] = min(
                    first["words"][trial], next((t for p, t in pairs if alarm.update(p, t)), np.inf)
                )
        limit = np.array([self.limits.get(subtask, np.inf) for subtask in snapshots.subtask.tolist()])
        late = snapshots.elapsed > limit + 1e-9  # durations and elapsed times are rounded differently
        np.minimum.at(first["clock"], snapshots.trial[late], time[late])
        return first


def _check_snapshots(snapshots: SubtaskSnapshots, trials: int, rate: float) -> None:
    expect("The stream", snapshots, SubtaskSnapshots)
    if (last := int(snapshots.trial.max(initial=-1))) >= trials:
        raise InputError(f"There are {trials} trials, and snapshots of a trial of number {last}; expected less.")
    within = (np.diff(snapshots.trial) == 0) & (np.diff(snapshots.subtask) == 0)
    apart = float(np.diff(snapshots.time)[within].max(initial=0.0))
    if apart * rate > 1 + SLACK:  # an alarm that lasts some seconds would need fewer of them, and be false more often
        raise InputError(
            f"Snapshots of a sub-task are up to {apart:g} s apart, and the monitor's config has {rate:g} per second; "
            f"take as many, or train with a config of rate={1 / apart:g}."
        )


def _check_trials(trials: int, columns: Mapping[str, Shaped[np.ndarray, " _trial"] | None]) -> None:
    for name, values in columns.items():
        if values is not None and len(values) != trials:
            raise InputError(f"There are {trials} trials, and {len(values)} values of {name}; expected as many.")


def _limit(subtask: int, lasted: Float[np.ndarray, " trial"], share: float) -> float:
    """Seconds that a sub-task may last, for a share of false alarms."""
    limit = conformal_threshold(np.where(np.isnan(lasted), np.inf, lasted), share)
    if np.isinf(limit):
        raise InputError(
            f"Sub-task {subtask} did not end in {int((~np.isfinite(lasted)).sum())} of {len(lasted)} nominal trials, "
            f"too many for a time limit with {share:g} false alarms per trial; leave these trials out, or accept more."
        )
    return limit


def _training_rows(
    snapshots: SubtaskSnapshots,
    subtask: int,
    shown: Bool[np.ndarray, " row"],
    cause: Shaped[np.ndarray, " trial"],
    config: FaultMonitorConfig,
) -> Int[np.ndarray, " chosen"]:
    """A few evenly spaced rows of a sub-task, among those ``shown``, of every trial whose cause is frequent enough."""
    parts = [part for rows in snapshots.by_trial(subtask).values() if len(part := rows[shown[rows]])]
    few = [part[np.unique(np.linspace(0, len(part) - 1, config.snapshots).round().astype(np.int64))] for part in parts]
    rows = np.concatenate([np.zeros(0, np.int64), *few])
    trial = snapshots.trial[rows]
    causes = np.unique(cause[trial])
    frequent = causes[groups_of_classes(cause[trial], trial, causes) >= config.fewest]
    return rows[np.isin(cause[trial], frequent)]


def _classifier(
    snapshots: SubtaskSnapshots,
    subtask: int,
    rows: Int[np.ndarray, " row"],
    cause: Shaped[np.ndarray, " trial"],
    cost: float,
    seed: int,
    probability: Float[np.ndarray, " snapshot"],
) -> ProbabilisticSvm:
    """The classifier of a sub-task; fills in the ``probability`` of its training trials, held out."""
    x, trial = snapshots.features[rows].astype(np.float64), snapshots.trial[rows]
    causes, y = np.unique(cause[trial], return_inverse=True)
    spec = SvmSpec("linear", cost, scaling=True, balanced=True, floor=0.1)
    machine = fit_probabilistic(x, y, trial, causes.tolist(), spec, seed)
    streamed = np.flatnonzero((snapshots.subtask == subtask) & np.isin(snapshots.trial, trial))
    classes = held_out(machine, x, y, trial, snapshots.features[streamed], snapshots.trial[streamed], seed)
    probability[streamed] = _fault(machine, classes)
    return machine


def _fault(machine: ProbabilisticSvm, probability: Float[np.ndarray, "row class"]) -> Float[np.ndarray, " row"]:
    """Probability of any cause of failure, from that of each class."""
    return 1.0 - probability[:, machine.svm.classes.index(NOMINAL)]


def _level(
    snapshots: SubtaskSnapshots,
    subtask: int,
    calm: Bool[np.ndarray, " trial"],
    probability: Float[np.ndarray, " snapshot"],
    steps: int,
    share: float,
) -> float:
    """Alarm level of a sub-task for a share of false alarms."""
    those = [rows for trial, rows in snapshots.by_trial(subtask).items() if calm[trial]]
    return conformal_threshold(np.array([sustained_peak(probability[rows], steps) for rows in those]), share)


def _detected(
    snapshots: SubtaskSnapshots,
    levels: Mapping[int, float],
    deadline: Float[np.ndarray, " trial"],
    probability: Float[np.ndarray, " snapshot"],
    steps: int,
) -> Bool[np.ndarray, " trial"]:
    """Trials in which the words raise the alarm before the deadline."""
    raised, time = np.zeros(len(deadline), bool), snapshots.time
    for subtask, level in levels.items():
        for trial, rows in snapshots.by_trial(subtask).items():
            raised[trial] |= sustained_peak(probability[rows[time[rows] <= deadline[trial]]], steps) > level
    return raised


def _mean_share(raised: Bool[np.ndarray, " failure"], kind: Shaped[np.ndarray, " failure"]) -> float:
    """Mean over the kinds of the share of failures that raise the alarm; 0 where there are none."""
    return float(np.mean([raised[kind == name].mean() for name in np.unique(kind)])) if len(kind) else 0.0
