"""The monitors of the experiments on simulated faults: sub-tasks, features, and what counts as a detection in training.

The words are monitored in the insertion, in mating, and in mating that has settled; the clock in the approach and in
the insertion. See :mod:`rcbht_jax.introspection.fault_monitor`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from experiments._lib.simulated import kept_arrays
from experiments.online.fault_trials import Trials, trials
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset as thresholds
from rcbht_jax.features.recipes import MONITORING
from rcbht_jax.introspection.chain import FeatureView, online_features_batch
from rcbht_jax.introspection.fault_monitor import (
    NOMINAL,
    FaultMonitor,
    FaultMonitorConfig,
    SubtaskSnapshots,
    schedule_snapshots,
)
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings

CONFIG = FaultMonitorConfig()
APPROACH, INSERTION, MATING, SETTLED = range(4)
TIMED = (APPROACH, INSERTION)  # mating lasts as long as the controller says
REST = 12.0  # s after mating begins: session B's hand creeps so long until its wrench is steady
MERGED = [0, 1, 3]  # columns of the onsets: in the recorded controllers the rotation may last one sample
VIEW = FeatureView(MONITORING)
SEEN = 0.3  # s after an early stop, before which its snapshots do not train


@dataclass(frozen=True)
class Watched:
    """Trials with the features of their streams."""

    trials: Trials
    snapshots: SubtaskSnapshots


def schedule(recordings: Recordings, every: int) -> tuple[NDArray[np.int64], ...]:
    """Trial, sub-task, its first sample, and samples received, of every snapshot.

    Mating counts as two sub-tasks: small differences show once the hand has settled.
    """
    onset = recordings.starts(RECORDED)[:, MERGED] / recordings.dt
    begins = np.where(np.isfinite(onset), np.rint(np.nan_to_num(onset)), -1).astype(np.int64)
    settled = begins[:, MATING] + round(REST / recordings.dt)
    settled = np.where((begins[:, MATING] >= 0) & (settled < recordings.length), settled, -1)
    return schedule_snapshots(np.column_stack([begins, settled]), recordings.length, every)


def watched(folder: Path, preset: str, nominal: tuple[int, ...], per_kind: int, seed: int) -> Watched:
    """Simulate, and describe the streams ten times a second; features are kept in the folder."""
    data = trials(folder, preset, nominal, per_kind, seed)
    recordings = data.recordings
    config = EncoderConfig(dt=recordings.dt)
    trial, subtask, begin, now = schedule(recordings, round(1 / (CONFIG.rate * config.dt)))
    sizes = "-".join(str(count) for count in nominal)

    def features() -> dict[str, NDArray[np.float32]]:
        with tqdm(total=len(now), desc=f"features {preset}", file=sys.stderr, disable=None) as bar:
            steps = (trial, begin, now)
            return {"x": online_features_batch(config, thresholds(), VIEW, recordings.wrench, *steps, bar.update)}

    x = kept_arrays(folder / f"{preset}-{sizes}-{per_kind}-{seed}-looks.npz", features)["x"]
    return Watched(data, SubtaskSnapshots(trial, subtask, begin, now, x, recordings.dt))


def monitor(w: Watched, inside: NDArray[np.bool_], seed: int, own: NDArray[np.bool_] | None = None) -> FaultMonitor:
    """Learn from the trials ``inside`` that are nominal or failed with a fault; those of its ``own`` set the levels."""
    data = w.trials
    onset = data.recordings.starts(RECORDED)[:, MERGED]
    stopped = data.failed & (data.kind == "early-stop")
    return FaultMonitor.fit(
        w.snapshots.of_trials(inside & (data.nominal | data.failed & (data.kind != NOMINAL))),
        data.cause,
        subtasks=(INSERTION, MATING, SETTLED),
        durations={subtask: onset[:, subtask + 1] - onset[:, subtask] for subtask in TIMED},
        kind=data.kind,
        visible=np.where(stopped, data.stop + SEEN, 0.0),
        deadline=np.where(data.contact, data.end, np.nan),
        own=own,
        config=CONFIG,
        seed=seed,
    )


def alarms(w: Watched, monitor: FaultMonitor, outside: NDArray[np.bool_]) -> dict[str, NDArray[np.float64]]:
    """Time of the first alarm ``[trial]``, s, of the words and of the clock, in the trials ``outside``."""
    return monitor.alarms(w.snapshots.of_trials(outside), len(outside))
