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

from rcbht_jax.annotations import Annotations, nearest_samples
from rcbht_jax.errors import InputError
from rcbht_jax.features import (
    Features,
    FeatureSpec,
    Intervals,
    concatenate_arms,
    concatenate_features,
    interval_features,
)
from rcbht_jax.types import LabelTracks, Recordings

SUCCESS, FAILURE, UNKNOWN = "success", "failure", "unknown"  # outcomes; unknown: nobody judged the trial
BOTH = "both"  # arms, side by side
USUAL, PLAIN = "harmonised", "recorded"  # boundaries: corrected ones where there are some; those of the track itself


@dataclass(frozen=True)
class TaskSpec:
    """A task and the recordings it is about; empty filters let everything pass.

    >>> TaskSpec("states", sessions=("A", "B")).sessions
    ('A', 'B')
    """

    task: str = "states"  # track of annotations, or column
    boundaries: str = USUAL  # variant of the track: TASK-harmonised where there is one, else TASK; or PLAIN
    arms: str = "R"  # one arm, or "both" side by side; where there is only one, that one
    sources: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    outcomes: tuple[str, ...] | None = None  # None = successes of a track if there are some; of a column all
    classes: tuple[str, ...] = ()  # in this order; empty = all, those of a column sorted
    complete: bool = False  # only recordings that have every label of the track, each after the one before
    seconds: float = 0.0  # of every whole recording, from its beginning, shorter ones left out; 0 = to its end


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
    trial: NDArray[np.str_]  # [item] the group that no split may divide
    session: NDArray[np.str_]  # [item]
    intervals: tuple[Intervals, ...]  # one per arm (R before L), each of all items
    dropped: dict[str, int]  # reason -> trials left out

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Length of every sentence ``[item, arm]``, s: all that the duration-only baseline sees."""
        return np.stack([(i.end - i.start) * i.dt for i in self.intervals], 1).astype(np.float64)


@dataclass(frozen=True)
class UnlabelledIntervals:
    """Sentences whose class may be unknown, in the order of the recordings and, within one, of the states."""

    row: NDArray[np.int64]  # [item] recording, of the first arm
    name: NDArray[np.str_]  # [item] class as the data set has it; "" = not known
    intervals: tuple[Intervals, ...]  # one per arm (R before L), each of all items
    dropped: dict[str, int]  # reason -> trials left out


def unlabelled_intervals(recordings: Recordings, spec: TaskSpec) -> UnlabelledIntervals:
    """Find what a trained model can be asked about: as :func:`sentences`, but nobody need know the answers.

    Trials of unknown outcome pass the task's own choice of outcomes (not one that ``spec`` names), and a whole trial of
    unknown class stays in.

    Raises:
        InputError: a filter names an unknown source or session.
    """
    dropped: Counter[str] = Counter()
    rows = _rows(recordings, chosen_recordings(recordings, spec, unknown=spec.outcomes is None), spec.arms, dropped)
    track = track_of(recordings, spec)
    if track:
        found = _of_track(recordings, rows, track, spec, dropped)
    else:
        values, known, _ = _known(recordings, rows, spec)
        found = _whole(recordings, rows, np.where(known, values, ""), spec, dropped)
    return UnlabelledIntervals(found.rows[:, 0], found.label, _intervals(found, recordings.dt), dict(dropped))


def labelled_intervals(recordings: Recordings, spec: TaskSpec) -> LabelledIntervals:
    """The intervals of a task with their classes: sub-tasks, or whole trials.

    Raises:
        InputError: a filter names an unknown source or session, fewer than two classes remain, or seconds of a track.

    Example:
        >>> recordings = Recordings.from_arrays(np.zeros((3, 400, 6)), outcome=["success", "failure", "unknown"])
        >>> items = labelled_intervals(recordings, TaskSpec("outcome"))
        >>> items.classes, items.y.tolist(), items.dropped
        (('failure', 'success'), [1, 0], {'class unknown': 1})
    """
    dropped: Counter[str] = Counter()
    rows = _rows(recordings, chosen_recordings(recordings, spec), spec.arms, dropped)
    track = track_of(recordings, spec)
    if track:
        found = _of_track(recordings, rows, track, spec, dropped)
        order = recordings.annotations.labels[track]
    else:
        values, known, doubtful = _known(recordings, rows, spec)
        _count(dropped, "same record under two names", int(doubtful.sum()))
        _count(dropped, "class not in the list" if spec.classes else "class unknown", int((~known & ~doubtful).sum()))
        found = _whole(recordings, rows[known], values[known], spec, dropped)
        order = tuple(sorted(set(found.label.tolist())))
    present = set(found.label.tolist())
    classes = tuple(name for name in spec.classes or order if name in present)
    if len(classes) < 2:
        raise InputError(
            f"the task {spec.task} finds {_listed('class', classes)} in the {len(rows)} trials that pass the filters; "
            f"it needs two.{_reasons(dropped)}"
        )
    y = np.array([classes.index(name) for name in found.label.tolist()], np.int64)
    first = found.rows[:, 0]
    intervals = _intervals(found, recordings.dt)
    return LabelledIntervals(classes, y, recordings.trial[first], recordings.session[first], intervals, dict(dropped))


def track_of(recordings: Recordings, spec: TaskSpec) -> str:
    """The track of annotations of a task; "" = it is about whole recordings and their column.

    Raises:
        InputError: there is neither a track nor a column of that name, the track has no such variant, or it is a track
            of which seconds are asked for.
    """
    tracks, variant = recordings.annotations.tracks, f"{spec.task}-{spec.boundaries}"
    if spec.task in tracks and variant not in tracks and spec.boundaries not in (USUAL, PLAIN):
        prefix = f"{spec.task}-"
        variants = [PLAIN, *(track.removeprefix(prefix) for track in tracks if track.startswith(prefix))]
        raise InputError(f"There are no boundaries {spec.boundaries!r} of {spec.task}; expected {', '.join(variants)}.")
    for track in (variant, spec.task):
        if track in tracks:
            if spec.seconds:
                raise InputError(
                    f"the task {spec.task} is a track; only whole recordings can be cut to their first seconds."
                )
            return track
    if not _column(recordings, spec):
        known = (*tracks, *column_names(recordings))
        raise InputError(f"There is no track or column {spec.task!r} for the task; there are {', '.join(known)}.")
    return ""


def task_names(recordings: Recordings) -> tuple[str, ...]:
    """Tasks that a data set may answer: tracks, without corrected variants of another one, and columns of text."""
    tracks = recordings.annotations.tracks
    variants = {track for track in tracks for other in tracks if track.startswith(f"{other}-")}
    return (*(track for track in tracks if track not in variants), *column_names(recordings))


def column_names(recordings: Recordings) -> tuple[str, ...]:
    """Columns that can be a task: outcome and the data set's own texts."""
    texts = (name for name, values in recordings.columns.items() if values.dtype.kind == "U")
    return ("outcome", *texts)


def extract_features(
    tracks: LabelTracks | Mapping[str, LabelTracks] | TrackBatches,
    items: LabelledIntervals | UnlabelledIntervals,
    spec: FeatureSpec,
) -> Features:
    """Features of every item, both arms side by side where the task has two.

    Args:
        tracks: labels, or those of several encoders by name, which are put side by side; or batches of such.
        items: from :func:`labelled_intervals` or :func:`unlabelled_intervals`.
        spec: which features.

    Example:
        >>> import rcbht_jax as rj
        >>> recordings = Recordings.from_arrays(np.zeros((2, 400, 6)), outcome=["success", "failure"])
        >>> items = labelled_intervals(recordings, TaskSpec("outcome"))
        >>> features = extract_features(rj.encode(recordings.wrench), items, FeatureSpec(("histogram",), ("llb",)))
        >>> features.values.shape, features.names[0]
        ((2, 96), 'histogram.llb.Fx.time.FX')
    """
    if isinstance(tracks, TrackBatches):
        return extract_batched_features(tracks.read(), items, spec)
    return extract_batched_features([tracks if isinstance(tracks, Mapping) else {"": tracks}], items, spec)


def extract_batched_features(
    batches: Iterable[Mapping[str, LabelTracks]], items: LabelledIntervals | UnlabelledIntervals, spec: FeatureSpec
) -> Features:
    """As :func:`extract_features`, of label tracks that come in batches: the features alone are kept.

    Args:
        batches: label tracks by name, of consecutive recordings from the first on.
        items: from :func:`labelled_intervals` or :func:`unlabelled_intervals`.
        spec: which features.
    """
    found: dict[tuple[str, int], tuple[list[NDArray[np.int64]], list[Features]]] = {}
    first = 0
    for batch in batches:
        count = len(next(iter(batch.values())).llb.label)
        for arm, intervals in enumerate(items.intervals):
            mine = np.flatnonzero((intervals.recording >= first) & (intervals.recording < first + count))
            part = intervals.take(mine)
            part = replace(part, recording=part.recording - first)
            for name, tracks in batch.items():
                places, features = found.setdefault((name, arm), ([], []))
                if len(mine) or not features:
                    places.append(mine)
                    features.append(interval_features(tracks, part, spec))
        first += count
    by_name: dict[str, list[Features]] = {}
    for (name, _), (places, features) in found.items():
        order = np.argsort(np.concatenate(places), kind="stable")
        values = np.concatenate([part.values for part in features])[order]
        by_name.setdefault(name, []).append(replace(features[0], values=values))
    return concatenate_features(
        {name: arms[0] if len(arms) == 1 else concatenate_arms(arms[0], arms[1]) for name, arms in by_name.items()}
    )


@dataclass(frozen=True)
class _Found:
    """Labelled intervals in samples, half-open."""

    rows: NDArray[np.int64]  # [item, arm] recording
    label: NDArray[np.str_]  # [item]
    start: NDArray[np.int64]  # [item, arm]
    end: NDArray[np.int64]  # [item, arm]


def _intervals(found: _Found, dt: float) -> tuple[Intervals, ...]:
    """The intervals of each arm."""
    return tuple(
        Intervals(recording=rows, start=start, end=end, dt=dt)
        for rows, start, end in zip(found.rows.T, found.start.T, found.end.T, strict=True)
    )


def _listed(noun: str, names: Sequence[str]) -> str:
    return f"only the {noun} {names[0]}" if names else f"no {noun}"


def _reasons(dropped: Mapping[str, int]) -> str:
    return f" Left out: {', '.join(f'{count} ({reason})' for reason, count in dropped.items())}." if dropped else ""


def _outcomes(recordings: Recordings, spec: TaskSpec) -> tuple[str, ...]:
    """The outcomes that pass, with the task's own default."""
    if spec.outcomes is not None:
        return spec.outcomes
    if track_of(recordings, spec):
        return (SUCCESS,) if (recordings.outcome == SUCCESS).any() else ()
    values = recordings.column(_column(recordings, spec))
    return () if spec.task == "outcome" else tuple(sorted(set(recordings.outcome[values != ""].tolist())))


def _column(recordings: Recordings, spec: TaskSpec) -> str:
    """The column of a task, which may be spelt with hyphens; "" = there is none."""
    known = column_names(recordings)
    return next((name for name in (spec.task, spec.task.replace("-", "_")) if name in known), "")


def chosen_recordings(recordings: Recordings, spec: TaskSpec, unknown: bool = False) -> NDArray[np.bool_]:
    """The recordings ``[recording]`` of the sources, sessions and outcomes of a task.

    Args:
        recordings: the data set.
        spec: names them.
        unknown: recordings of unknown outcome pass as well.

    Raises:
        InputError: a filter names a source, session or outcome that the data set has not.
    """
    filters: list[tuple[str, NDArray[np.str_], Sequence[str]]] = [
        ("source", recordings.source, spec.sources),
        ("session", recordings.session, spec.sessions),
        ("outcome", recordings.outcome, _outcomes(recordings, spec)),
    ]
    chosen = np.ones(len(recordings), bool)
    for what, values, wanted in filters:
        passing = values == UNKNOWN if unknown and what == "outcome" else np.zeros(len(values), bool)
        missing = set(wanted) - set(values.tolist())
        if missing and not passing.any():
            known = ", ".join(sorted(set(values.tolist())))
            raise InputError(f"no recording has the {what} {', '.join(sorted(missing))}; there are {known}.")
        if wanted:
            chosen &= np.isin(values, wanted) | passing
    return chosen


def _rows(recordings: Recordings, chosen: NDArray[np.bool_], arms: str, dropped: Counter[str]) -> NDArray[np.int64]:
    """Rows of the data set ``[trial, arm]``; trials that lack an arm are dropped.

    Raises:
        InputError: two recordings have the same source, trial and arm.
    """
    there = sorted(set(recordings.arm[chosen].tolist()), reverse=True)  # R before L
    wanted = tuple(there) if arms == BOTH or len(there) == 1 else (arms,)
    by_trial: dict[tuple[str, str], dict[str, int]] = {}
    for row in np.flatnonzero(chosen).tolist():
        key, arm = (str(recordings.source[row]), str(recordings.trial[row])), str(recordings.arm[row])
        if by_trial.setdefault(key, {}).setdefault(arm, row) != row:
            raise InputError(f"Two recordings of {key[0]!r} are named {key[1]!r}, arm {arm}; a name must be unique.")
    complete = [[arm[a] for a in wanted] for arm in by_trial.values() if set(wanted) <= set(arm)]
    _count(dropped, f"no arm {' and '.join(wanted)}", len(by_trial) - len(complete))
    return np.array(complete, np.int64).reshape(-1, len(wanted))


def _count(dropped: Counter[str], reason: str, trials: int) -> None:
    if trials:
        dropped[reason] += trials


def _of_track(
    recordings: Recordings, rows: NDArray[np.int64], track: str, spec: TaskSpec, dropped: Counter[str]
) -> _Found:
    """Intervals of a track whose ends are known, in the order of the trials and of time."""
    marks = recordings.annotations.of(track)
    labels = np.array(marks.labels[track], np.str_)
    longest = int(recordings.length.max())
    start = nearest_samples(marks.start, longest, recordings.dt)
    end = np.nan_to_num(nearest_samples(marks.end, longest, recordings.dt), nan=-1.0)
    # What lasts beyond the record is cut off there; an unknown end is before every start.
    end = np.minimum(end, recordings.length[marks.recording])
    usable = (start >= 0) & (end > start)
    if spec.complete:
        usable &= _complete(marks, usable, len(recordings))[marks.recording]
    if spec.classes:
        usable &= np.isin(labels[marks.code], spec.classes)
    chosen = np.flatnonzero(usable)
    bounds = np.searchsorted(marks.recording[chosen], np.arange(len(recordings) + 1))
    of_trials = [[chosen[bounds[row] : bounds[row + 1]] for row in arms] for arms in rows.tolist()]
    there = [arms for arms in of_trials if all(len(arm) for arm in arms)]
    _count(dropped, "a state is missing" if spec.complete else "no annotation", len(of_trials) - len(there))
    same = [arms for arms in there if all(np.array_equal(marks.code[arms[0]], marks.code[arm]) for arm in arms)]
    _count(dropped, "its arms are annotated differently", len(there) - len(same))
    items = np.array([item for arms in same for item in zip(*arms, strict=True)], np.int64).reshape(-1, rows.shape[1])
    left = np.isin(marks.recording, rows[:, 0]) & ~usable
    if not spec.complete and not spec.classes and left.any():
        _count(dropped, "intervals that are empty, begin after the record or have no known end", int(left.sum()))
    return _Found(
        marks.recording[items].astype(np.int64), labels[marks.code[items[:, 0]]],
        start[items].astype(np.int64), end[items].astype(np.int64),
    )  # fmt: skip


def _complete(marks: Annotations, usable: NDArray[np.bool_], recordings: int) -> NDArray[np.bool_]:
    """Recordings ``[recording]`` all of whose labels are there, follow each other and are usable."""
    (names,) = marks.labels.values()
    count = np.bincount(marks.recording[usable], minlength=recordings)
    ordered = (np.diff(marks.starts(next(iter(marks.labels)), recordings), axis=1) > 0).all(1)
    return np.asarray((count == len(names)) & ordered)


def _known(
    recordings: Recordings, rows: NDArray[np.int64], spec: TaskSpec
) -> tuple[NDArray[np.str_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Class of each whole trial, whether it is one of the task's, and whether the same record has two names."""
    first, column = rows[:, 0], _column(recordings, spec)
    values = recordings.column(column)[first]
    known = np.isin(values, spec.classes) if spec.classes else ~np.isin(values, ("", UNKNOWN))
    copies = np.char.find(recordings.note[first], "contradictory-duplicate") >= 0
    doubtful = copies & (column != "outcome")
    return values, known & ~doubtful, doubtful


def _whole(
    recordings: Recordings, rows: NDArray[np.int64], values: NDArray[np.str_], spec: TaskSpec, dropped: Counter[str]
) -> _Found:
    """Whole records, or the same number of seconds of each."""
    end = recordings.length[rows].astype(np.int64)
    if spec.seconds:
        samples = round(spec.seconds / recordings.dt) if 0 < spec.seconds < np.inf else 0
        if samples < 1:
            raise InputError(
                f"the first {spec.seconds:g} s of each recording were asked for; expected a sample or more."
            )
        long = (end >= samples).all(1)
        _count(dropped, f"shorter than {spec.seconds:g} s", int((~long).sum()))
        rows, values, end = rows[long], values[long], np.full_like(end[long], samples)
    return _Found(rows, values, np.zeros_like(rows), end)
