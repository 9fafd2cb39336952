"""Tasks: which sentences of a data set are classified, into which classes, and what was left out.

* ``states``: one sentence per recording and state of the assembly;
* ``outcome``: the whole record, success or failure;
* ``failure-type``: the whole record of a failure, by the signs of its deviation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax.errors import InputError
from rcbht_jax.features import (
    Features,
    FeatureSpec,
    Intervals,
    concatenate_arms,
    concatenate_features,
    interval_features,
)
from rcbht_jax.labels import STATES
from rcbht_jax.types import LabelTracks, Recordings

TASKS = ("states", "outcome", "failure-type")
BOUNDARIES = ("recorded", "harmonised", "merged")
ARMS = ("R", "L", "both")
MERGED_STATES = ("approach", "rotation+insertion", "mating")
OUTCOMES = ("failure", "success")
UNKNOWN = "unknown"  # outcome of a trial that nobody judged
# The sign patterns with at least nine trials in the full set (evaluation notes).
FAILURE_TYPES = (
    "+x", "+y", "-y", "+r", "-r", "+x+y", "+x-y", "+x+r", "+x-r", "+y+r", "-y+r", "+x+y+r", "+x-y+r",
)  # fmt: skip


@dataclass(frozen=True)
class TaskSpec:
    """A task and the recordings it is about; empty filters let everything pass.

    >>> TaskSpec("states", sessions=("A", "B")).kept_outcomes
    ('success',)
    """

    task: str = "states"
    boundaries: str = "harmonised"  # of the states task: rotation as recorded, harmonised, or merged with insertion
    arms: str = "R"  # one arm, or "both" side by side
    sources: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    outcomes: tuple[str, ...] | None = None  # None = successes for states, failures for failure-type, else all

    def __post_init__(self) -> None:
        for value, known in ((self.task, TASKS), (self.boundaries, BOUNDARIES), (self.arms, ARMS)):
            if value not in known:
                raise InputError(f"{value!r} is not a choice; expected one of {', '.join(known)}.")

    @property
    def kept_outcomes(self) -> tuple[str, ...]:
        """The outcomes that pass, with the task's own default."""
        if self.outcomes is not None:
            return self.outcomes
        return {"states": ("success",), "outcome": (), "failure-type": ("failure",)}[self.task]


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
    rows = _rows(recordings, _chosen(recordings, spec, unknown=spec.outcomes is None), spec.arms, dropped)
    if spec.task == "states":
        rows, names, edges = _states(recordings, rows, spec.boundaries, dropped)
    else:
        names, kept, _ = _known(recordings, rows, spec.task)
        names, edges = np.where(kept, names, "")[:, None], _records(recordings, rows)
    first = np.repeat(rows[:, 0], names.shape[1])
    return UnlabelledIntervals(first, names.ravel().astype(str), _intervals(rows, edges, recordings.dt), dict(dropped))


def labelled_intervals(recordings: Recordings, spec: TaskSpec) -> LabelledIntervals:
    """The intervals of a task with their classes: sub-tasks, or whole trials.

    Raises:
        InputError: a filter names an unknown source or session, or fewer than two classes remain.

    Example:
        >>> recordings = Recordings.from_arrays(np.zeros((3, 400, 6)), outcome=["success", "failure", "unknown"])
        >>> items = labelled_intervals(recordings, TaskSpec("outcome"))
        >>> items.classes, items.y.tolist(), items.dropped
        (('failure', 'success'), [1, 0], {'class not in the list': 1})
    """
    dropped: Counter[str] = Counter()
    rows = _rows(recordings, _chosen(recordings, spec), spec.arms, dropped)
    if spec.task == "states":
        rows, names, edges = _states(recordings, rows, spec.boundaries, dropped)
    else:
        rows, names, edges = _whole(recordings, rows, spec.task, dropped)
    states = MERGED_STATES if spec.boundaries == "merged" else STATES
    order = {"states": states, "outcome": OUTCOMES, "failure-type": FAILURE_TYPES}[spec.task]
    present = set(names.ravel().tolist())
    classes = tuple(c for c in order if c in present)
    if len(classes) < 2:
        raise InputError(
            f"the task {spec.task} finds {len(classes)} classes in the {len(rows)} trials that pass the filters; "
            "it needs two."
        )
    intervals = _intervals(rows, edges, recordings.dt)
    first = np.repeat(rows[:, 0], names.shape[1])
    y = np.array([classes.index(c) for c in names.ravel().tolist()], np.int64)
    return LabelledIntervals(classes, y, recordings.trial[first], recordings.session[first], intervals, dict(dropped))


def extract_features(
    tracks: LabelTracks | Mapping[str, LabelTracks], items: LabelledIntervals | UnlabelledIntervals, spec: FeatureSpec
) -> Features:
    """Features of every item, both arms side by side where the task has two.

    Args:
        tracks: labels, or those of several encoders by name, which are put side by side.
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
    if isinstance(tracks, LabelTracks):
        arms = [interval_features(tracks, intervals, spec) for intervals in items.intervals]
        return arms[0] if len(arms) == 1 else concatenate_arms(arms[0], arms[1])
    return concatenate_features({name: extract_features(one, items, spec) for name, one in tracks.items()})


def _intervals(rows: NDArray[np.int64], edges: NDArray[np.int64], dt: float) -> tuple[Intervals, ...]:
    """The sentences of each arm, from edges ``[trial, arm, edge]``."""
    return tuple(
        Intervals(
            recording=np.repeat(rows[:, arm], edges.shape[2] - 1),
            start=edges[:, arm, :-1].ravel(),
            end=edges[:, arm, 1:].ravel(),
            dt=dt,
        )
        for arm in range(rows.shape[1])
    )


def _chosen(recordings: Recordings, spec: TaskSpec, unknown: bool = False) -> NDArray[np.bool_]:
    filters: list[tuple[str, NDArray[np.str_], Sequence[str]]] = [
        ("source", recordings.source, spec.sources),
        ("session", recordings.session, spec.sessions),
        ("outcome", recordings.outcome, spec.kept_outcomes),
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
    """Rows of the data set ``[trial, arm]``; trials that lack an arm are dropped."""
    wanted = ("R", "L") if arms == "both" else (arms,)
    by_trial: dict[tuple[str, str], dict[str, int]] = {}
    for row in np.flatnonzero(chosen).tolist():
        key = (str(recordings.source[row]), str(recordings.trial[row]))
        by_trial.setdefault(key, {})[str(recordings.arm[row])] = row
    complete = [[arm[a] for a in wanted] for arm in by_trial.values() if set(wanted) <= set(arm)]
    _count(dropped, f"no arm {' and '.join(wanted)}", len(by_trial) - len(complete))
    return np.array(complete, np.int64).reshape(-1, len(wanted))


def _count(dropped: Counter[str], reason: str, trials: int) -> None:
    if trials:
        dropped[reason] += trials


_Found = tuple[NDArray[np.int64], NDArray[Any], NDArray[np.int64]]  # rows, class names, edges [trial, arm, edge]


def _states(recordings: Recordings, rows: NDArray[np.int64], boundaries: str, dropped: Counter[str]) -> _Found:
    onset = recordings.onset_harmonised if boundaries == "harmonised" else recordings.onset
    names = MERGED_STATES if boundaries == "merged" else STATES
    starts = onset[rows]
    if boundaries == "merged":
        starts = starts[..., [0, 1, 3]]
    length = recordings.length[rows]
    # A missing mark becomes -1, which is never in order.
    samples = np.where(np.isfinite(starts), np.rint(starts / recordings.dt), -1).astype(np.int64)
    edges = np.concatenate([samples, length[..., None].astype(np.int64)], -1)
    whole = (edges[..., 0] >= 0).all(1) & (np.diff(edges, axis=-1) > 0).all((1, 2))
    _count(dropped, "a state is missing", int((~whole).sum()))
    return rows[whole], np.tile(np.array(names), (int(whole.sum()), 1)), edges[whole]


def _whole(recordings: Recordings, rows: NDArray[np.int64], task: str, dropped: Counter[str]) -> _Found:
    values, kept, doubtful = _known(recordings, rows, task)
    _count(dropped, "same record under two names", int(doubtful.sum()))
    _count(dropped, "class not in the list", int((~kept & ~doubtful).sum()))
    return rows[kept], values[kept][:, None], _records(recordings, rows[kept])


def _known(
    recordings: Recordings, rows: NDArray[np.int64], task: str
) -> tuple[NDArray[np.str_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Class of each whole trial, whether it is one of the task's, and whether the same record has two names."""
    first = rows[:, 0]
    typed = task == "failure-type"
    values, known = (recordings.failure_type, FAILURE_TYPES) if typed else (recordings.outcome, OUTCOMES)
    doubtful = typed & (np.char.find(recordings.note[first], "contradictory-duplicate") >= 0)
    return values[first], np.isin(values[first], known) & ~doubtful, doubtful


def _records(recordings: Recordings, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges ``[trial, arm, edge]`` of whole records."""
    return np.stack([np.zeros_like(rows), recordings.length[rows].astype(np.int64)], -1)
