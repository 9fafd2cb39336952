"""Synthesis killed ten times at random moments and resumed: the store must equal the uninterrupted one.

Run by hand: python -m experiments.simulation.kill_resume [--trials 2000] [--kills 10] [--longest 3.0]
Trials are cut short, because the physics is not under test.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments._lib.results_io import write_result
from sim_mjx.synthesis.shards import folder_of

STARTING = 3.5  # s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--longest", type=float, default=3.0, help="s, cuts every trial")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole.zarr", Path(folder) / "killed.zarr"
        start = time.perf_counter()
        start_run(whole, options).wait()
        seconds = time.perf_counter() - start
        moments = kill_at_random(killed, options, seconds)
        if not killed.exists():
            start_run(killed, options).wait()
        same = tree(whole) == tree(killed)
        tidy = not folder_of(killed).exists()
    result = {
        "trials": options.trials, "longest": options.longest, "seconds_uninterrupted": round(seconds, 1),
        "shards_done_at_kills": moments, "same_bytes": same, "work_folder_removed": tidy,
    }  # fmt: skip
    command = f"python -m experiments.simulation.kill_resume --trials {options.trials} --kills {options.kills}"
    write_result("kill_resume", command, result, options.seed)
    sys.exit(not (same and tidy and len(moments) == options.kills))


def start_run(target: Path, options: argparse.Namespace) -> subprocess.Popen[bytes]:
    words = ["simulate", str(target), "--trials", str(options.trials), "--max-seconds", str(options.longest)]
    code = "import sys; from rcbht_jax.cli.main import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL)


def kill_at_random(target: Path, options: argparse.Namespace, seconds: float) -> list[int]:
    """Kill run after run at random moments; how many shards were finished at each kill."""
    rng, moments = random.Random(options.seed), []
    while len(moments) < options.kills:
        child = start_run(target, options)
        # a run needs some seconds before it works; together the runs take about as long as one without kills
        time.sleep(STARTING * rng.uniform(0.5, 1.1) + rng.uniform(0.0, 1.2) * (seconds - STARTING) / options.kills)
        child.send_signal(signal.SIGKILL)
        if child.wait() != -signal.SIGKILL:
            break
        moments.append(len(list(folder_of(target).glob("shard-*.npz"))))
    return moments


def tree(path: Path) -> dict[str, bytes]:
    """Content of all files below a folder."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


if __name__ == "__main__":
    main()
