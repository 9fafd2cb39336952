"""Snaps from words, compared with the passes of tabs in simulation, and with the recorded session B.

Words are those of the fit rule on the axis of insertion (Fz). A pass counts as found if a snap is seen from 50 ms
before to 100 ms after it, and as found in time if that is at most 50 ms after it; what is seen and matches no pass is a
false event. Passes of worn hooks, which release next to no force, are counted separately. Shares are by trial: of
trials with a pass, those in which every pass is found in time; of trials with an event, those without a false one; with
Wilson's intervals. The rule was designed, and sizes were chosen, on clip@panda and plug@panda, seeds 1 to 5; all else
is another seed, unseen before; some of it is another robot or another assembly, of which the pegs have nothing that
could snap. The baseline is a fall of |F| within 50 ms, its level chosen on the same trials.

Run: python -m experiments.words.snaps
Simulates with the native engine; reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.benchmarks import recorded, rounded
from experiments._lib.intervals import by_trial
from experiments._lib.results_io import write_result
from rcbht_jax.introspection.snap_rule import SnapConfig
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.engines import native
from sim_mjx.presets.session_a import SESSION_A
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.passes import passes_of
from sim_mjx.validation import sessions, snaps

FZ, RATE = 2, 1 / CONTROL_PERIOD
EARLY, IN_TIME, LATE = -10, 10, 20  # samples from a pass to when it is seen
CHOSEN_ON, SEEDS = ("clip@panda", "plug@panda"), range(1, 6)
TESTS, SEED = (
    "clip@panda", "clip@ur5e", "plug@panda", "plug@ur5e", "peg-in-hole@panda", "square-peg@panda", "hooked-B",
), 7  # fmt: skip
SLOW = {"hooked-B": 0.15}  # share of the trials of sets that take long
LEAST, HIGH, SHARES = (1.5, 2.0, 2.5, 3.0, 3.5), (10.0, np.inf), (0.6, 0.75, 0.9)
BASELINE = np.arange(1.0, 12.1, 0.5)  # N
APART = 60  # samples between two events of the baseline, as of the words
AGREES = 0.15  # s between a snap that was read and one that is seen


@dataclass(frozen=True)
class Trials:
    """A set with its ground truth."""

    wrench: NDArray[np.float32]  # [trial, time, 6]
    length: NDArray[np.int32]
    passes: list[list[int]]  # of each trial, samples
    worn: NDArray[np.bool_]  # [trial]


def simulated(name: str, seed: int, count: int) -> Trials:
    """Trials of one kind, half of them with a fault."""
    scenario = get_scenario(name)
    params, faults = scenario.draw_batch(seed, range(count), scenario.spec(nominal_share=0.5))
    run = native.simulate(scenario.scene(), params)
    passes = passes_of(run.past, run.length)
    # parts without tabs cannot snap: every event there is false
    moments = [[start for _, start, end in rows if end and scenario.tabs] for rows in passes.tolist()]
    worn = np.array([fault.kind == "worn-hook" for fault in faults])
    return Trials(run.wrench, run.length, moments, worn)


def joined(sets: Sequence[Trials]) -> Trials:
    """Sets as one; the wrench of shorter ones ends with zeros."""
    longest = max(one.wrench.shape[1] for one in sets)
    wrench = np.concatenate([np.pad(one.wrench, ((0, 0), (0, longest - one.wrench.shape[1]), (0, 0))) for one in sets])
    length, worn = (np.concatenate([getattr(one, name) for one in sets]) for name in ("length", "worn"))
    return Trials(wrench, length, [row for one in sets for row in one.passes], worn)


def seen(trials: Trials, least: float, high: float, config: SnapConfig) -> list[list[int]]:
    """Samples at which snaps are seen on Fz, of each trial: every trial is an axis of one stream."""
    names = [str(trial) for trial in range(len(trials.length))]
    detector = SnapDetector(RATE, names, least, load=(0.0, high), config=config)
    found: list[list[int]] = [[] for _ in names]
    for event in detector.push(trials.wrench[:, :, FZ].T):
        trial = int(event.axis)
        if event.time == event.seen and event.sample <= trials.length[trial]:
            found[trial].append(event.sample)
    return found


def fallen(trials: Trials, level: float) -> list[list[int]]:
    """The baseline: samples at which |F| has fallen by more than the level within 50 ms."""
    size = np.linalg.norm(trials.wrench[:, :, :3].astype(float), axis=2)
    fall = np.pad(size[:, :-IN_TIME] - size[:, IN_TIME:], ((0, 0), (IN_TIME, 0)))
    found: list[list[int]] = []
    for row, length in zip(fall, trials.length.tolist(), strict=True):
        events: list[int] = []
        for sample in np.flatnonzero(row[:length] > level).tolist():
            if not events or sample + 1 - events[-1] > APART:
                events.append(sample + 1)
        found.append(events)
    return found


def score(trials: Trials, found: Sequence[Sequence[int]]) -> dict[str, Any]:
    """How events agree with passes; shares by trial."""
    delays: list[int] = []
    in_time: list[float] = []
    right: list[float] = []
    counts = {"passes": 0, "found in time": 0, "found": 0, "seen": 0, "false": 0, "worn hooks": 0, "worn hooks seen": 0}
    for passes, events, worn in zip(trials.passes, found, trials.worn.tolist(), strict=True):
        left, hits = list(events), 0
        for sample in passes:
            match = next((event for event in left if EARLY <= event - sample <= LATE), None)
            if match is not None:
                left.remove(match)
            counts["worn hooks" if worn else "passes"] += 1
            if worn:
                counts["worn hooks seen"] += match is not None
            elif match is not None:
                delays.append(match - sample)
                hits += delays[-1] <= IN_TIME
                counts["found"] += 1
        counts["found in time"] += hits
        counts["seen"] += len(events)
        counts["false"] += len(left)
        if passes and not worn:
            in_time.append(hits / len(passes))
        if events:
            right.append(1 - len(left) / len(events))
    shares = {"recall": in_time, "precision": right}
    return {
        "trials": len(trials.length),
        **counts,
        **{name: by_trial(float(np.mean(part)), len(part)) if part else None for name, part in shares.items()},
        "ms after the pass, 5 50 95 %": (np.percentile(delays, (5, 50, 95)) * 1e3 / RATE).tolist() if delays else None,
    }


def worth(results: Sequence[dict[str, Any]]) -> float:
    """Harmonic mean of the shares of passes found in time and of events that are right, all sets together."""
    found, passes, events = (sum(one[name] for one in results) for name in ("found in time", "passes", "seen"))
    return 2 * found / max(passes + events, 1)


def choose(sets: Sequence[Trials]) -> tuple[dict[str, Any], float, dict[str, Any]]:
    """Sizes and level that are best on these trials: of those within a standard error of the best, the strictest."""
    rows = {}
    for least, high, share in itertools.product(LEAST, HIGH, SHARES):
        config = SnapConfig(share=share)
        rows[least, high, share] = worth([score(trials, seen(trials, least, high, config)) for trials in sets])
    best = max(rows.values())
    error = np.sqrt(best * (1 - best) / sum(len(row) for trials in sets for row in trials.passes))
    good = [key for key, value in rows.items() if value >= best - error]
    least, high, share = max(good, key=lambda key: (key[0], -key[1], -key[2]))
    levels = {level: worth([score(trials, fallen(trials, level)) for trials in sets]) for level in BASELINE.tolist()}
    level = max(level for level, value in levels.items() if value == max(levels.values()))
    table = {f"fall {k[0]:g} N, load to {k[1]:g} N, share {k[2]:g}": value for k, value in rows.items()}
    return {"least": least, "high": high, "share": share}, level, table


def of_session(recordings: Recordings, session: str, least: float, config: SnapConfig) -> dict[str, Any]:
    """Recorded trials that reached every state: detected snaps, and their agreement with those found afterwards.

    The latter (:func:`sim_mjx.validation.snaps.find`) are found in whole trials, with the sensor's filter inverted.
    """
    rows = sessions.recorded_rows(recordings, session)
    detector = SnapDetector(RATE, ["Fz"], least, config=config)
    out: dict[str, Any] = {}
    names = ("seated", "one is seen", "as recorded is read", "as recorded is read and seen", "read", "read and seen",
             "seen", "seen alone")  # fmt: skip
    counts = dict.fromkeys(names, 0)
    for row in rows.tolist():
        wrench, touch = recordings.wrench[row, : recordings.length[row], FZ], recordings.starts(RECORDED)[row, 1]
        detector.reset()
        events = [event for event in detector.push(wrench[:, None]) if event.time == event.seen]
        seated = "off-seat" not in str(recordings.note[row]) and recordings.outcome[row] == "success"
        read = snaps.find(snaps.unfiltered(wrench, SESSION_A.sensor), float(touch))
        starts = [event.start for event in events]
        agreed = [any(abs(start - snap.time) <= AGREES for start in starts) for snap in read]
        alone = sum(not any(abs(start - snap.time) <= AGREES for snap in read) for start in starts)
        like = [snaps.as_recorded(snap) for snap in read]
        out[str(recordings.trial[row])] = {
            "seated": bool(seated), "read, s": [round(snap.time, 3) for snap in read], "falls, s": starts,
            "seen, s": [event.seen for event in events],
        }  # fmt: skip
        if seated:
            both = any(one and seen for one, seen in zip(like, agreed, strict=True))
            add = (1, bool(events), any(like), both, len(read), sum(agreed), len(events), alone)
            counts = {name: value + more for (name, value), more in zip(counts.items(), add, strict=True)}
    return {"seated trials": counts, "trials": out}


def main(trials: int = 400) -> None:
    """Choose on some trials, test on others, count in the recorded sessions."""
    first = {name: joined([simulated(name, seed, trials // 2) for seed in SEEDS]) for name in CHOSEN_ON}
    sizes, level, grid = choose(list(first.values()))
    config = SnapConfig(share=sizes["share"])
    rows = {}
    known = [(f"{name}, seeds {SEEDS[0]} to {SEEDS[-1]}", name, first[name]) for name in CHOSEN_ON]
    for title, name, of in (*known, *((f"{name}, seed {SEED}", name, None) for name in TESTS)):
        of = of or simulated(name, SEED, round(trials * SLOW.get(name, 1.0)))
        rows[title] = {
            "words": score(of, seen(of, sizes["least"], sizes["high"], config)),
            "words, default share, any load": score(of, seen(of, sizes["least"], np.inf, SnapConfig())),
            "fall of |F|": score(of, fallen(of, level)),
        }
        print(title, flush=True)
    hiro = recorded()
    about = {
        "chosen on": list(rows)[: len(CHOSEN_ON)],
        "chosen": {**sizes, "high": sizes["high"] if np.isfinite(sizes["high"]) else None, "level of |F|": level},
        "worth by choice": grid,
        "rows": rounded(rows),
        "recorded": {session: of_session(hiro, session, sizes["least"], SnapConfig()) for session in ("B", "A")},
    }
    write_result("snaps", f"python -m experiments.words.snaps --trials {trials}", about, seed=SEEDS[0])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
