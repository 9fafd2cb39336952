"""``rcbht monitor fit``, ``monitor watch`` and ``monitor evaluate``: anomalies, learned from successes alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from rcbht_jax._util.arms import common_arm, learned_arm, rows_of_arm
from rcbht_jax._util.cells import number_of
from rcbht_jax._util.printable import padded, plural, printable, room
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, Flag, MadeBy, option, progress_bar
from rcbht_jax.cli.readers import SnapSize, detector_of
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.introspection.nominal import NominalMonitor
    from rcbht_jax.types import Recordings

MONITOR = MadeBy('"rcbht monitor fit STORE.zarr -o {path}"')
Where = Annotated[tuple[str, ...], option("Recordings to use: COLUMN=VALUE; if several, all must hold.", "all")]
Group = Annotated[str, option("Column of the days or sessions between which recordings differ.")]
FalseAlarms = Annotated[
    float,
    option("Share of nominal recordings that may raise an alarm, if they last no longer than those of the monitor."),
]
USUAL_RATE = 20.0  # scores per second
ScoreRate = Annotated[float | None, option("Scores per second.", f"{USUAL_RATE:g}, or the store's rate if it is lower")]
AUTO, NONE = ("auto",), ("none",)
Levels = Annotated[
    tuple[str, ...],
    option(
        "Axes whose values are compared as well as their changes; none = no axis; auto = those without a bias that "
        "differs between groups, if three groups or more have several nominal recordings."
    ),
]


@dataclass(frozen=True)
class MonitorFit(Command):
    """Learn a monitor from nominal recordings of one skill: an anomaly score, and thresholds for few false alarms.

    Example: rcbht monitor fit kitting.zarr --where skill=7 --group session -o skill7.monitor
    """

    store: common.Store
    """Store of recordings; label tracks are not needed."""
    where: Where = ()
    nominal: str = "success"
    """Outcome of nominal recordings; others are not used."""
    group: Group = "session"
    score_rate: ScoreRate = None
    levels: Levels = AUTO
    exact: Flag = False
    """Set the threshold on recordings held out from training, so that its guarantee on false alarms is exact."""
    seed: int = 0
    """Seed for the choice of held-out recordings."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="MONITOR")] = Path("nominal.monitor")
    """File to write: arrays and JSON, no code."""
    arm: common.Arm = ""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.introspection.nominal_file import MonitorFile, save
        from rcbht_jax.learning.class_groups import column_groups

        chosen, remarks, learned = _read(self.store, self.where, self.arm)
        recordings = chosen.take(np.flatnonzero(_nominal(chosen, self.nominal)))
        series = _series(recordings)
        monitor = _monitor(recordings, self.score_rate, self.levels)
        monitor.set_params(calibration="split" if self.exact else "cross", random_state=self.seed)
        groups = column_groups(self.group, recordings)
        monitor.fit(series, groups=groups)
        save(self.out, MonitorFile(monitor, recordings.axes, self.where, recordings.units, self.arm or learned))
        held = len(monitor.peaks_)
        return {
            "monitor": str(self.out),
            "recordings": len(series),
            "held_out": held,
            "groups": len(np.unique(groups)),
            "levels": [recordings.axes[level] for level in monitor.levels_],
            "score_rate": monitor.rate / monitor.score_step,
            "fewest_false_alarms": 1 / (held + 1),
            "remarks": remarks,
        }

    def text(self, result: dict[str, Any]) -> str:
        from rcbht_jax.introspection.alarms import rounded_up

        count = f"{plural(result['recordings'], 'nominal recording')} of {plural(result['groups'], 'group')}"
        fitted = (
            f"{result['monitor']}: {count}; "
            f"it compares the changes of all axes and the values of {', '.join(result['levels']) or 'none'}, "
            f"{result['score_rate']:.3g} times a second; "
            f"the smallest share of false alarms that it can promise is {rounded_up(result['fewest_false_alarms']):g}"
        )
        return "\n".join([fitted, *result["remarks"]])


@dataclass(frozen=True)
class MonitorWatch(Command):
    """Play recordings through a monitor and print JSON lines: one at the alarm, one at the end, one for each --snap.

    Times are elapsed times: number of samples received x period, one period later than the stamp of the last sample.

    A recording that the monitor was trained on is its own nearest neighbour and hardly ever raises an alarm: watch
    others.

    Example: rcbht monitor watch kitting.zarr --monitor skill7.monitor --where skill=7 --false-alarms 0.1
    """

    store: common.Store
    """Store of recordings."""
    monitor: Annotated[Path, tyro.conf.arg(aliases=["-m"], metavar="MONITOR"), MONITOR] = Path("nominal.monitor")
    """File of "rcbht monitor fit"."""
    where: Where = ()
    false_alarms: FalseAlarms = 0.05
    snap: SnapSize = ()
    arm: Annotated[str, option("Arm whose wrench to use, if the store has several.", "that of the monitor")] = ""

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util.signals import check_axes
        from rcbht_jax.introspection.nominal_file import load

        file = load(self.monitor)
        recordings, remarks, _ = _read(self.store, self.where, self.arm, [file.arm])
        series = _series(recordings)
        monitor, level = file.monitor, file.monitor.threshold(self.false_alarms)
        check_axes(recordings.axes, recordings.units, file.axes, file.units, str(self.store))
        if not np.isclose(1 / recordings.dt, monitor.rate):
            raise InputError(
                f"{self.store} has {1 / recordings.dt:g} samples per second; {self.monitor} expects {monitor.rate:g}."
            )
        alarms, snaps = 0, detector_of(self.snap, monitor.rate)
        columns = [] if snaps is None else snaps.columns(recordings.axes, recordings.dt)
        for row, part in enumerate(series):
            scores = monitor.scores(part)
            above = np.flatnonzero(scores > level)
            about = {"trial": str(recordings.trial[row]), "arm": str(recordings.arm[row])}
            alarms += bool(len(above))
            if snaps is not None:
                snaps.reset()
                for event in snaps.push(part[:, columns]):
                    print(json.dumps(event.to_json() | about, allow_nan=False))
            if len(above):
                _line("Alarm", about, time=(int(above[0]) + 1) * recordings.dt, score=scores[above[0]], threshold=level)
            _line("End", about, time=len(part) * recordings.dt, peak=scores.max(), outcome=str(recordings.outcome[row]))
        counts = {"recordings": len(series), "alarms": alarms, "threshold": level, "remarks": remarks}
        return {"monitor": str(self.monitor), **counts}

    def text(self, result: dict[str, Any]) -> str:
        # Standard output belongs to the alarms.
        count = f"{plural(result['recordings'], 'recording')}, {result['alarms']} with an alarm"
        print(count, *map(printable, result["remarks"]), sep="\n", file=sys.stderr)
        return ""


@dataclass(frozen=True)
class MonitorEvaluate(Command):
    """Measure a monitor on unseen groups: each is held out in turn, and nominal recordings of the others train.

    Many groups are held out several at a time.

    Example: rcbht monitor evaluate kitting.zarr --where skill=7 --group session --onset anomaly_rel --false-alarms 0.1
    """

    store: common.Store
    """Store of recordings."""
    where: Where = ()
    nominal: str = "success"
    """Outcome of nominal recordings; others count as anomalous, but unknown and unfinished ones are left out."""
    group: Group = "session"
    folds: Annotated[int, option("Parts into which the groups are distributed; 0 = one part per group.")] = 10
    onset: Annotated[str, option("Column with the seconds after which the anomaly began, for the delay.", "")] = ""
    false_alarms: FalseAlarms = 0.05
    score_rate: ScoreRate = None
    levels: Levels = AUTO
    arm: common.Arm = ""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.introspection.alarms import trials_needed
        from rcbht_jax.introspection.nominal_evaluation import hold_out, judge, parts, thresholds
        from rcbht_jax.learning.class_groups import column_groups
        from rcbht_jax.learning.tasks import UNFINISHED, UNKNOWN

        chosen, remarks, _ = _read(self.store, self.where, self.arm)
        judged = ~np.isin(chosen.outcome, (UNKNOWN, UNFINISHED))
        recordings = chosen.take(np.flatnonzero(_nominal(chosen, self.nominal) | judged))
        series = _series(recordings)
        groups, nominal = column_groups(self.group, recordings), _nominal(recordings, self.nominal)
        monitor, onset = _monitor(recordings, self.score_rate, self.levels), self._onset(recordings)
        with progress_bar("evaluate", "parts", len(np.unique(parts(groups, self.folds)))) as bar:
            watched = hold_out(monitor, series, nominal, groups, bar.update, self.folds)
        limits = thresholds(watched, self.false_alarms)
        result = judge(watched, limits, onset)
        without = sorted(result["groups"].keys() - limits)
        left_out = len(chosen) - len(recordings)
        return {
            **result, "without_threshold": without, "needed": trials_needed(self.false_alarms), "unknown": left_out,
            "not_scored": sorted(result["groups"].keys() - watched.calibration), "remarks": remarks,
        }  # fmt: skip

    def _onset(self, recordings: Recordings) -> NDArray[np.float64] | None:
        """When the anomaly of each recording began, NaN where nothing says so; None = not asked for."""
        if not self.onset:
            return None
        column = recordings.column(self.onset)
        onset = np.array(list(map(number_of, column.tolist())), np.float64)
        if column.dtype.kind not in "fiu" and np.isnan(onset).all():
            raise InputError(f"--onset {self.onset}: this column has no number; expected seconds.")
        return onset

    def text(self, result: dict[str, Any]) -> str:
        from rcbht_jax.learning.metrics import wilson

        rows = {"all": result, **result["groups"]}
        width = max(map(room, rows))
        head = f"{'':{width}}  nominal  anomalous  AUROC  false alarms  detected  delay"
        lines = [head, *(f"{padded(name, width)}  {_row(row)}" for name, row in rows.items())]
        if unknown := result["unknown"]:
            lines.append(f"left out: {plural(unknown, 'recording')}, outcome unknown or unfinished")
        false, calm = result["false_alarms_of"]
        if calm:
            low, high = wilson(false, calm)
            lines.append(
                f"False alarms: {false} of {plural(calm, 'nominal recording')}; 95 % interval {low:.3f} to {high:.3f} "
                "if recordings of a group are independent."
            )
        if early := result["early"]:
            lines.append(f"{plural(early, 'alarm')} of anomalous recordings came long before the onset: no detection.")
        if not_scored := result["not_scored"]:
            lines.append(
                f"Not scored: {', '.join(not_scored)}; the nominal recordings of the other groups are too few to learn "
                "from, or would be without one of these groups."
            )
        if without := [name for name in result["without_threshold"] if name not in not_scored]:
            lines.append(
                f"No alarms of {', '.join(without)}: --false-alarms {self.false_alarms:g} takes "
                f"{result['needed']} nominal recordings of the other groups."
            )
        return "\n".join([*lines, *result["remarks"]])


def _row(row: dict[str, Any]) -> str:
    cells = [
        (row["nominal"], "d", 7), (row["anomalous"], "d", 9), (row["auroc"], ".3f", 5),
        (row["false_alarms"], ".3f", 12), (row["detected"], ".3f", 8), (row["delay_median"], ".2f", 5),
    ]  # fmt: skip
    return "  ".join(f"{'-' if value is None else format(value, form):>{width}}" for value, form, width in cells)


def _read(
    store: Path, where: tuple[str, ...], arm: str, learned: Sequence[str] = ()
) -> tuple[Recordings, list[str], str]:
    """The chosen recordings of one arm, a remark that names it where there are others, and what a file calls it.

    Where no ``arm`` is named, it is the one that a monitor ``learned``.
    """
    from rcbht_jax.io.store import read_recordings

    recordings = read_recordings(store)
    chosen = np.ones(len(recordings), bool)
    for condition in where:
        name, equals, value = condition.partition("=")
        if not equals:
            raise InputError(f"--where {condition}: expected COLUMN=VALUE.")
        column = recordings.column(name)
        chosen &= column == number_of(value) if column.dtype.kind in "fiu" else column.astype(str) == value
    if not chosen.any():
        raise InputError(f"{store} has no recording with {' and '.join(where)}.")
    rows = np.flatnonzero(chosen)
    own, remarks = rows_of_arm(recordings.arm[rows], arm or common_arm(recordings.arm.tolist(), learned))
    one = recordings.take(rows[own])
    return one, remarks, learned_arm(str(one.arm[0]), recordings.arm)


def _series(recordings: Recordings) -> list[NDArray[np.float64]]:
    """Values ``[time, axis]`` of each recording."""
    pairs = zip(recordings.wrench, recordings.length, strict=True)
    return [wrench[:length].astype(np.float64) for wrench, length in pairs]


def _nominal(recordings: Recordings, outcome: str) -> NDArray[np.bool_]:
    """Recordings ``[recording]`` of an outcome, of which there must be some."""
    nominal = recordings.outcome == outcome
    if not nominal.any():
        there = ", ".join(sorted(set(recordings.outcome.tolist())))
        raise InputError(f"No recording has the outcome {outcome}, only {there}; choose one with --nominal.")
    return np.asarray(nominal)


def _monitor(recordings: Recordings, score_rate: float | None, levels: tuple[str, ...]) -> NominalMonitor:
    from rcbht_jax.introspection.nominal import NominalMonitor

    rate, numbers = 1 / recordings.dt, None
    if levels != AUTO:
        named = () if levels == NONE else levels
        unknown = [name for name in named if name not in recordings.axes]
        if unknown:
            raise InputError(f"There is no axis {unknown[0]}; there are {', '.join(recordings.axes)}.")
        numbers = tuple(recordings.axes.index(name) for name in named)
    if score_rate is not None and score_rate > rate * (1 + 1e-9):  # 1 / dt is rounded
        raise InputError(
            f"--score-rate is {score_rate:g}; the store has {rate:g} samples per second, expected no more."
        )
    chosen = min(USUAL_RATE, rate) if score_rate is None else min(score_rate, rate)
    return NominalMonitor(rate=rate, score_rate=chosen, levels=numbers)


def _line(event: str, about: dict[str, str], **more: Any) -> None:
    numbers = {name: round(float(value), 6) if isinstance(value, float) else value for name, value in more.items()}
    print(json.dumps({"event": event, **about, **numbers}, allow_nan=False))
