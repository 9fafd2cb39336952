"""Tasks: which intervals of a data set are classified, into which classes, and what was left out.

A task is the name of a track of annotations, whose labelled intervals are classified, or of a column, by which whole
recordings are classified.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.arms import chosen_arms
from rcbht_jax._util.printable import left_out, plural
from rcbht_jax._util.values import expect
from rcbht_jax.encoding.choices import make_plain
from rcbht_jax.errors import InputError
from rcbht_jax.features import (
    Features,
    FeatureSpec,
    Intervals,
    concatenate_arms,
    concatenate_features,
    interval_features,
)
from rcbht_jax.learning.task_choice import column_names
from rcbht_jax.learning.task_items import leave_out, leave_out_sources, track_items, trial_names, trials_in, whole_items
from rcbht_jax.types import LabelTracks, Recordings

SUCCESS, FAILURE, UNKNOWN, UNFINISHED = "success", "failure", "unknown", "unfinished"  # the last two: not judged
USUAL, PLAIN = "harmonised", "recorded"  # boundaries: corrected ones where there are some; those of the track itself


@dataclass(frozen=True)
class TaskSpec:
    """A task and the recordings that it covers; an empty filter selects everything.

    Attributes:
        task: track of annotations, or column.
        boundaries: variant of the track: "harmonised" = TASK-harmonised if there is one, else TASK; "recorded" = TASK.
        arms: one arm, or "both" side by side; "" = the last by name, as the right one.
        sources: data sets.
        sessions: recording sessions.
        outcomes: None = for a track, the successes if there are any (the others are counted as left out); for a
            column, all.
        classes: in this order; empty = all, those of a column sorted.
        complete: only recordings that have every label of the track, in order.
        seconds: use only the first seconds of whole recordings, leave out shorter ones; 0 = to the end.

    Raises:
        InputError: a value is of another type.

    Example:
        >>> TaskSpec("states", sessions=("A", "B")).sessions
        ('A', 'B')
    """

    task: str = "states"
    boundaries: str = USUAL
    arms: str = ""
    sources: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    outcomes: tuple[str, ...] | None = None
    classes: tuple[str, ...] = ()
    complete: bool = False
    seconds: float = 0.0

    def __post_init__(self) -> None:
        make_plain(self)


@dataclass(frozen=True)
class TrackBatches:
    """Label tracks by name that are read in batches, each time anew, because together they may not fit in memory."""

    names: tuple[str, ...]
    read: Callable[[], Iterable[Mapping[str, LabelTracks]]]  # of consecutive recordings, from the first to the last


@dataclass(frozen=True)
class LabelledIntervals:
    """The items of a task, in the order of the recordings and, within one, of the states."""

    classes: tuple[str, ...]  # [class] those that occur
    y: NDArray[np.int64]  # [item] index into classes
    trial: NDArray[np.str_]  # [item] the group that no split may divide; with its source where others share the name
    session: NDArray[np.str_]  # [item]
    intervals: tuple[Intervals, ...]  # one per arm (right before left), each of all items
    dropped: dict[str, int]  # reason -> trials left out; intervals where it begins with "intervals, "
    recordings: int = 0  # of the data set that the items are from; 0 = not known

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Length of every sentence ``[item, arm]``, s: all that the duration-only baseline sees."""
        return np.stack([(i.end - i.start) * i.dt for i in self.intervals], 1).astype(np.float64)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> LabelledIntervals:
        """Some of the items, by number or by a mask, with the classes that occur in them."""
        known, y = np.unique(self.y[rows], return_inverse=True)
        parts = tuple(part.take(rows) for part in self.intervals)
        classes = tuple(self.classes[code] for code in known.tolist())
        return LabelledIntervals(classes, y, self.trial[rows], self.session[rows], parts, self.dropped, self.recordings)


@dataclass(frozen=True)
class UnlabelledIntervals:
    """Sentences whose class may be unknown, in the order of the recordings and, within one, of the states."""

    row: NDArray[np.int64]  # [item] recording, of the first arm
    name: NDArray[np.str_]  # [item] class as the data set has it; "" = not known
    intervals: tuple[Intervals, ...]  # one per arm (right before left), each of all items
    dropped: dict[str, int]  # reason -> trials left out; intervals where it begins with "intervals, "
    recordings: int = 0  # of the data set that the items are from; 0 = not known


def unlabelled_intervals(recordings: Recordings, spec: TaskSpec, whole: bool = False) -> UnlabelledIntervals:
    """The intervals that a trained model can classify: as :func:`labelled_intervals`, but without known classes.

    Trials of unknown outcome, and unfinished ones, are included if ``spec.outcomes`` is None or names "unknown"; other
    outcomes that it then names may be absent from the data set. A whole trial of unknown class is included.

    Args:
        recordings: the data set.
        spec: the task.
        whole: the task is known to be about whole recordings, whose column need not be there.

    Raises:
        InputError: a filter names an unknown source or session, or the track or column is not there.
    """
    _check(recordings, spec)
    dropped: Counter[str] = Counter()
    unknown = spec.outcomes is None or UNKNOWN in spec.outcomes
    if whole and not (_track(recordings, spec) or _column(recordings, spec)):
        everything = replace(spec, task="outcome", outcomes=spec.outcomes or ())
        rows = _rows(recordings, everything, dropped, unknown)
        found = whole_items(recordings, rows, np.full(len(rows), ""), spec.seconds, dropped)
    else:
        rows = _rows(recordings, spec, dropped, unknown)
        track = track_of(recordings, spec)
        if track:
            found = track_items(recordings, rows, track, spec.classes, spec.complete, dropped)
        else:
            values, known, _ = _known(recordings, rows, spec)
            found = whole_items(recordings, rows, np.where(known, values, ""), spec.seconds, dropped)
    row, parts = found.rows[:, 0], found.intervals(recordings)
    return UnlabelledIntervals(row, found.label, parts, dict(dropped), len(recordings))


def labelled_intervals(recordings: Recordings, spec: TaskSpec) -> LabelledIntervals:
    """The intervals of a task with their classes: sub-tasks, or whole trials.

    Raises:
        InputError: a filter names an unknown source or session, fewer than two classes remain, or ``seconds`` is set
            for a track.

    Example:
        >>> recordings = Recordings.from_arrays(np.zeros((3, 400, 6)), outcome=["success", "failure", "unknown"])
        >>> items = labelled_intervals(recordings, TaskSpec("outcome"))
        >>> items.classes, items.y.tolist(), items.dropped
        (('failure', 'success'), [1, 0], {'class unknown': 1})
    """
    _check(recordings, spec)
    dropped: Counter[str] = Counter()
    rows = _rows(recordings, spec, dropped)
    track = track_of(recordings, spec)
    if track:
        found = track_items(recordings, rows, track, spec.classes, spec.complete, dropped)
        order = recordings.annotations.labels[track]
    else:
        values, known, doubtful = _known(recordings, rows, spec)
        leave_out(dropped, "same record under two names", int(doubtful.sum()))
        why = "class not in the list" if spec.classes else "class unknown"
        leave_out(dropped, why, int((~known & ~doubtful).sum()))
        found = whole_items(recordings, rows[known], values[known], spec.seconds, dropped)
        order = tuple(sorted(set(found.label.tolist())))
    classes = tuple(name for name in spec.classes or order if (found.label == name).any())
    if len(classes) < 2:
        count = len(np.unique(found.rows[np.isin(found.label, classes), 0])) if classes else len(rows)
        trials = plural(count, "chosen trial" if spec.sources or spec.sessions or spec.outcomes else "trial")
        found_here = f"the class {classes[0]} alone" if classes else "no known class"
        raise InputError(
            f"the task {spec.task} needs two classes; there is {found_here} in {trials}.{left_out(dropped)}"
        )
    y, first = np.array([classes.index(name) for name in found.label.tolist()], np.int64), found.rows[:, 0]
    leave_out_sources(recordings, chosen_recordings(recordings, spec, True), first, dropped)
    trial, session = trial_names(recordings, first), recordings.session[first]
    return LabelledIntervals(classes, y, trial, session, found.intervals(recordings), dict(dropped), len(recordings))


def _check(recordings: Recordings, spec: TaskSpec) -> None:
    expect("The data set", recordings, Recordings)
    expect("The task", spec, TaskSpec)


def track_of(recordings: Recordings, spec: TaskSpec) -> str:
    """The track of annotations of a task; "" = it is about whole recordings and their column.

    Raises:
        InputError: there is neither a track nor a column of text of that name, the track has no such variant, or it is
            a track of which seconds are asked for.
    """
    tracks, variant = recordings.annotations.tracks, f"{spec.task}-{spec.boundaries}"
    if spec.task in tracks and variant not in tracks and spec.boundaries not in (USUAL, PLAIN):
        prefix = f"{spec.task}-"
        variants = [PLAIN, *(track.removeprefix(prefix) for track in tracks if track.startswith(prefix))]
        raise InputError(f"There are no boundaries {spec.boundaries!r} of {spec.task}; expected {', '.join(variants)}.")
    if track := _track(recordings, spec):
        if spec.seconds:
            raise InputError(
                f"the task {spec.task} is a track; only whole recordings can be cut to their first seconds."
            )
        return track
    if not _column(recordings, spec):
        known = ", ".join((*tracks, *column_names(recordings)))
        raise InputError(f"There is no track or column of text {spec.task!r}; choose one of {known} (--task).")
    return ""


def extract_features(
    tracks: LabelTracks | Mapping[str, LabelTracks] | TrackBatches,
    items: LabelledIntervals | UnlabelledIntervals,
    spec: FeatureSpec,
    count: int | None = None,
) -> Features:
    """Features of every item, both arms side by side where the task has two.

    Args:
        tracks: labels, or those of several encoders by name, whose features are put side by side; or batches of these.
        items: from :func:`labelled_intervals` or :func:`unlabelled_intervals`.
        spec: which features.
        count: number of recordings that the labels must have; None = as many as the data set of the items.

    Raises:
        InputError: no labels, an argument of another type, or labels of more or fewer recordings, or of another rate.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = Recordings.from_arrays(np.zeros((2, 400, 6)), outcome=["success", "failure"])
        >>> items = labelled_intervals(recordings, TaskSpec("outcome"))
        >>> features = extract_features(rj.encode(recordings.wrench), items, FeatureSpec(("histogram",), ("llb",)))
        >>> features.values.shape, features.names[0]
        ((2, 96), 'histogram.llb.Fx.time.FX')
    """
    expect("The choice of features", spec, FeatureSpec)
    expect("The choice of intervals", items, LabelledIntervals, UnlabelledIntervals)
    if isinstance(tracks, TrackBatches):
        return _features_of(tracks.read(), items, spec, count)
    named = tracks if isinstance(tracks, Mapping) else {"": tracks}
    if not named:
        raise InputError("There are no labels; expected those of one encoder or more.")
    for one in named.values():
        expect("Each set of labels", one, LabelTracks)
    return _features_of([named], items, spec, count)


def _features_of(
    batches: Iterable[Mapping[str, LabelTracks]],
    items: LabelledIntervals | UnlabelledIntervals,
    spec: FeatureSpec,
    count: int | None,
) -> Features:
    """As :func:`extract_features`, of label tracks that come in batches: the features alone are kept."""
    found: dict[tuple[str, int], tuple[list[NDArray[np.int64]], list[Features]]] = {}
    first = 0
    for batch in batches:
        size = len(next(iter(batch.values())).llb.label)
        for arm, intervals in enumerate(items.intervals):
            mine = np.flatnonzero((intervals.recording >= first) & (intervals.recording < first + size))
            part = intervals.take(mine)
            part = replace(part, recording=part.recording - first)
            for name, tracks in batch.items():
                places, features = found.setdefault((name, arm), ([], []))
                if len(mine) or not features:
                    places.append(mine)
                    features.append(interval_features(tracks, part, spec))
        first += size
    last = max((int(intervals.recording.max(initial=-1)) for intervals in items.intervals), default=-1)
    known = max(count or items.recordings or first, last + 1)
    if first != known:
        raise InputError(f"The labels are of {first} recordings, the intervals of {known}; take the same.")
    names, by_name = [one.arm for one in items.intervals], dict[str, list[Features]]()
    for (name, _), (places, features) in found.items():
        order = np.argsort(np.concatenate(places), kind="stable")
        values = np.concatenate([part.values for part in features])[order]
        by_name.setdefault(name, []).append(replace(features[0], values=values))
    return concatenate_features(
        {name: concatenate_arms(dict(zip(names, arms, strict=True))) for name, arms in by_name.items()}
    )


def _outcomes(recordings: Recordings, spec: TaskSpec) -> tuple[str, ...]:
    """The outcomes that pass, with the task's own default."""
    if spec.outcomes is not None:
        return spec.outcomes
    if track_of(recordings, spec):
        return (SUCCESS,) if (recordings.outcome == SUCCESS).any() else ()
    values = recordings.column(_column(recordings, spec))
    return () if spec.task == "outcome" else tuple(sorted(set(recordings.outcome[values != ""].tolist())))


def _track(recordings: Recordings, spec: TaskSpec) -> str:
    """The track of a task, in the chosen variant if there is one; "" = there is none."""
    names = (f"{spec.task}-{spec.boundaries}", spec.task)
    return next((name for name in names if name in recordings.annotations.tracks), "")


def _column(recordings: Recordings, spec: TaskSpec) -> str:
    """The column of a task, which may be spelt with hyphens; "" = there is none."""
    known = column_names(recordings)
    return next((name for name in (spec.task, spec.task.replace("-", "_")) if name in known), "")


def chosen_recordings(recordings: Recordings, spec: TaskSpec, unknown: bool = False) -> NDArray[np.bool_]:
    """The recordings ``[recording]`` of the sources, sessions and outcomes of a task.

    Args:
        recordings: the data set.
        spec: names them.
        unknown: recordings that were not judged are chosen as well, and outcomes of the task may be absent.

    Raises:
        InputError: a filter names a source, session or outcome that does not occur in the data set.
    """
    filters: list[tuple[str, NDArray[np.str_], Sequence[str]]] = [
        ("source", recordings.source, spec.sources),
        ("session", recordings.session, spec.sessions),
        ("outcome", recordings.outcome, _outcomes(recordings, spec)),
    ]
    chosen = np.ones(len(recordings), bool)
    for what, values, wanted in filters:
        lenient = unknown and what == "outcome"
        passing = np.isin(values, (UNKNOWN, UNFINISHED)) if lenient else np.zeros(len(values), bool)
        missing = set(wanted) - set(values.tolist())
        if missing and not lenient:
            known = ", ".join(sorted(set(values.tolist())))
            raise InputError(f"no recording has the {what} {', '.join(sorted(missing))}; there are {known}.")
        if wanted:
            chosen &= np.isin(values, wanted) | passing
    return chosen


def _rows(recordings: Recordings, spec: TaskSpec, dropped: Counter[str], unknown: bool = False) -> NDArray[np.int64]:
    """Rows of the chosen recordings ``[trial, arm]``; trials of another outcome, or that lack an arm, are dropped.

    Raises:
        InputError: two recordings have the same source, trial and arm, or there is no such arm.
    """
    chosen = chosen_recordings(recordings, spec, unknown)
    outcomes = dict.fromkeys([*_outcomes(recordings, spec), *[UNKNOWN] * unknown])
    if track_of(recordings, spec) or spec.outcomes:  # of a column the others have no class
        others = chosen_recordings(recordings, replace(spec, outcomes=())) & ~chosen
        unstated = recordings.outcome == UNKNOWN
        leave_out(dropped, f"outcome not {' or '.join(outcomes)}", trials_in(recordings, others & ~unstated))
        leave_out(dropped, "outcome unknown", trials_in(recordings, others & unstated))
    wanted = chosen_arms(recordings.arm[chosen].tolist(), spec.arms)
    by_trial: dict[tuple[str, str], dict[str, int]] = {}
    for row in np.flatnonzero(chosen).tolist():
        key, arm = (str(recordings.source[row]), str(recordings.trial[row])), str(recordings.arm[row])
        if by_trial.setdefault(key, {}).setdefault(arm, row) != row:
            raise InputError(f"Two recordings of {key[0]!r} are named {key[1]!r}, arm {arm}; a name must be unique.")
    complete = [[arm[a] for a in wanted] for arm in by_trial.values() if set(wanted) <= set(arm)]
    leave_out(dropped, f"no arm {' and '.join(wanted)}", len(by_trial) - len(complete))
    return np.array(complete, np.int64).reshape(-1, max(len(wanted), 1))


def _known(
    recordings: Recordings, rows: NDArray[np.int64], spec: TaskSpec
) -> tuple[NDArray[np.str_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Class of each whole trial, whether it is one of the task's, and whether the same record has two names."""
    first, column = rows[:, 0], _column(recordings, spec)
    values = recordings.column(column)[first]
    unjudged = (UNKNOWN, UNFINISHED) if column == "outcome" else (UNKNOWN,)
    known = np.isin(values, spec.classes) if spec.classes else ~np.isin(values, ("", *unjudged))
    copies = np.char.find(recordings.note[first], "contradictory-duplicate") >= 0
    doubtful = copies & (column != "outcome")
    return values, known & ~doubtful, doubtful
