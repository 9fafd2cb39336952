"""Transfer of fault monitors: trained on faults of other sessions, or of other kinds, than those to be detected.

Four ways to learn, tried on the same streamed trials of a session, half of its failures and a third of its nominal
trials (see ``experiments.online.faults``, whose first way is repeated here):

* "own": its own faults and nominal trials.
* "kind never seen": the same without the kind of fault that is streamed.
* "others, own calm": faults and nominal trials of other sessions, and its own nominal trials, which alone set alarm
  levels and time limits. On a robot one would begin in this way, with a simulation and trials that succeeded.
* "others": faults and nominal trials of other sessions.

Each learns from about as many faults. The last takes 900 nominal ones of a session: its alarm levels after mating has
settled come from half of those of a single other session that train.

Run: python -m experiments.online.faults_across --folder faults --nominal 300 400 200 --repeats 1 --seed 2
Simulated trials are those of ``experiments.online.faults``; they and all alarms are kept in the folder, so that an
interrupted run goes on.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.simulated import kept_arrays
from experiments.online.fault_trials import GRADES, Trials
from experiments.online.fault_watch import Watched, alarms, monitor
from experiments.online.faults import Options, Streamed, cell, false_alarms, keep, parts
from rcbht_jax.introspection.fault_monitor import COLUMNS, FaultMonitor

Rows = NDArray[np.bool_]
WAYS = OWN, UNSEEN, CALM, OTHERS = "own", "kind never seen", "others, own calm", "others"
WATCHERS = ("words", "clock")
EVERY = "every kind"  # of fault: the name of a way's only monitor
SHOWN = ("failures streamed", "detected", "share detected")
WHAT = "failures with contact noticed in the stream of simulated trials, by what the monitor learned from"


def chosen(w: Watched, rows: Rows) -> Watched:
    """Some trials ``[trial]`` with their snapshots, numbered anew."""
    snapshots = w.snapshots.of_trials(rows)
    return Watched(w.trials.take(rows), replace(snapshots, trial=(np.cumsum(rows) - 1)[snapshots.trial]))


def together(sets: list[Watched]) -> Watched:
    """Trials of several sessions as one set."""
    first = np.cumsum([0, *(len(w.trials.kind) for w in sets)]).tolist()
    parts = [replace(w.snapshots, trial=w.snapshots.trial + begin) for w, begin in zip(sets, first, strict=False)]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS}
    return Watched(Trials.join([w.trials for w in sets]), replace(parts[0], **joined))


def some(those: Trials, rows: Rows, share: float, seed: int) -> Rows:
    """A share of the chosen nominal trials, and the same of the others."""
    rng, out = np.random.default_rng(seed), np.zeros_like(rows)
    for mine in (rows & those.nominal, rows & ~those.nominal):
        out[rng.permutation(np.flatnonzero(mine))[: math.ceil(mine.sum() * share)]] = True
    return out


def from_others(w: Watched, inside: Rows, others: list[Watched], seed: int, calm: bool) -> FaultMonitor:
    """A monitor trained on the other sessions, with ``calm`` also on nominal trials of this one, which set the levels.

    It learns from about as many faults as a monitor of the session's own. Without nominal trials of the others it would
    learn to distinguish the sessions.
    """
    seen = [chosen(other, some(other.trials, parts(other.trials, seed), 1 / len(others), seed)) for other in others]
    mine = [chosen(w, inside & w.trials.nominal)] if calm else []
    lessons = together([*mine, *seen])
    every = np.ones(len(lessons.trials.kind), bool)
    return monitor(lessons, every, seed, np.arange(len(every)) < len(mine[0].trials.kind) if calm else None)


def learned(w: Watched, inside: Rows, others: list[Watched], seed: int, way: str) -> dict[str, FaultMonitor]:
    """The monitor of a way, or one for each kind of fault where it must not have seen that kind."""
    if way == UNSEEN:
        return {kind: monitor(w, inside & (w.trials.kind != kind), seed) for kind in GRADES}
    one = monitor(w, inside, seed) if way == OWN else from_others(w, inside, others, seed, calm=way == CALM)
    return {EVERY: one}


def alarms_of(w: Watched, others: list[Watched], seed: int, way: str, path: Path) -> dict[str, Streamed]:
    """One repeat of one way: monitor -> its alarms in the streamed trials; kept in a file, and read from it."""
    inside = parts(w.trials, seed)

    def found() -> dict[str, NDArray[np.float64]]:
        monitors = learned(w, inside, others, seed, way).items()
        return {f"{name}/{by}": times for name, one in monitors for by, times in alarms(w, one, ~inside).items()}

    kept = kept_arrays(path, found)
    names = dict.fromkeys(key.split("/")[0] for key in kept)
    return {name: Streamed(inside, {by: kept[f"{name}/{by}"] for by in WATCHERS}) for name in names}


def measure(those: Trials, repeats: dict[str, list[dict[str, Streamed]]]) -> dict[str, Any]:
    """All numbers of a session: way -> false alarms, and detection by kind; from way -> repeat -> monitor."""
    out: dict[str, Any] = {}
    for way, repeated in repeats.items():
        out[way] = {"kinds": {}}
        for kind in GRADES:
            runs = [one.get(kind) or one[EVERY] for one in repeated]
            found = cell(those, runs, (those.kind == kind) & those.contact)
            out[way]["kinds"][kind] = {name: found[name] for name in SHOWN}
            where = out[way]["kinds"][kind] if way == UNSEEN else out[way]  # that of its monitor
            where |= false_alarms(those, runs)
    return out


def main(options: Options) -> None:
    sets = {preset: options.watched(preset) for preset in options.preset}
    seeds = range(options.seed, options.seed + options.repeats)
    lot = f"{'-'.join(str(count) for count in options.nominal)}-{options.per_kind}-{options.seed}"

    def one(preset: str, way: str, seed: int) -> dict[str, Streamed]:
        others = [other for name, other in sets.items() if name != preset]
        name = way.replace(" ", "-").replace(",", "")
        path = options.folder / f"{''.join(options.preset)}-{preset}-{lot}-{name}-{seed}-alarms.npz"
        found = alarms_of(sets[preset], others, seed, way, path)
        bar.update()
        return found

    done: dict[str, Any] = {}
    with tqdm(total=len(sets) * len(WAYS) * len(seeds), desc="learn", file=sys.stderr, disable=None) as bar:
        for preset, w in sets.items():
            done[preset] = measure(w.trials, {way: [one(preset, way, seed) for seed in seeds] for way in WAYS})
            keep("faults_across", "faults_across", {"what": WHAT}, done, options)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
