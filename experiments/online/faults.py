"""Faults in simulation, recognised from the stream: detection, false alarms and delay by kind and severity.

Half of the failures and two thirds of the nominal trials train, the others are streamed, several times with other
halves. A failure is detected if an alarm is raised while the trial can still be saved: after contact or after the robot
stopped, and before the sub-task in which the trial failed ends. Mating ends when the controller planned it; a sub-task
that never ends counts until the planned end of mating. Every record goes on for three seconds after that, and an alarm
in a nominal trial is a false one whenever it comes, there as well. A trial with a fault that seats nevertheless is a
success: alarms about those are counted apart. So are faults without contact.

Run: python -m experiments.online.faults --folder faults --repeats 5 --seed 2
Simulated trials and their features are kept in the folder; run it again to go on where it was interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.benchmarks import rounded
from experiments._lib.intervals import of_splits
from experiments._lib.results_io import given, write_result
from experiments.online.fault_trials import GRADES, TAIL, Trials
from experiments.online.fault_watch import CONFIG, Watched, alarms, monitor, watched
from rcbht_jax.introspection.fault_monitor import NOMINAL
from rcbht_jax.robots.snap_assembly import RECORDED

TARGETS = {"detected before the end, per kind": 0.90, "false alarms per nominal trial": 0.02}
NOMINAL_SHARE = 2 / 3  # of the nominal trials train: levels for few false alarms take many of them


@dataclass(frozen=True)
class Streamed:
    """The alarms of the trials that were streamed, in one repeat."""

    inside: NDArray[np.bool_]  # [trial] trains, and is not streamed
    first: dict[str, NDArray[np.float64]]  # time of the first alarm [trial], s, of the words and of the clock

    @property
    def alarm(self) -> NDArray[np.float64]:
        """Time of the first alarm of either ``[trial]``, s."""
        return np.minimum(self.first["words"], self.first["clock"])


def parts(those: Trials, seed: int) -> NDArray[np.bool_]:
    """Which trials train: half of each kind and grade, and more of the nominal ones."""
    rng, inside = np.random.default_rng(seed), np.zeros(len(those.kind), bool)
    for kind in np.unique(those.kind):
        for grade in np.unique(those.grade[those.kind == kind]):
            rows = rng.permutation(np.flatnonzero((those.kind == kind) & (those.grade == grade)))
            inside[rows[: round(len(rows) * (NOMINAL_SHARE if kind == NOMINAL else 1 / 2))]] = True
    return inside


def run(w: Watched, seed: int) -> Streamed:
    """Learn from one part, stream the other."""
    inside = parts(w.trials, seed)
    return Streamed(inside, alarms(w, monitor(w, inside, seed), ~inside))


def in_time(those: Trials, alarm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether an alarm ``[trial]`` came after the fault could show and before the failing sub-task ended."""
    contact = np.where(those.contact, those.recordings.starts(RECORDED)[:, 1], 0.0)
    begins = np.where(those.kind == "early-stop", those.stop, contact)
    return np.asarray((alarm >= begins) & (alarm <= those.end))


def cell(those: Trials, runs: Sequence[Streamed], rows: NDArray[np.bool_]) -> dict[str, Any]:
    """Counts of alarms and outcomes of some trials, over all repeats that streamed them."""
    failed = [rows & ~run.inside & those.failed for run in runs]
    seated = [rows & ~run.inside & ~those.failed for run in runs]
    helped = [{name: np.where(in_time(those, t), t, np.inf) for name, t in run.first.items()} for run in runs]
    by = {
        name: [mine & np.isfinite(times[name]) for mine, times in zip(failed, helped, strict=True)]
        for name in ("words", "clock")
    }
    found = [words | clock for words, clock in zip(by["words"], by["clock"], strict=True)]
    early = [mine & (times["words"] < times["clock"]) for mine, times in zip(by["words"], helped, strict=True)]
    alarm = [np.minimum(times["words"], times["clock"]) for times in helped]
    begins = np.where(those.kind == "early-stop", those.stop, those.recordings.starts(RECORDED)[:, 1])
    since = [(times - begins)[mine] for mine, times in zip(found, alarm, strict=True)]
    left = [(those.end - times)[mine] for mine, times in zip(found, alarm, strict=True)]
    return {
        "trials": int(rows.sum()),
        "failures streamed": _sum(failed),
        "detected": _sum(found),
        "share detected": _share([m.sum() for m in found], [m.sum() for m in failed], 1.0),
        "by the words": _sum(by["words"]),
        "by the words, before the clock": _sum(early),
        "by the clock": _sum(by["clock"]),
        "seated all the same": _sum(seated),
        "of them alarmed": _sum([mine & np.isfinite(run.alarm) for mine, run in zip(seated, runs, strict=True)]),
        "median s from contact, or from the stop, to the alarm": _median(since),
        "median s from the alarm to the end of the failing sub-task": _median(left),
    }


def _sum(marked: list[NDArray[np.bool_]]) -> int:
    return sum(int(rows.sum()) for rows in marked)


def _share(counts: list[Any], totals: list[Any], test_to_train: float) -> dict[str, float] | None:
    """Mean over the repeats, with its corrected 95 % interval; Wilson's where all are equal."""
    shares = [count / total for count, total in zip(counts, totals, strict=True) if total]
    trials = max(1, round(sum(totals) / len(totals)))
    return rounded(of_splits(shares, test_to_train, trials)) if shares else None


def _median(values: list[NDArray[np.float64]]) -> float | None:
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    return round(float(np.median(known)), 2) if len(known) else None


def boundary(those: Trials, kind: str) -> list[int]:
    """The mild grades of a kind, up to the first with which at least half of the trials fail."""
    grades = list(range(len(GRADES[kind])))
    mild: list[int] = []
    for grade in reversed(grades) if kind == "early-stop" else grades:
        mild.append(grade)
        if those.failed[(those.kind == kind) & (those.grade == grade)].mean() >= 0.5:
            break
    return sorted(mild)


def table(those: Trials, runs: list[Streamed]) -> dict[str, Any]:
    """Detection by kind, at the boundary of success, by grade and by cause, over the repeats."""
    out: dict[str, Any] = {}
    for name, grades in GRADES.items():
        mine, mild = those.kind == name, boundary(those, name)
        touched = mine & those.contact
        out[name] = {
            "with contact": cell(those, runs, touched),
            "at the boundary of success": {
                "grades": [grades[g][0] for g in mild], **cell(those, runs, touched & np.isin(those.grade, mild)),
            },
            "without contact": cell(those, runs, mine & ~those.contact),
            "by grade": {
                named[0]: cell(those, runs, mine & (those.grade == number))
                for number, named in enumerate(grades) if len(grades) > 1
            },
            "by cause": {
                str(cause): cell(those, runs, mine & (those.cause == cause))
                for cause in np.unique(those.cause[mine]) if cause != name
            },
        }  # fmt: skip
    return out


def moments(those: Trials) -> dict[str, dict[str, float]]:
    """Mz in the last second of mating, Nm: what a missing tab changes, and how much nominal trials differ."""
    dt = those.recordings.dt
    mated = np.isfinite(those.recordings.starts(RECORDED)[:, 3])
    last = [
        those.recordings.wrench[row, round((end - 1) / dt) : round(end / dt), 5].mean() if met else np.nan
        for row, (end, met) in enumerate(zip(those.end.tolist(), mated.tolist(), strict=True))
    ]
    out = {}
    for cause in np.unique(those.cause[(those.kind == "missing-tab") | those.nominal]):
        found = np.array(last)[(those.cause == cause) & mated]
        out[str(cause)] = {"mean": round(float(found.mean()), 4), "deviation": round(float(found.std()), 4)}
    return out


def false_alarms(those: Trials, runs: Sequence[Streamed]) -> dict[str, Any]:
    """Alarms in nominal trials that were streamed, over the repeats."""
    calm = [those.nominal & ~run.inside for run in runs]
    false = [int((mine & np.isfinite(run.alarm)).sum()) for mine, run in zip(calm, runs, strict=True)]
    by = {
        name: [int((mine & np.isfinite(run.first[name])).sum()) for mine, run in zip(calm, runs, strict=True)]
        for name in ("words", "clock")
    }
    streamed = [int(mine.sum()) for mine in calm]
    return {
        "nominal trials streamed in each repeat": streamed,
        "false alarms in each repeat": false,
        "false alarms per nominal trial": _share(false, streamed, (1 - NOMINAL_SHARE) / NOMINAL_SHARE),
        "false alarms in each repeat, by watcher": by,
    }


def measure(w: Watched, repeats: int, seed: int) -> dict[str, Any]:
    """All numbers of a preset."""
    runs = [run(w, one) for one in tqdm(range(seed, seed + repeats), file=sys.stderr, disable=None)]
    return {
        "nominal trials": int((w.trials.kind == NOMINAL).sum()),
        "of them seated": int(w.trials.nominal.sum()),
        **false_alarms(w.trials, runs),
        "moment about z in the last second of mating, Nm": moments(w.trials),
        "kinds": table(w.trials, runs),
    }


@dataclass(frozen=True)
class Options:
    """Of both experiments on simulated faults."""

    folder: Path
    preset: tuple[str, ...] = ("hooked-B", "hooked-C", "hooked-A")
    nominal: tuple[int, ...] = (300, 400)  # one store each
    per_kind: int = 40
    repeats: int = 5
    seed: int = 2

    def watched(self, preset: str) -> Watched:
        """The trials of a preset."""
        return watched(self.folder, preset, self.nominal, self.per_kind, self.seed)


def main(options: Options) -> None:
    done: dict[str, Any] = {}
    result = {
        "what": "failures noticed in the stream of simulated trials; one part trains, the other is streamed",
        "detected": "alarm after contact, or after the stop, and before the end of the failing sub-task as planned",
        "words": "machines on the sentence of the sub-task so far",
        "clock": "the sub-task lasts longer than it should",
        "recorded after the planned end, s": TAIL,
        "hold times to choose from, s": CONFIG.holds,
        "false alarms promised per nominal trial": {
            "words": CONFIG.false_alarms, "clock, approach and insertion each": CONFIG.clock_false_alarms,
        },
        "targets": TARGETS,
    }  # fmt: skip
    for preset in options.preset:
        done[preset] = measure(options.watched(preset), options.repeats, options.seed)
        keep("faults_online", "faults", result, done, options)


def keep(name: str, module: str, about: dict[str, Any], done: dict[str, Any], options: Options) -> None:
    """Write the presets that are done, with the command that makes them."""
    complete = len(done) == len(options.preset)
    command = f"python -m experiments.online.{module}" + given(vars(options), dict.fromkeys(vars(options)))
    write_result(name, command, about | {"complete": complete, "presets": done}, options.seed, show=complete)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
