"""What a monitor learns from one part of simulated trials, and when it raises the alarm in the others.

Two watchers stand side by side, and either may raise the alarm. The *words* of the sub-task so far say how likely it
is that all is well: one machine for the insertion, one for mating and one for mating that goes on for long tell
nominal trials from each cause of failure. The *clock* says that a sub-task lasts longer than it should. The levels of
both come from nominal training trials alone, each streamed through a machine that did not see it, so that a new
nominal trial raises a false alarm with at most the chosen probability.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from experiments.online.fault_trials import NOMINAL, Trials, trials
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset as thresholds
from rcbht_jax.features import FeatureSpec
from rcbht_jax.introspection.alarms import Alarm, conformal_threshold, held_out, sustained_peak
from rcbht_jax.introspection.chain import FeatureView, online_features_batch
from rcbht_jax.learning.probability import ProbabilisticSvm, fit_probabilistic
from rcbht_jax.learning.svm import SvmSpec

RATE = 10.0  # looks per second
APPROACH, INSERTION, MATING, SETTLED = range(4)
REST = 12.0  # s after mating begins: session B's hand creeps so long until its wrench is steady; a new sentence begins
MERGED = [0, 1, 3]  # columns of the onsets: in the recorded controllers the rotation may last one sample
# Primitives alone: their levels and slopes are the force itself, which a missing tab changes by less than a word.
SIGHT = FeatureView(
    FeatureSpec(
        layers=("primitive",), families=("histogram", "attributes", "offset", "course", "edges", "duration"),
    )
)  # fmt: skip
PICKED = 8  # looks of a sub-task that train
SEEN = 0.3  # s after an early stop, before which its looks do not train
FEWEST = 3  # trials of a cause, of which fewer do not train
COST = 0.1  # of the linear machines
HOLDS = (0.3, 0.5, 1.0, 2.0, 4.0)  # s, for which the words' alarm must stay; chosen inside the training part
# False alarms per nominal trial that the levels promise: of all words together, each as much; and of the clock, of the
# approach and of the insertion each. Mating lasts as long as the controller says.
WORDS, CLOCK = 0.01, 0.0025


@dataclass(frozen=True)
class Watched:
    """Trials with all that a stream saw of them: looks at the sentence of the present sub-task."""

    trials: Trials
    row: NDArray[np.int64]  # [look] trial
    begin: NDArray[np.int64]  # [look] first sample of the sub-task
    now: NDArray[np.int64]  # [look] samples received
    stage: NDArray[np.int64]  # [look] APPROACH, INSERTION, MATING or SETTLED
    x: NDArray[np.float32]  # [look, feature]

    @property
    def time(self) -> NDArray[np.float64]:
        """Of each look, s."""
        return self.now * self.trials.recordings.dt

    @property
    def elapsed(self) -> NDArray[np.float64]:
        """Since the sub-task began ``[look]``, s."""
        return (self.now - self.begin) * self.trials.recordings.dt


def looks(those: Trials, every: int) -> tuple[NDArray[np.int64], ...]:
    """Trial, first sample of the present sub-task, samples received, and sub-task of every look.

    Mating counts as two: small differences can be told once the hand has settled.
    """
    recordings, parts = those.recordings, []
    for row, (onset, length) in enumerate(zip(recordings.onset, recordings.length.tolist(), strict=True)):
        reached = np.flatnonzero(np.isfinite(onset[MERGED]))
        starts = np.rint(onset[MERGED][reached] / recordings.dt).astype(np.int64).tolist()
        if reached[-1] == MATING and starts[-1] + round(REST / recordings.dt) < length:
            reached, starts = np.append(reached, SETTLED), [*starts, starts[-1] + round(REST / recordings.dt)]
        for stage, (begin, end) in zip(reached, itertools.pairwise([*starts, length]), strict=True):
            now = np.append(np.arange(begin + every, end, every), end)
            parts.append(np.stack([np.full_like(now, row), np.full_like(now, begin), now, np.full_like(now, stage)]))
    return tuple(np.concatenate(parts, 1))


def watched(folder: Path, preset: str, nominal: tuple[int, ...], per_kind: int, seed: int) -> Watched:
    """Simulate, and look at every trial ten times a second; what was seen is kept in the folder."""
    those = trials(folder, preset, nominal, per_kind, seed)
    recordings = those.recordings
    config = EncoderConfig(dt=recordings.dt)
    row, begin, now, stage = looks(those, round(1 / (RATE * config.dt)))
    sizes = "-".join(str(count) for count in nominal)
    path = folder / f"{preset}-{sizes}-{per_kind}-{seed}-looks.npz"
    if not path.is_file():
        with tqdm(total=len(now), desc=f"watch {preset}", file=sys.stderr, disable=None) as bar:
            x = online_features_batch(config, thresholds(), SIGHT, recordings.wrench, row, begin, now, bar.update)
        with atomic_write(path) as draft:
            np.savez(draft, x=x)
    return Watched(those, row, begin, now, stage, np.load(path)["x"])


@dataclass(frozen=True)
class Monitor:
    """A machine and a level per sub-task, how long an alarm must last, and how long a sub-task may last."""

    machines: dict[int, ProbabilisticSvm]
    levels: dict[int, float]
    hold: float  # s
    limits: dict[int, float]  # s
    found: float  # mean over the kinds: training failures with contact that the words find, held out


def monitor(w: Watched, inside: NDArray[np.bool_], seed: int) -> Monitor:
    """Learn from the trials ``inside``; the hold time is the one that finds most of their failures, held out."""
    limits = {stage: _limit(w, inside, stage) for stage in (APPROACH, INSERTION)}
    said = np.zeros(len(w.row))
    machines = {}
    for stage in (INSERTION, MATING, SETTLED):
        rows = _lessons(w, inside, stage)
        causes = set(w.trials.cause[w.row[rows]].tolist())
        if NOMINAL in causes and len(causes) > 1:  # few records are long enough for the last
            machines[stage] = _learn(w, inside, stage, rows, seed, said)
    options = []
    for hold in HOLDS:
        levels = {stage: _level(w, inside, stage, said, hold, WORDS / len(machines)) for stage in machines}
        options.append(Monitor(machines, levels, hold, limits, _found(w, inside, said, levels, hold)))
    return max(options, key=lambda option: option.found)  # the shortest of equals


def _limit(w: Watched, inside: NDArray[np.bool_], stage: int) -> float:
    """Longest time that a sub-task may last, s."""
    onset = w.trials.recordings.onset[:, MERGED]
    lasted = (onset[:, stage + 1] - onset[:, stage])[inside & w.trials.nominal]
    return conformal_threshold(lasted, CLOCK)


def _of_stage(w: Watched, inside: NDArray[np.bool_], stage: int) -> NDArray[np.bool_]:
    """Looks at a sub-task of trials that went well or failed, among those ``inside``."""
    return (w.stage == stage) & (inside & (w.trials.nominal | w.trials.failed))[w.row]


def _lessons(w: Watched, inside: NDArray[np.bool_], stage: int) -> NDArray[np.int64]:
    """The looks that the machine of a sub-task learns from."""
    those = w.trials
    begun = w.time >= np.where(those.failed & (those.kind == "early-stop"), those.stop + SEEN, 0.0)[w.row]
    rows = _spread(w.row, np.flatnonzero(_of_stage(w, inside, stage) & begun))
    cause = those.cause[w.row[rows]]
    enough = [c for c in np.unique(cause) if len(np.unique(w.row[rows][cause == c])) >= FEWEST]
    return rows[np.isin(cause, enough)]


def _learn(
    w: Watched, inside: NDArray[np.bool_], stage: int, rows: NDArray[np.int64], seed: int, said: NDArray[np.float64]
) -> ProbabilisticSvm:
    """The machine of a sub-task; ``said`` gets what it says of its training trials when they are held out."""
    x, group, cause = w.x[rows].astype(np.float64), w.row[rows], w.trials.cause[w.row[rows]]
    causes, y = np.unique(cause, return_inverse=True)
    spec = SvmSpec("linear", COST, scaling=True, balanced=True, floor=0.1)
    machine = fit_probabilistic(x, y, group, causes.tolist(), spec, seed)
    streamed = np.flatnonzero(_of_stage(w, inside, stage) & np.isin(w.row, group))
    said[streamed] = _failing(machine, held_out(machine, x, y, group, w.x[streamed], w.row[streamed], seed))
    return machine


def _failing(machine: ProbabilisticSvm, probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability ``[look]`` that all is not well, from that of each cause ``[look, cause]``."""
    return 1.0 - probability[:, machine.svm.classes.index(NOMINAL)]


def _spread(row: NDArray[np.int64], chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """A few of the chosen looks of every trial, evenly spaced."""
    parts = [part for part in np.split(chosen, np.flatnonzero(np.diff(row[chosen])) + 1) if len(part)]
    return np.concatenate(
        [chosen[:0], *(p[np.unique(np.linspace(0, len(p) - 1, PICKED).round().astype(np.int64))] for p in parts)]
    )


def _by_trial(w: Watched, stage: int, rows: NDArray[np.bool_]) -> dict[int, NDArray[np.int64]]:
    """The looks at a sub-task of some trials ``[trial]``, by trial."""
    chosen = np.flatnonzero((w.stage == stage) & rows[w.row])
    if len(chosen) == 0:
        return {}
    parts = np.split(chosen, np.flatnonzero(np.diff(w.row[chosen])) + 1)
    return {int(w.row[part[0]]): part for part in parts}


def _level(
    w: Watched, inside: NDArray[np.bool_], stage: int, said: NDArray[np.float64], hold: float, share: float
) -> float:
    """Of the words' alarm in a sub-task, for a share of false alarms."""
    steps, calm = round(hold * RATE) + 1, _by_trial(w, stage, inside & w.trials.nominal)
    return conformal_threshold(np.array([sustained_peak(said[looks], steps) for looks in calm.values()]), share)


def _found(
    w: Watched, inside: NDArray[np.bool_], said: NDArray[np.float64], levels: dict[int, float], hold: float
) -> float:
    """Mean over the kinds of the share of training failures with contact whose words raise the alarm in time."""
    those, steps, time = w.trials, round(hold * RATE) + 1, w.time
    failures = inside & those.failed & those.contact
    raised = np.zeros(len(failures), bool)
    for stage, level in levels.items():
        for trial, rows in _by_trial(w, stage, failures).items():
            intime = rows[time[rows] <= those.end[trial]]
            raised[trial] |= sustained_peak(said[intime], steps) > level
    kinds = np.unique(those.kind[failures])
    return float(np.mean([raised[failures & (those.kind == kind)].mean() for kind in kinds]))


def alarms(w: Watched, monitor: Monitor, outside: NDArray[np.bool_]) -> dict[str, NDArray[np.float64]]:
    """Time of the first alarm ``[trial]``, s, of the words and of the clock; infinite if there is none."""
    first, time = {name: np.full(len(outside), np.inf) for name in ("words", "clock")}, w.time
    for stage, machine in monitor.machines.items():
        chosen = np.flatnonzero((w.stage == stage) & outside[w.row])
        said = np.zeros(len(w.row))
        said[chosen] = _failing(machine, machine.probability(w.x[chosen]))
        for trial, rows in _by_trial(w, stage, outside).items():
            alarm = Alarm(monitor.levels[stage], monitor.hold)
            raised = (t for p, t in zip(said[rows].tolist(), time[rows].tolist(), strict=True) if alarm.update(p, t))
            first["words"][trial] = min(first["words"][trial], next(raised, np.inf))
    late = outside[w.row] & (w.elapsed > np.array([*monitor.limits.values(), np.inf, np.inf])[w.stage])
    np.minimum.at(first["clock"], w.row[late], time[late])
    return first
