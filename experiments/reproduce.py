"""Every experiment, one after the other: what is there and complete is skipped, what was interrupted goes on.

Run: make reproduce [FORCE=1] [RESULTS=FOLDER] [JOBS=2], or python -m experiments.reproduce WORK [--force] [--jobs 2]
WORK keeps what experiments share (the imported trials, simulated sets, a model) and what each said. A result that is
there, of this version and complete is not made again, unless --force is given. With RESULTS (RCBHT_RESULTS) results go
to another folder, from nothing, and are compared with the committed ones at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

import rcbht_jax
from experiments.record import COMMITTED, RESULTS

DATA = Path(os.environ.get("RCBHT_DATA", "../shared/data/hiro"))
GOLDEN = Path(os.environ.get("RCBHT_GOLDEN", "../shared/golden"))
STORE, MODEL, SETS = "{work}/hiro.zarr", "{work}/online.model", "{work}/sets"
# What experiments share, and the command that makes it.
SHARED = {
    STORE: ("rcbht", "import", "hiro", str(DATA), STORE),
    MODEL: ("rcbht", "train-online", STORE, "--source", "REAL_HIRO_ONE_SA_SUCCESS", "-o", MODEL),
}


@dataclass(frozen=True)
class Experiment:
    """A module that writes results, and what it takes; minutes are about those of 2 idle CPU cores."""

    module: str
    minutes: float
    options: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # "data", "golden", "peers"
    results: tuple[str, ...] = ()  # names of the files; empty = that of the module
    elsewhere: str = ""  # why it is not run here
    alone: bool = False  # it measures speed, so nothing else may run meanwhile

    @property
    def names(self) -> tuple[str, ...]:
        return self.results or (self.module,)


SHORTER = ("--samples", "1000000", "--messages", "200000", "--requests", "2000")
GPU, HOURS = "needs a GPU", "takes hours on 2 CPU cores"
EXPERIMENTS = (
    Experiment("table1_published", 1, needs=("golden",)),
    Experiment("table1_ours", 12, (SETS,), ("data",)),
    Experiment("peers", 12, needs=("data", "peers")),
    Experiment("grammar", 15, needs=("data",)),
    Experiment("probes", 3, needs=("data",)),
    Experiment("curves", 2, needs=("data",)),
    Experiment("table2", 20, needs=("data",)),
    Experiment("confidence", 2, needs=("data",)),
    Experiment("abnormal_real", 6, needs=("data",)),
    Experiment("failure_types_online", 4, needs=("data",)),
    Experiment("detected_starts", 4, needs=("data",)),
    Experiment("online_agreement", 2, needs=("data", "golden")),
    Experiment("two_arm", 8, needs=("data",)),
    Experiment("two_arm_states", 3, needs=("data",)),
    Experiment("sim_sessions", 3, needs=("golden",)),
    Experiment("sim_success", 6, needs=("data",)),
    Experiment("recovery", 5, ("--trials", "16")),
    Experiment("engines", 6, alone=True),
    Experiment("parity_floor", 2),
    Experiment("kill_resume", 2, alone=True),
    Experiment("bench", 1, alone=True),
    Experiment("stream_speed", 3, (MODEL, *SHORTER), ("data",), alone=True),
    Experiment("sim_to_real", 60, (SETS,), ("data",), elsewhere=HOURS),
    Experiment("faults_online", 60, ("--folder", "{work}/faults", "--preset", "B", "C"), elsewhere=HOURS),
    Experiment("calibration", 180, (STORE,), ("data",), elsewhere=HOURS),
    Experiment("calibration_curves", 120, (STORE,), ("data",), elsewhere=HOURS),
    Experiment("calibration_near", 6, (STORE,), ("data",)),
    Experiment("calibration_transfer", 10, (STORE,), ("data",)),
    Experiment("calibration_speed", 5, (STORE,), ("data",), ("calibration_speed_gpu",), GPU),
    Experiment(
        "calibration_device", 10, ("--engine", "warp"), (), ("calibration_device_warp_failure_type",), GPU
    ),
    Experiment("engines_gpu", 10, ("--engine", "warp", "--out", "{work}/engines_gpu.json"), elsewhere=GPU),
)  # fmt: skip


def record_of(name: str, folder: Path) -> dict[str, Any]:
    """A result file as it is, or nothing."""
    path = folder / f"{name}.json"
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return found


def finished(experiment: Experiment, work: Path) -> bool:
    """Are its results there, of this version, and not left by an interruption?"""
    if begun(experiment, work).exists():
        return False
    records = [record_of(name, RESULTS) for name in experiment.names]
    return all(
        record.get("rcbht_jax_version") == rcbht_jax.__version__ and record.get("result", {}).get("complete", True)
        for record in records
    )


def begun(experiment: Experiment, work: Path) -> Path:
    """A file that is there while an experiment runs, and after it was interrupted."""
    return work / f"{experiment.module}.begun"


def lacking(experiment: Experiment, peers: Path | None) -> str:
    """Why it cannot be run, in words; "" = it can."""
    if experiment.elsewhere:
        return experiment.elsewhere
    reasons = {
        "data": "" if DATA.is_dir() else "needs the recorded trials (RCBHT_DATA)",
        "golden": "" if GOLDEN.is_dir() else "needs the reference results (RCBHT_GOLDEN)",
        "peers": "" if peers and peers.exists() else "needs the environment of the peers (make peers)",
    }
    return next((reasons[need] for need in experiment.needs if reasons[need]), "")


def prepare(chosen: list[Experiment], work: Path) -> None:
    """Make what the chosen experiments share and is not there; each tells for itself what it then lacks."""
    for target, command in SHARED.items():
        users = (STORE, MODEL) if target == STORE else (MODEL,)  # the model is made from the store
        wanted = any(user in experiment.options for experiment in chosen for user in users)
        if wanted and not Path(target.format(work=work)).exists():
            words = ["-c", "import sys; from rcbht_jax.cli import main; sys.exit(main(sys.argv[1:]))", *command[1:]]
            subprocess.run([sys.executable, *(word.format(work=work) for word in words)], check=False)


def run(experiment: Experiment, work: Path, peers: Path | None, force: bool, quiet: bool) -> bool:
    """Run one experiment; what it prints goes to WORK, its progress to the terminal unless ``quiet``."""
    python = str(peers) if "peers" in experiment.needs else sys.executable
    options = [option.format(work=work) for option in experiment.options]
    if force and not begun(experiment, work).exists():
        for name in experiment.names:
            (RESULTS / f"{name}.json").unlink(missing_ok=True)
    begun(experiment, work).touch()
    command = [python, "-m", f"experiments.{experiment.module}", *options]
    with (work / f"{experiment.module}.log").open("w", encoding="utf-8") as log:
        done = subprocess.run(command, stdout=log, stderr=log if quiet else None, check=False)
    if done.returncode == 0:
        begun(experiment, work).unlink()
    return done.returncode == 0


def largest_difference(first: Any, second: Any) -> tuple[float, str]:
    """Largest difference of two results' numbers, and where; times are left out, what one lacks counts as infinite."""
    worst = (0.0, "")
    a, b = dict(numbers(first)), dict(numbers(second))
    for place in a | b:
        there = place in a and place in b
        apart = abs(a[place] - b[place]) if there else float("inf")
        if apart > worst[0]:
            worst = apart, place
    return worst


def numbers(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, dict | list):
        parts = value.items() if isinstance(value, dict) else enumerate(value)
        for key, part in parts:
            if not any(word in str(key) for word in ("second", "minute", "time", "libraries")):
                yield from numbers(part, f"{place} > {key}" if place else str(key))
    elif isinstance(value, int | float):
        yield place, float(value)


def compare() -> None:
    """Say how far the results in another folder are from the committed ones."""
    for path in sorted(RESULTS.glob("*.json")):
        if committed := record_of(path.stem, COMMITTED):
            difference, place = largest_difference(record_of(path.stem, RESULTS)["result"], committed["result"])
            print(f"{path.stem}: largest difference from the committed result {difference:g} {place}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--force", action="store_true", help="make results again that are there")
    parser.add_argument("--only", nargs="+", choices=[e.module for e in EXPERIMENTS], help="these experiments")
    parser.add_argument("--peers", type=Path, help="Python of the environment that has the libraries of the peers")
    parser.add_argument("--jobs", type=int, default=1, help="experiments at a time; those that measure speed run alone")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    todo = []
    for experiment in (e for e in EXPERIMENTS if not args.only or e.module in args.only):
        if reason := lacking(experiment, args.peers):
            print(f"{experiment.module}: not run here, {reason}", flush=True)
        elif finished(experiment, args.work) and not args.force:
            print(f"{experiment.module}: is there", flush=True)
        else:
            todo.append(experiment)
    prepare(todo, args.work)
    began, failed = time.perf_counter(), []

    def timed(experiment: Experiment) -> None:
        start = time.perf_counter()
        ok = run(experiment, args.work, args.peers, args.force, quiet=args.jobs > 1)
        minutes = (time.perf_counter() - start) / 60
        if not ok:
            failed.append(experiment.module)
        bar.write(
            f"{experiment.module}: {'done' if ok else 'failed'}, {minutes:.1f} of about {experiment.minutes:g} min"
        )
        bar.update(experiment.minutes)

    total = sum(experiment.minutes for experiment in todo)
    with tqdm(total=total, unit="min", desc="reproduce", file=sys.stdout) as bar:
        with ThreadPoolExecutor(max(1, args.jobs)) as pool:
            list(pool.map(timed, [experiment for experiment in todo if not experiment.alone]))
        for experiment in (experiment for experiment in todo if experiment.alone):
            timed(experiment)
    if RESULTS != COMMITTED:
        compare()
    print(f"{(time.perf_counter() - began) / 60:.0f} minutes; failed: {', '.join(failed) or 'none'}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:  # map leaves out what has not begun; what ran got the interruption too
        sys.exit("Interrupted; the same command goes on from here.")
