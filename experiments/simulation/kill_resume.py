"""Workers of a synthesis killed at random moments and replaced: the store must equal the uninterrupted one.

Trials are cut short, because the physics is not under test. Each start of a shard is logged, to check that no more was
simulated twice than the killed workers held.

Run: python -m experiments.simulation.kill_resume [--trials 5000] [--kills 20] [--workers 4]
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from experiments._lib.results_io import given, write_result
from sim_mjx.synthesis import shards

# A worker that appends the number of each shard it begins to the file that is its first argument.
WORKER = """
import sys
from sim_mjx.synthesis.draft import Draft
draw = Draft.draw
def noted(self, shard):
    with open(sys.argv[1], "a") as log:
        log.write(f"{shard}\\n")
    return draw(self, shard)
Draft.draw = noted
from rcbht_jax.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


@dataclass(frozen=True)
class Options:
    """What is simulated, and how often a worker is killed."""

    trials: int = 5000
    kills: int = 20
    workers: int = 4
    shard: int = 64
    longest: float = 3.0  # s, cuts every trial
    seed: int = 0


def worker(target: Path, log: Path, options: Options) -> subprocess.Popen[bytes]:
    """Start one worker."""
    words = ["simulate", str(target), "--worker", "--trials", str(options.trials), "--shard", str(options.shard)]
    words += ["--max-seconds", str(options.longest)]
    return subprocess.Popen([sys.executable, "-c", WORKER, str(log), *words], stdout=subprocess.DEVNULL)


def killed(target: Path, log: Path, options: Options, seconds: float) -> list[int]:
    """Kill workers at random moments, each of which is replaced; how many shards were finished at each kill."""
    rng, moments = random.Random(options.seed), list[int]()
    between = 0.8 * seconds / min(options.workers, os.cpu_count() or 1) / options.kills  # the last ones before the end
    running = [worker(target, log, options) for _ in range(options.workers)]
    while len(moments) < options.kills and not target.exists():
        time.sleep(rng.uniform(0.4, 1.6) * between)
        place = rng.randrange(len(running))
        running[place].send_signal(signal.SIGKILL)
        if running[place].wait() == -signal.SIGKILL:
            moments.append(len(shards.finished(shards.folder_of(target))))
        running[place] = worker(target, log, options)
    for one in running:
        one.wait()
    return moments


def tree(path: Path) -> dict[str, bytes]:
    """Content of all files below a folder."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def main(options: Options) -> None:
    """Measure and store; exit status 1 if bytes differ, something is left, or more was simulated than was lost."""
    count = -(-options.trials // options.shard)
    with tempfile.TemporaryDirectory() as folder:
        whole, target, log = (Path(folder) / name for name in ("whole.zarr", "killed.zarr", "begun"))
        start = time.perf_counter()
        worker(whole, Path(folder) / "other", options).wait()
        seconds = time.perf_counter() - start
        moments = killed(target, log, options, seconds)
        if not target.exists():  # the last one was killed while it completed the store
            worker(target, log, options).wait()
        same = tree(whole) == tree(target)
        tidy = not shards.folder_of(target).exists()
        begun = Counter(map(int, log.read_text().split()))
    result: dict[str, Any] = {
        "trials": options.trials, "shards": count, "workers": options.workers, "longest": options.longest,
        "seconds_of_one_worker_uninterrupted": round(seconds, 1), "kills": len(moments),
        "shards_finished_at_kills": moments, "shards_begun_again": begun.total() - count, "same_bytes": same,
        "work_folder_removed": tidy,
    }  # fmt: skip
    command = "python -m experiments.simulation.kill_resume" + given(vars(options), vars(Options()))
    write_result("kill_resume", command, result, options.seed)
    again = begun.total() - count
    sys.exit(not (same and tidy and len(moments) == options.kills and again <= options.kills))


if __name__ == "__main__":
    main(tyro.cli(Options))
