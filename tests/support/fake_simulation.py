"""An engine without physics for the tests of synthesis, and a worker that can be killed while it works."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from sim_mjx.assembly.rollout import Rollouts, TrialParams
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.synthesis import shards
from sim_mjx.synthesis.pipeline import synthesise, work_on
from sim_mjx.synthesis.plan import SynthesisConfig
from sim_mjx.synthesis.workers import SynthesisProgress

JOB = SynthesisConfig("B", 60, seed=5, shard=5)
SMALL = replace(JOB, trials=12, shard=5)
SHARDED = replace(JOB, shard=2)


def fake_engine(params: TrialParams) -> Rollouts:
    """Numbers that depend on the trial alone: on its key, its part and its time limit."""
    count = len(params.seed)
    length = (10 + np.asarray(params.seed)[:, 0] % 30).astype(np.int32)
    wrench = np.zeros((count, int(length.max()), 6), np.float32)
    joints = np.zeros_like(wrench)
    for row, samples in enumerate(length):
        rng = np.random.default_rng(np.asarray(params.seed)[row])
        wrench[row, :samples] = rng.normal(0, 5, (samples, 6))
        joints[row, :samples] = rng.normal(0, 0.001, (samples, 6))
    onset = np.array([0.0, 0.01, 0.015, 0.03]) + np.zeros((count, 1))
    missing = np.asarray(params.parts.hook_overlap) < 0
    jammed = np.asarray(params.parts.friction)[:, None] > 1.0
    seated, samples = ~(missing | jammed), np.arange(wrench.shape[1])[None, :, None]
    past = seated[:, None] & (samples >= 6 + np.arange(4)) & (samples < length[:, None, None])
    return Rollouts(wrench, joints, length, onset, seated, np.zeros(count, np.bool_), past)


def logging_engine(log: Path, seconds: float = 0.0) -> Callable[[TrialParams], Rollouts]:
    """As the fake one, with time to be killed in; a line of the log for each call: process, key of the first trial."""

    def engine(params: TrialParams) -> Rollouts:
        with log.open("a") as file:
            file.write(f"{os.getpid()} {np.asarray(params.seed)[0].tolist()}\n")
        time.sleep(seconds)
        return fake_engine(params)

    return engine


def tree(path: Path) -> dict[str, bytes]:
    """Content of all files below a folder."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def interrupted(target: Path, job: SynthesisConfig, after: int = 1) -> None:
    """Leave a work folder with so many shards."""
    shutil.copytree(_begun(job, after), shards.folder_of(target))


@cache
def _begun(job: SynthesisConfig, after: int) -> Path:
    """A work folder with so many shards, kept until this process ends."""
    folder, seen = Path(tempfile.mkdtemp()), [0]
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

    def stop(_: SynthesisProgress) -> None:
        seen[0] += 1
        if seen[0] == after + 1:
            raise KeyboardInterrupt

    try:
        synthesise(folder / "t.zarr", job, simulate=fake_engine, progress=stop)
    except KeyboardInterrupt:
        return shards.folder_of(folder / "t.zarr")
    raise AssertionError(f"fewer than {after} shards")


def short(**changes: object) -> DomainRandomization:
    """Trials of a tenth of a second for the real engine."""
    return DomainRandomization(**{"longest": 0.1, "speed": (10.0, 10.0), **changes})


if __name__ == "__main__":
    print("working", flush=True)
    work_on(Path(sys.argv[1]), SHARDED, simulate=logging_engine(Path(sys.argv[2]), 0.25))
